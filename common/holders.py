"""Which processes of this computer have something open, as far as this user may see (proc(5))."""

import contextlib
import os
from collections.abc import Collection, Iterator
from pathlib import Path


def holders(targets: Collection[str]) -> Iterator[Path]:
    """Folders in /proc of those with one of the targets open: a path, or `socket:[INODE]`."""
    for link in Path("/proc").glob("[0-9]*/fd/*") if targets else ():
        with contextlib.suppress(OSError):  # another user's, or gone meanwhile
            if os.readlink(link) in targets:
                yield link.parents[1]
