"""Daemons under validation: one with a simulated robot, plug-ins, the process of the rail, recovery after a stop."""

import contextlib
import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import httpx

from softarm.common.revision import CHECKOUT
from softarm.drivers.rail import process as rail_process
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError

POLL_S = 0.03


class SimulatedDaemon(SoftwareInTheLoop):
    """Context in which `softarm run --simulated` runs on free ports."""

    def start_twin(self) -> None:
        """Start no twin, since the daemon simulates the robot."""

    def start_daemon(self) -> None:
        """Start the daemon and wait until it can be armed."""
        self.daemon = self._start("run", self.config_file, "--simulated")
        self._wait("run", self.daemon, self._ready_to_arm)


@contextlib.contextmanager
def plugins(policies: Mapping[str, str]) -> Iterator[None]:
    """Let daemons that start within the context find policies as plug-ins.

    Args:
        policies: Policy name -> `module:class`.
    """
    before = os.environ.get("PYTHONPATH")
    with tempfile.TemporaryDirectory(prefix="softarm-") as folder:
        about = Path(folder) / "validation-1.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: validation\nVersion: 1\n")
        points = [f"{policy} = {target}" for policy, target in policies.items()]
        (about / "entry_points.txt").write_text("\n".join(["[softarm.policies]", *points]) + "\n")
        os.environ["PYTHONPATH"] = os.pathsep.join([folder, str(CHECKOUT), *filter(None, [before])])
        try:
            yield
        finally:
            os.environ.pop("PYTHONPATH") if before is None else os.environ.update(PYTHONPATH=before)


def rail_process_of(daemon_pid: int) -> int:
    """Return the id of the process that drives the rail for a daemon; the spare one has fewer connections.

    Raises:
        SoftwareInTheLoopError: The daemon has no such process.
    """
    children = Path(f"/proc/{daemon_pid}/task").glob("*/children")
    processes = [int(number) for file in children for number in file.read_text().split()]
    of_rail = [process for process in processes if _is_of_rail(process)]
    if not of_rail:
        raise SoftwareInTheLoopError("the daemon has no process for the rail")
    return max(of_rail, key=_sockets)


def recover(loop: SoftwareInTheLoop, patience_s: float) -> bool:
    """Acknowledge a latched stop and wait until arming would be accepted; return whether there was a latch.

    Raises:
        SoftwareInTheLoopError: Arming is still refused after `patience_s`.
    """
    is_acknowledged = False
    deadline = time.monotonic() + patience_s
    refusals: list[str] = ["the daemon does not answer"]
    while time.monotonic() < deadline:
        with contextlib.suppress(httpx.HTTPError):
            status = loop.client.get("/api/status", timeout=0.5).raise_for_status().json()
            refusals = status["arming_refusals"]
            if not refusals:
                return is_acknowledged
            if status["estop"] != "clear":
                is_acknowledged = True
                loop.client.post("/api/acknowledge")
        time.sleep(POLL_S)
    raise SoftwareInTheLoopError(f"not ready again within {patience_s:g} s: {refusals}")


def _is_of_rail(process: int) -> bool:
    return rail_process.__name__.encode() in Path(f"/proc/{process}/cmdline").read_bytes()


def _sockets(process: int) -> int:
    return sum("socket:" in str(file.readlink()) for file in Path(f"/proc/{process}/fd").iterdir())
