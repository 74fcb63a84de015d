"""`softarm` as a process of its own, free ports, and waiting for a condition."""

import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

WAIT_S = 120.0  # only a defect takes so long, even on a busy machine


def until(condition: Callable[[], Any], what: str = "a condition") -> None:
    """Wait until a condition is true."""
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"timed out waiting for {what}"
        time.sleep(0.002)


def gone(pid: int) -> bool:
    """Return whether a process has ended, even if it is not reaped."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def free_port() -> int:
    """Return a TCP port on which nothing listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def running(*arguments: object, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Run `softarm` with its output, errors included, in a pipe; kill it at the end."""
    command = [sys.executable, "-m", "softarm.cli.main", *map(str, arguments)]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, text=True, **{**pipes, "env": environment} | options) as process:
        try:
            yield process
        finally:
            process.kill()


def said(process: "subprocess.Popen[str]", pattern: str) -> str:
    """Return the group of a pattern in the next line of the output that has it."""
    assert process.stdout is not None
    return next(found[1] for line in process.stdout if (found := re.search(pattern, line)))
