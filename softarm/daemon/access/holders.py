"""Search for the processes that have a file or socket open (proc(5))."""

import contextlib
import os
from collections.abc import Collection, Iterator
from pathlib import Path


def holders(targets: Collection[str]) -> Iterator[Path]:
    """Yield the /proc folders of the visible processes that have a target open: a path or `socket:[INODE]`."""
    for link in Path("/proc").glob("[0-9]*/fd/*") if targets else ():
        # A process of another user, or one that has ended.
        with contextlib.suppress(OSError):
            if os.readlink(link) in targets:
                yield link.parents[1]
