"""Calls in a process of their own, which may hang or die."""

import multiprocessing
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

_starting = threading.Lock()  # a process that is forked meanwhile would keep the pipe open


class ProcessDied(Exception):
    """The process ended without a result."""


def call(method: str, limit_s: float, function: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of a function that runs in another process.

    Args:
        method: How the process is started: fork or spawn.
        limit_s: Wall time that it may take.
        function: Function of a module.
        arguments: Its arguments.

    Raises:
        TimeoutError: It took longer; the process was killed.
        ProcessDied: The process ended without a result.
    """
    context: Any = multiprocessing.get_context(method)
    with _starting:
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=_send, args=(sender, function, arguments))
        process.start()
        sender.close()
    try:
        if not receiver.poll(limit_s):
            raise TimeoutError(f"no result within {limit_s:g} s")
        return receiver.recv()
    except EOFError:
        process.join()
        raise ProcessDied(f"the process died ({process.exitcode})") from None
    finally:
        process.kill()
        process.join()
        receiver.close()


def _send(sender: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    sender.send(function(*arguments))
