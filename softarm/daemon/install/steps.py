"""The steps of an installation: each can be summarised, shown in full and carried out."""

import difflib
import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from softarm.common import files

COMMAND_S = 60.0
ROOT = "root is required (or --root FOLDER)"


class StepError(Exception):
    """A failed step, with the cause and what to do."""


class Step(NamedTuple):
    """A step of an installation, made by one of the functions below."""

    kind: str  # name of that function
    text: str  # summary in one line
    carry_out: Callable[[], None]  # raises StepError
    shown: Sequence[str] = ()  # details line by line


def write(path: Path, text: str, before: str | None = None) -> Step:
    """Return a step that writes a text to a file; `before` is the file's present text, None for a new file."""

    def carry_out() -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            files.write_text(path, text)
            path.chmod(0o644)
        except OSError as error:
            raise StepError(f"{path}: cannot be written ({error.strerror}); {ROOT}") from None

    if before is None:
        return Step("write", f"write {path}", carry_out, text.splitlines())
    changes = difflib.unified_diff(before.splitlines(), text.splitlines(), "now", "new", lineterm="", n=1)
    return Step("write", f"change {path}", carry_out, list(changes))


def folder(path: Path, owner: str | None) -> Step:
    """Return a step that creates a folder, or keeps its content, for an owner; None for the installing user."""

    def carry_out() -> None:
        try:
            path.mkdir(parents=True, exist_ok=True)
            path.chmod(0o750)
            if owner is not None:
                shutil.chown(path, owner, owner)
        except (OSError, LookupError) as error:
            raise StepError(f"{path}: cannot be made ({error}); {ROOT}") from None

    return Step("folder", f"make the folder {path}" + (f" for {owner}" if owner else ""), carry_out)


def remove(path: Path) -> Step:
    """Return a step that removes a file if it exists."""

    def carry_out() -> None:
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise StepError(f"{path}: cannot be removed ({error.strerror}); {ROOT}") from None

    return Step("remove", f"remove {path}", carry_out)


def run(*command: str) -> Step:
    """Return a step that runs a program of the system; its error has the program's output."""
    line = " ".join(command)

    def carry_out() -> None:
        path = os.pathsep.join((os.environ.get("PATH", ""), "/usr/sbin", "/sbin"))
        environment = os.environ | {"PATH": path}
        try:
            subprocess.run(command, env=environment, capture_output=True, text=True, timeout=COMMAND_S, check=True)
        except (OSError, subprocess.SubprocessError) as error:
            cause: object = error
            if isinstance(error, subprocess.CalledProcessError):
                cause = (error.stderr or error.stdout).strip() or f"exit code {error.returncode}"
            raise StepError(f"{line}: {cause}; correct it, then install again") from None

    return Step("run", f"run {line}", carry_out)


def keep(path: Path, why: str) -> Step:
    """Return a step that keeps a file or folder, for a stated reason."""
    return Step("keep", f"keep {path}: {why}", lambda: None)
