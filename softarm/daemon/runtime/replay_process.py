"""Replay or player page of a log, made in a separate process of low priority that can be ended.

The process prints a `ReplayAnswer` as JSON or the page, or exits with 3 and prints the reason for the failure.
"""

import math
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from softarm.daemon.logbook import logs
from softarm.daemon.runtime.replay import describe, replay
from softarm.policies import registry
from softarm.policies.base import PolicyError
from softarm.recordings import player
from softarm.recordings.mcap_file import LogError
from softarm.schemas.rest import ReplayAnswer

CANNOT = 3
# The alarm works even if the daemon has died. The daemon's real-time priority is given up before any import, and this
# process is killed first without memory. At nice 19 it took three minutes beside three busy processes.
_PROGRAM = """
import os
import signal
import sys
signal.alarm(int(sys.argv[2]))
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
os.nice(10)
with open("/proc/self/oom_score_adj", "w") as file:
    file.write("1000")
from softarm.daemon.runtime import replay_process
replay_process.main()
"""


class ReplayError(Exception):
    """A log cannot be replayed; the message says why."""


class Replay:
    """Replay of one log in its own process, or with `page` its player page."""

    def __init__(self, path: Path, limit_s: float, page: bool = False) -> None:
        self.path, self._limit_s = path, limit_s
        self._options = ["page"] if page else []
        self._process: subprocess.Popen[bytes] | None = None
        self._ended = False

    def run(self) -> ReplayAnswer:
        """Run the process and return its answer; raises as `output` does."""
        return ReplayAnswer.model_validate_json(self.output())

    def output(self) -> bytes:
        """Run the process and return its output.

        Raises:
            ReplayError: The log or a policy cannot be read, or the process was ended.
            TimeoutError: The replay took too long.
        """
        command = [sys.executable, "-c", _PROGRAM, str(self.path), str(math.ceil(self._limit_s) + 1)]
        command += self._options
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        ) as process:
            self._process = process
            if self._ended:
                process.kill()
            try:
                answer, _ = process.communicate(timeout=self._limit_s)
            except subprocess.TimeoutExpired:
                raise TimeoutError(f"{self.path.name}: not replayed within {self._limit_s:g} s") from None
            finally:
                process.kill()
        if process.returncode == CANNOT:
            raise ReplayError(answer.decode(errors="replace"))
        if process.returncode != 0:
            how = process.returncode
            ended = f"by {signal.Signals(-how).name}" if how < 0 else f"with exit code {how}"
            raise ReplayError(
                f"{self.path.name}: its replay ended {ended}; try `softarm logs replay` on the machine itself"
            )
        return answer

    def end(self) -> None:
        """End the process: the client has left."""
        self._ended = True
        if self._process is not None:
            with suppress(OSError):
                self._process.kill()


def main() -> None:
    """Replay the log named on the command line and print the answer, or print its player page."""
    path = Path(sys.argv[1])
    try:
        log = logs.read(path)
        if sys.argv[3:] == ["page"]:
            sys.stdout.write(player.page(log, log.entries()))
            return
        config = log.config
        replayed = replay(log.ticks(), config, lambda name: registry.load(name, config.policies))
    except (LogError, PolicyError) as error:
        sys.stdout.write(str(error))
        raise SystemExit(CANNOT) from None
    answer = ReplayAnswer(
        name=path.name,
        same=not replayed.differences,
        ticks=replayed.ticks,
        compared=replayed.compared,
        differences=len(replayed.differences),
        sentences=(log.ending, *describe(replayed)),
    )
    sys.stdout.write(answer.model_dump_json())
