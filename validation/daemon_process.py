"""Daemons under validation: one that simulates its robot, one with faulty policies that can be disturbed."""

import contextlib
import os
import subprocess
import time
from pathlib import Path
from typing import Any
from unittest import mock

from softarm.common.revision import CHECKOUT
from softarm.drivers.rail import process as rail_process
from softarm.evaluation.software_in_the_loop import POLL_S, SoftwareInTheLoop, SoftwareInTheLoopError
from validation.matrix.faulty_policies import PLUGINS
from validation.soak import growth


class SimulatedDaemon(SoftwareInTheLoop):
    """Context in which `softarm run --simulated` runs on free ports."""

    def start_twin(self) -> None:
        """Start no twin, since the daemon simulates the robot."""

    def start_daemon(self) -> None:
        """Start the daemon and wait until it can be armed."""
        self.daemon = self._start("run", self.config_file, "--simulated")
        self._wait("run", self.daemon, self._ready_to_arm)


class DisturbedDaemon(SoftwareInTheLoop):
    """Context in which twin and daemon run, and the daemon finds the faulty policies as plug-ins.

    `beside` closes what runs in other threads of this process, after the daemon.
    """

    def __init__(self, logs: Path, overrides: dict[str, Any], twin_drivers: dict[str, Any] | None = None) -> None:
        super().__init__(logs, overrides, twin_drivers=twin_drivers)
        self.beside = contextlib.ExitStack()
        about = self.folder / "validation-1.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: validation\nVersion: 1\n")
        points = [f"{policy} = {target}" for policy, target in PLUGINS.items()]
        (about / "entry_points.txt").write_text("\n".join(["[softarm.policies]", *points]) + "\n")

    def __exit__(self, *ended: Any) -> None:
        super().__exit__(*ended)
        self.beside.close()

    @property
    def process(self) -> "subprocess.Popen[bytes]":
        """Return the daemon's process."""
        assert self.daemon is not None
        return self.daemon

    def rail_process(self) -> int:
        """Return the id of the process that drives the rail; the spare one has fewer connections.

        Raises SoftwareInTheLoopError if there is none.
        """
        children = growth.children(self.process.pid)
        of_rail = [child for child in children if rail_process.__name__ in growth.command(child)]
        if not of_rail:
            raise SoftwareInTheLoopError("the daemon has no process for the rail")
        return max(of_rail, key=lambda child: growth.usage_of([child]).descriptors)

    def recover(self, patience_s: float) -> bool:
        """Acknowledge a latched stop and wait until arming would be accepted; return whether there was a latch.

        Raises SoftwareInTheLoopError if arming is still refused after `patience_s`.
        """
        self._acknowledged = False
        deadline = time.monotonic() + patience_s
        while not self._ready_to_arm():
            if time.monotonic() > deadline:
                raise SoftwareInTheLoopError(f"not ready again within {patience_s:g} s: {self._tail('run')}")
            time.sleep(POLL_S)
        return self._acknowledged

    def drive(self, patience_s: float) -> None:
        """Arm and let the policy drive, again after a stop that a busy machine has caused.

        Raises SoftwareInTheLoopError if the daemon still does not drive after `patience_s`.
        """
        deadline = time.monotonic() + patience_s
        while True:
            self.recover(patience_s)
            try:
                self.arm()
                self.post("goal", kind="run")
                return
            except SoftwareInTheLoopError:
                if time.monotonic() > deadline:
                    raise

    def _acknowledge(self, last_stop: str) -> None:
        self._acknowledged = True
        super()._acknowledge(last_stop)

    def _start(self, verb: str, config_file: Path, *options: str) -> "subprocess.Popen[bytes]":
        path = [str(self.folder), str(CHECKOUT), *filter(None, [os.environ.get("PYTHONPATH")])]
        with mock.patch.dict(os.environ, PYTHONPATH=os.pathsep.join(path)):
            return super()._start(verb, config_file, *options)
