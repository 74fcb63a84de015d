"""Every command of the tutorial runs, in its order, in an empty folder."""

import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
import sysconfig
from pathlib import Path

import httpx
import pytest

from tests.processes import said, until

PAGE = Path(__file__).parents[2] / "docs/tutorial.md"
_BLOCK = re.compile(r'^```sh title="([^"]+)"\n(.*?)^```', re.MULTILINE | re.DOTALL)

pytestmark = pytest.mark.slow


class Terminals:
    """Two terminals in a folder: one for the daemon, one for the other commands."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._plugins = folder / "plugins"
        self._plugins.mkdir()
        # The test environment replaces the reader's own; installed packages go to a folder of their own.
        path = os.pathsep.join([str(self._plugins), os.environ.get("PYTHONPATH", "")])
        scripts = folder / "bin"
        scripts.mkdir()
        for name, module in (("softarm", "softarm.cli.main"), ("pip", "pip")):
            (scripts / name).write_text(f'#!/bin/sh\nexec {sys.executable} -m {module} "$@"\n')
            (scripts / name).chmod(0o755)
        search = os.pathsep.join([str(scripts), sysconfig.get_path("scripts"), os.environ["PATH"]])
        self._environment = {**os.environ, "PYTHONPATH": path, "PATH": search}
        self._running = contextlib.ExitStack()

    def start(self, command: str) -> None:
        """Start a daemon that runs until Ctrl-C, on a free port."""
        self.interrupt()
        ports = self._folder / "ports.yaml"
        ports.write_text("api: {port: 0, stop_port: 0}\n", encoding="utf-8")
        program, options = [*shlex.split(command), "--config", str(ports)], {"cwd": self._folder, "text": True}
        daemon = subprocess.Popen(program, env=self._environment, stdout=subprocess.PIPE, **options)
        self._running.enter_context(daemon)
        self._running.callback(daemon.send_signal, signal.SIGINT)
        self._environment["SOFTARM_URL"] = url = said(daemon, r"serving (http://\S+)")
        status = f"{url}/api/status"
        until(lambda: not httpx.get(status, trust_env=False).json().get("arming_refusals", ["not yet"]), "no refusal")

    def run(self, command: str) -> str:
        """Run a command to its end and return its output."""
        install = f"pip install -q --no-deps --no-build-isolation -t {self._plugins} ./"
        command = command.replace("pip install --editable ", install)
        done = subprocess.run(
            command, shell=True, cwd=self._folder, env=self._environment, capture_output=True, text=True
        )
        assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        return done.stdout

    def interrupt(self) -> None:
        """Send Ctrl-C to the running command."""
        self._running.close()


@pytest.fixture
def terminals(tmp_path):
    these = Terminals(tmp_path)
    yield these
    these.interrupt()


@pytest.mark.prove
@pytest.mark.timeout(1800)
def test_every_command_of_the_tutorial_works(terminals, tmp_path):
    outputs = {}
    for where, block in _BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        for line in block.splitlines():
            if where == "terminal 1":
                terminals.start(line)
            elif where == "terminal 2" and "softarm[" not in line:  # extras are installed already
                outputs[line] = terminals.run(line)
    assert sum(line.startswith("softarm goal reach") for line in outputs) == 3
    assert "reached in" in outputs["softarm goal reach -0.2 0.65 --wait"]
    assert "armed" in outputs["softarm events"]
    diagnosed = next(text for line, text in outputs.items() if line.startswith("softarm diagnose"))
    assert "arm.payload" in diagnosed
    assert "pressure.dead_time" in diagnosed
    assert (tmp_path / "report.html").is_file()
