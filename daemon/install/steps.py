"""The steps of an installation: each can be told, shown in full, or carried out."""

import difflib
import os
import shutil
import subprocess
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from softarm.common import files

COMMAND_S = 60.0


class StepError(Exception):
    """A step that failed; says why and what to do."""


class Step(ABC):
    """One of them."""

    __slots__ = ()

    @property
    @abstractmethod
    def told(self) -> str:
        """In a line."""

    @property
    def shown(self) -> list[str]:
        """All of it, where there is more to it than the line."""
        return []

    @abstractmethod
    def carry_out(self) -> None:
        """Do it. Raises StepError."""


@dataclass(frozen=True, slots=True)
class Write(Step):
    """A file is given this text."""

    path: Path
    text: str
    before: str | None = None  # what it held; None: it is new
    mode: int = 0o644

    @property
    def told(self) -> str:
        """In a line."""
        return f"{'write' if self.before is None else 'change'} {self.path}"

    @property
    def shown(self) -> list[str]:
        """All of it: a new file's lines, a changed one's differences."""
        if self.before is None:
            return self.text.splitlines()
        return list(
            difflib.unified_diff(self.before.splitlines(), self.text.splitlines(), "now", "new", lineterm="", n=1)
        )

    def carry_out(self) -> None:
        """Raises StepError."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            files.write_text(self.path, self.text)
            self.path.chmod(self.mode)
        except OSError as error:
            raise StepError(f"{self.path}: cannot be written ({error.strerror}); {_ROOT}") from None


@dataclass(frozen=True, slots=True)
class Folder(Step):
    """A folder is there, and a user's."""

    path: Path
    owner: str | None  # None: who installs
    mode: int = 0o750

    @property
    def told(self) -> str:
        """In a line."""
        return f"make the folder {self.path}" + (f" for {self.owner}" if self.owner else "")

    def carry_out(self) -> None:
        """What is in it stays. Raises StepError."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self.path.chmod(self.mode)
            if self.owner is not None:
                shutil.chown(self.path, self.owner, self.owner)
        except (OSError, LookupError) as error:
            raise StepError(f"{self.path}: cannot be made ({error}); {_ROOT}") from None


@dataclass(frozen=True, slots=True)
class Remove(Step):
    """A file is taken away."""

    path: Path

    @property
    def told(self) -> str:
        """In a line."""
        return f"remove {self.path}"

    def carry_out(self) -> None:
        """Raises StepError."""
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            raise StepError(f"{self.path}: cannot be removed ({error.strerror}); {_ROOT}") from None


@dataclass(frozen=True, slots=True)
class Run(Step):
    """A program of the system."""

    command: tuple[str, ...]

    @property
    def told(self) -> str:
        """In a line."""
        return f"run {' '.join(self.command)}"

    def carry_out(self) -> None:
        """Raises StepError with what it printed."""
        path = os.pathsep.join((os.environ.get("PATH", ""), "/usr/sbin", "/sbin"))
        try:
            subprocess.run(
                self.command,
                env=os.environ | {"PATH": path},
                capture_output=True,
                text=True,
                timeout=COMMAND_S,
                check=True,
            )
        except subprocess.CalledProcessError as error:
            said = (error.stderr or error.stdout).strip() or f"exit code {error.returncode}"
            raise StepError(f"{' '.join(self.command)}: {said}; mend it, then install again") from None
        except (OSError, subprocess.TimeoutExpired) as error:
            raise StepError(f"{' '.join(self.command)}: {error}; mend it, then install again") from None


@dataclass(frozen=True, slots=True)
class Keep(Step):
    """Nothing is done to a thing, and why."""

    path: Path
    why: str

    @property
    def told(self) -> str:
        """In a line."""
        return f"keep {self.path}: {self.why}"

    def carry_out(self) -> None:
        """Leave it."""


_ROOT = "it takes root, or --root FOLDER"
