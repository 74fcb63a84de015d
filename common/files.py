"""Files written in one piece: a reader, and a kill at any instant, find the old file or the new one."""

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


def write_text(path: Path | str, text: str) -> None:
    """Put a text, as UTF-8, in the place of a file. Raises OSError."""
    write_bytes(path, text.encode())


def write_bytes(path: Path | str, content: bytes) -> None:
    """Put bytes in the place of a file. Raises OSError."""
    with replacing(path) as file:
        file.write(content)


@contextmanager
def replacing(path: Path | str) -> Iterator[BinaryIO]:
    """Open a draft that takes the place of a file when the block ends, and vanishes when the block raises.

    The draft lies beside the file, hidden, and is on the disk before it takes the file's place. A file that was there
    hands down its permissions; a link goes on pointing at what it points at; a device or a pipe is written straight
    into. Raises OSError.
    """
    target = Path(path)
    if target.exists() and not target.is_file():
        with target.open("wb") as file:
            yield file
        return
    target = Path(os.path.realpath(target))
    draft = target.with_name(f".{target.name}.{secrets.token_hex(4)}")
    try:
        with _begun(draft, path) as file:
            if target.exists():
                os.fchmod(file.fileno(), stat.S_IMODE(target.stat().st_mode))
            yield file
            file.flush()
            os.fsync(file.fileno())
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


def _begun(draft: Path, path: Path | str) -> BinaryIO:
    """The opened draft; an error speaks of the file that people know."""
    try:
        return draft.open("xb")
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
