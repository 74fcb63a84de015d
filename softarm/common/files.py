"""Atomic writing of files: a reader, also after a crash, finds either the old file or the new one."""

import hashlib
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


def write_text(path: Path | str, text: str) -> None:
    """Replace a file by a text in UTF-8."""
    write_bytes(path, text.encode())


def write_bytes(path: Path | str, content: bytes) -> None:
    """Replace a file by the given bytes."""
    with replacing(path) as file:
        file.write(content)


def exists(path: Path | str) -> bool:
    """Return whether a path exists; a name that no file system can hold, too long or with a null byte, does not."""
    return os.path.exists(path)


def is_file(path: Path | str) -> bool:
    """Return whether a path is a file; a name that no file system can hold is none."""
    return os.path.isfile(path)


def sha256_of(path: Path, without: Path | None = None) -> str:
    """Return the SHA-256 of a file, or of all files in a folder; the name of the path itself does not count.

    without: folder whose files do not count either.
    """
    if not path.is_dir():
        return hashlib.sha256(path.read_bytes()).hexdigest()
    inside = sorted(each for each in path.rglob("*") if each.is_file())
    if without is not None and (apart := without.resolve()).is_relative_to(path.resolve()):
        inside = [each for each in inside if not each.resolve().is_relative_to(apart)]
    lines = (f"{each.relative_to(path)} {sha256_of(each)}\n" for each in inside)
    return hashlib.sha256("".join(lines).encode()).hexdigest()


@contextmanager
def replacing(path: Path | str) -> Iterator[BinaryIO]:
    """Open a draft that replaces a file at the end of the block; an error in the block deletes the draft.

    The hidden draft is in the same folder and is flushed to the disk first. The new file keeps the permissions of the
    old one. A symbolic link keeps its target, which is replaced. A device or a pipe is written directly.

    Raises:
        OSError: The file cannot be written.
    """
    target = Path(path)
    if target.exists() and not target.is_file():
        with target.open("wb") as file:
            yield file
        return
    target = Path(os.path.realpath(target))
    draft = target.with_name(f".{target.name}.{secrets.token_hex(4)}")
    try:
        with draft.open("xb") as file:
            if target.exists():
                os.fchmod(file.fileno(), stat.S_IMODE(target.stat().st_mode))
            yield file
            file.flush()
            os.fsync(file.fileno())
        draft.replace(target)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(draft)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        with suppress(OSError):
            draft.unlink()
