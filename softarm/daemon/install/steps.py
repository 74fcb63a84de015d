"""The steps of an installation: each can be summarised, shown in full and carried out."""

import difflib
import os
import shutil
import subprocess
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from softarm.common import files

COMMAND_S = 60.0
ROOT = "root is required (or --root FOLDER)"


class StepError(Exception):
    """A failed step, with the cause and what to do."""


class Step(ABC):
    """A step of an installation; as text it is its summary in one line."""

    __slots__ = ()

    @abstractmethod
    def __str__(self) -> str: ...

    @property
    def shown(self) -> list[str]:
        """Return the details line by line, if there are any."""
        return []

    @abstractmethod
    def carry_out(self) -> None:
        """Carry out the step, or raise StepError."""


@dataclass(frozen=True, slots=True)
class Write(Step):
    """Write a text to a file."""

    path: Path
    text: str
    before: str | None = None  # present text; None for a new file

    def __str__(self) -> str:
        return f"{'write' if self.before is None else 'change'} {self.path}"

    @property
    def shown(self) -> list[str]:
        """Return a new file's lines or a changed file's differences."""
        if self.before is None:
            return self.text.splitlines()
        return list(
            difflib.unified_diff(self.before.splitlines(), self.text.splitlines(), "now", "new", lineterm="", n=1)
        )

    def carry_out(self) -> None:
        """Carry out the step, or raise StepError."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            files.write_text(self.path, self.text)
            self.path.chmod(0o644)
        except OSError as error:
            raise StepError(f"{self.path}: cannot be written ({error.strerror}); {ROOT}") from None


@dataclass(frozen=True, slots=True)
class Folder(Step):
    """Create a folder for a user."""

    path: Path
    owner: str | None  # None for the installing user

    def __str__(self) -> str:
        return f"make the folder {self.path}" + (f" for {self.owner}" if self.owner else "")

    def carry_out(self) -> None:
        """Create the folder and keep its content, or raise StepError."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self.path.chmod(0o750)
            if self.owner is not None:
                shutil.chown(self.path, self.owner, self.owner)
        except (OSError, LookupError) as error:
            raise StepError(f"{self.path}: cannot be made ({error}); {ROOT}") from None


@dataclass(frozen=True, slots=True)
class Remove(Step):
    """Remove a file if it exists."""

    path: Path

    def __str__(self) -> str:
        return f"remove {self.path}"

    def carry_out(self) -> None:
        """Carry out the step, or raise StepError."""
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            raise StepError(f"{self.path}: cannot be removed ({error.strerror}); {ROOT}") from None


@dataclass(frozen=True, slots=True)
class Run(Step):
    """Run a program of the system."""

    command: tuple[str, ...]

    def __str__(self) -> str:
        return f"run {' '.join(self.command)}"

    def carry_out(self) -> None:
        """Run the program, or raise StepError with its output."""
        path = os.pathsep.join((os.environ.get("PATH", ""), "/usr/sbin", "/sbin"))
        environment = os.environ | {"PATH": path}
        try:
            subprocess.run(self.command, env=environment, capture_output=True, text=True, timeout=COMMAND_S, check=True)
        except (OSError, subprocess.SubprocessError) as error:
            cause: object = error
            if isinstance(error, subprocess.CalledProcessError):
                cause = (error.stderr or error.stdout).strip() or f"exit code {error.returncode}"
            raise StepError(f"{' '.join(self.command)}: {cause}; correct it, then install again") from None


@dataclass(frozen=True, slots=True)
class Keep(Step):
    """Keep a file or folder, for a stated reason."""

    path: Path
    why: str

    def __str__(self) -> str:
        return f"keep {self.path}: {self.why}"

    def carry_out(self) -> None:
        """Do nothing with the path."""
