"""The tutorial, run: every command on the page, in its order, in an empty folder."""

import os
import re
import signal
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

import httpx
import pytest

PAGE = Path(__file__).parents[2] / "docs/tutorial.md"
_BLOCK = re.compile(r'^```sh title="([^"]+)"\n(.*?)^```', re.MULTILINE | re.DOTALL)
_SERVING = re.compile(r"serving (http://\S+)")

pytestmark = pytest.mark.slow


class Terminals:
    """Where a reader would type: a folder, one terminal for what lasts and one for the rest."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._plugins = folder / "plugins"
        self._plugins.mkdir()
        (folder / "ports.yaml").write_text("api: {port: 0, stop_port: 0}\n")
        # The environment that runs the tests stands for the reader's own; what is installed goes beside it.
        path = os.pathsep.join([str(self._plugins), os.environ.get("PYTHONPATH", "")])
        scripts = folder / "bin"
        scripts.mkdir()
        for name, module in (("softarm", "softarm.cli.main"), ("pip", "pip")):
            (scripts / name).write_text(f'#!/bin/sh\nexec {sys.executable} -m {module} "$@"\n')
            (scripts / name).chmod(0o755)
        search = os.pathsep.join([str(scripts), sysconfig.get_path("scripts"), os.environ["PATH"]])
        self._environment = {**os.environ, "PYTHONPATH": path, "PATH": search}
        self._lasting: subprocess.Popen[str] | None = None

    def last(self, command: str) -> None:
        """What goes on until Ctrl-C; on a free port, since tests have neighbours."""
        self.interrupt()
        self._lasting = subprocess.Popen(
            f"exec {command} --config ports.yaml",
            shell=True,
            cwd=self._folder,
            env=self._environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._lasting.stdout is not None
        for line in self._lasting.stdout:
            if found := _SERVING.search(line):
                self._environment["SOFTARM_URL"] = found[1]
                _until_it_can_be_armed(found[1])
                return
        raise AssertionError(f"{command}: ended before it served")

    def type(self, command: str) -> str:
        """What ends by itself; what it said."""
        aside = f"pip install -q --no-deps --no-build-isolation -t {self._plugins} ./"
        command = command.replace("pip install --editable ", aside)
        done = subprocess.run(
            command, shell=True, cwd=self._folder, env=self._environment, capture_output=True, text=True, timeout=150
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    def interrupt(self) -> None:
        """Ctrl-C."""
        if self._lasting is not None:
            self._lasting.send_signal(signal.SIGINT)
            self._lasting.communicate(timeout=20)
            self._lasting = None


def _until_it_can_be_armed(url: str) -> None:
    """A reader takes longer to type than the cameras to settle."""
    deadline = time.monotonic() + 20
    while httpx.get(f"{url}/api/status", trust_env=False).json().get("arming_refusals", ["not yet"]):
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture
def terminals(tmp_path):
    these = Terminals(tmp_path)
    yield these
    these.interrupt()


def test_every_command_of_the_page_does_what_it_says(terminals, tmp_path):
    said = {}
    for where, block in _BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        for line in block.splitlines():
            if where == "terminal 1":
                terminals.last(line)
            elif where == "terminal 2" and "softarm[" not in line:  # the extras are there
                said[line] = terminals.type(line)
    assert sum(line.startswith("softarm goal reach") for line in said) == 3
    assert "reached in" in said["softarm goal reach -0.2 0.65 --wait"]
    assert "armed" in said["softarm events"]
    diagnosed = next(text for line, text in said.items() if line.startswith("softarm diagnose"))
    assert "arm.payload" in diagnosed
    assert "pressure.dead_time" in diagnosed
    assert (tmp_path / "report.html").is_file()
