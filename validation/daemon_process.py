"""Daemons under validation: one that simulates its robot, one with faulty policies that can be disturbed."""

import contextlib
import os
import subprocess
import time
from pathlib import Path
from typing import Any
from unittest import mock

import httpx

from softarm.common.revision import CHECKOUT
from softarm.drivers.rail import process as rail_process
from softarm.evaluation.soak import usage
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError
from validation.matrix.faulty_policies import PLUGINS

POLL_S = 0.03


class SimulatedDaemon(SoftwareInTheLoop):
    """Context in which `softarm run --simulated` runs on free ports."""

    def start_twin(self) -> None:
        """Start no twin, since the daemon simulates the robot."""

    def start_daemon(self) -> None:
        """Start the daemon and wait until it can be armed."""
        self.daemon = self._start("run", self.config_file, "--simulated")
        self._wait("run", self.daemon, self._ready_to_arm)


class DisturbedDaemon(SoftwareInTheLoop):
    """Context in which twin and daemon run, and the daemon finds the faulty policies as plug-ins."""

    def __init__(self, logs: Path, overrides: dict[str, Any], twin_drivers: dict[str, Any] | None = None) -> None:
        super().__init__(logs, overrides, twin_drivers=twin_drivers)
        about = self.folder / "validation-1.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: validation\nVersion: 1\n")
        points = [f"{policy} = {target}" for policy, target in PLUGINS.items()]
        (about / "entry_points.txt").write_text("\n".join(["[softarm.policies]", *points]) + "\n")

    @property
    def process(self) -> "subprocess.Popen[bytes]":
        """Return the daemon's process."""
        assert self.daemon is not None
        return self.daemon

    def rail_process(self) -> int:
        """Return the id of the process that drives the rail; the spare one has fewer connections.

        Raises:
            SoftwareInTheLoopError: The daemon has no such process.
        """
        children = usage.children(self.process.pid)
        of_rail = [child for child in children if rail_process.__name__ in usage.command(child)]
        if not of_rail:
            raise SoftwareInTheLoopError("the daemon has no process for the rail")
        return max(of_rail, key=lambda child: usage.of([child]).descriptors)

    def answer(self) -> dict[str, Any] | None:
        """Return the daemon's status, or None if it does not answer."""
        with contextlib.suppress(httpx.HTTPError, ValueError):
            return dict(self.client.get("/api/status", timeout=0.5).raise_for_status().json())
        return None

    def recover(self, patience_s: float) -> bool:
        """Acknowledge a latched stop and wait until arming would be accepted; return whether there was a latch.

        Raises:
            SoftwareInTheLoopError: Arming is still refused after `patience_s`.
        """
        is_acknowledged = False
        deadline = time.monotonic() + patience_s
        refusals: list[str] = ["the daemon does not answer"]
        while time.monotonic() < deadline:
            if (status := self.answer()) is not None:
                refusals = status["arming_refusals"]
                if not refusals:
                    return is_acknowledged
                if status["estop"] != "clear":
                    is_acknowledged = True
                    with contextlib.suppress(httpx.HTTPError):
                        self.client.post("/api/acknowledge")
            time.sleep(POLL_S)
        raise SoftwareInTheLoopError(f"not ready again within {patience_s:g} s: {refusals}")

    def _start(self, verb: str, config_file: Path, *options: str) -> "subprocess.Popen[bytes]":
        path = [str(self.folder), str(CHECKOUT), *filter(None, [os.environ.get("PYTHONPATH")])]
        with mock.patch.dict(os.environ, PYTHONPATH=os.pathsep.join(path)):
            return super()._start(verb, config_file, *options)
