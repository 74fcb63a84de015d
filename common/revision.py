"""Which software this is and where it runs, as logs, policies and results record it."""

import importlib.metadata
import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from softarm import __version__

ROOT = Path(__file__).resolve().parents[1]  # of a checkout; of what is installed, the package
GIT_S = 10.0  # on a machine with other work


def revision(root: Path = ROOT) -> str:
    """The commit that this runs from, with `+changes` when edited since; outside a checkout of ours the version.

    An installed softarm may lie in a checkout of its user's, which says nothing of it.
    """
    unknown = f"unknown, softarm {__version__}"
    if not (root / ".git").exists():
        return unknown
    command = ["git", "describe", "--always", "--abbrev=40", "--dirty=+changes", "--exclude=*"]
    # Git's own variables, as a hook sets them, name another repository.
    env = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        done = subprocess.run(command, cwd=root, env=env, capture_output=True, text=True, timeout=GIT_S, check=True)
    except (OSError, subprocess.SubprocessError):  # no git, or a checkout that it does not trust
        return unknown
    return done.stdout.strip()


def software(packages: Iterable[str] = ()) -> dict[str, str]:
    """Versions of softarm, of Python and of what else is named; `not installed` where it is not."""
    return {
        "softarm": __version__,
        "git_revision": revision(),
        "python": sys.version.split()[0],
        **{name: _version(name) for name in packages},
    }


def machine() -> dict[str, str]:
    """The computer's name and kind."""
    return {"name": platform.node(), "system": platform.platform(), "processor": platform.machine()}


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
