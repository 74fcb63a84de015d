"""A verb of the `softarm` command in a separate process of low priority, which can be ended."""

import math
import re
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from typing import NamedTuple

from softarm.daemon.runtime.jobs import Done, JobError, Progress

FAILED = 1  # exit code of the `softarm` command for an expected failure
LINES_MAX, LINE_MAX = 100, 2000  # of the output that is returned
_SHARE = re.compile(r"\((\d+) %")
# The alarm works even if the daemon has died. The daemon's real-time priority is given up before any import, and this
# process is killed first without memory. At nice 19 a replay took three minutes beside three busy processes.
_PROGRAM = """
import os
import signal
import sys
signal.alarm(int(sys.argv.pop(1)))
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
os.nice(10)
with open("/proc/self/oom_score_adj", "w") as file:
    file.write("1000")
from softarm.cli.main import main
main(prog_name="softarm")
"""


class Ended(NamedTuple):
    """Exit code and output of a verb that has finished its work."""

    code: int
    lines: tuple[str, ...]  # of standard output
    last: str  # line of standard error, empty without one


class VerbProcess:
    """One run of a verb."""

    def __init__(self, *arguments: str, limit_s: float) -> None:
        self._arguments, self._limit_s = arguments, limit_s
        self._process: subprocess.Popen[str] | None = None
        self._ended = False

    def run(self, progress: Progress) -> Done:
        """Run the verb as a job; its output and, if it failed, its last message are the sentences.

        Raises:
            JobError: The verb failed, or as `output` does.
        """
        ended = self.output(progress)
        if ended.code == 0:
            return Done(ended.lines)
        raise JobError(*ended.lines, ended.last)

    def output(self, progress: Progress = lambda text, share: None) -> Ended:
        """Run the verb and return its output; each line of standard error is progress.

        Raises:
            JobError: The process was ended, took too long, or ended with a defect.
        """
        command = [sys.executable, "-c", _PROGRAM, str(math.ceil(self._limit_s)), *self._arguments]
        last = ""
        with (
            tempfile.TemporaryFile("w+", errors="replace") as printed,
            subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=printed,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                start_new_session=True,  # Ctrl-C in the daemon's terminal is not for this process
            ) as process,
        ):
            self._process = process
            try:
                if self._ended:
                    process.kill()
                assert process.stderr is not None
                while line := process.stderr.readline(LINE_MAX):
                    if line.strip():
                        last = line.strip()
                        share = _SHARE.search(last)
                        progress(last, int(share[1]) / 100 if share else None)
                code = process.wait()
            finally:
                process.kill()
            printed.seek(0)
            lines = tuple(line.rstrip()[:LINE_MAX] for line in printed.readlines()[-LINES_MAX:] if line.strip())
        if code == -signal.SIGALRM:
            raise JobError(f"not finished within {self._limit_s:g} s; on the machine itself {self} has no time limit")
        if code < 0:
            raise JobError(f"{self} was ended by {signal.Signals(-code).name}")
        if code not in (0, FAILED):
            raise JobError(last or f"{self} ended with exit code {code}")
        return Ended(code, lines, last)

    def end(self) -> None:
        """End the process of the verb."""
        self._ended = True
        if self._process is not None:
            with suppress(OSError):
                self._process.kill()

    def __str__(self) -> str:
        return f"`softarm {' '.join(self._arguments[:2])}`"
