"""Identity of the software and the computer, as recorded in logs, policies and results."""

import hashlib
import importlib.metadata
import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from softarm import __version__
from softarm.common.files import sha256_of

PACKAGE = Path(__file__).resolve().parents[1]
CHECKOUT = PACKAGE.parent
# Time limit of git, also on a busy computer.
GIT_S = 10.0
# Files that decide results.
_CODE = (".py", ".yaml", ".json", ".onnx", ".npz", ".js", ".css")


def revision(root: Path = CHECKOUT) -> str:
    """Return the running commit, with `+changes` if files are edited, or the version outside a checkout.

    An installed softarm may be inside a checkout of another project, whose commit is irrelevant.
    """
    unknown = f"unknown, softarm {__version__}"
    if not (root / ".git").exists():
        return unknown
    command = ["git", "describe", "--always", "--abbrev=40", "--dirty=+changes", "--exclude=*"]
    # The variables that git sets for a hook name another repository.
    env = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        done = subprocess.run(command, cwd=root, env=env, capture_output=True, text=True, timeout=GIT_S, check=True)
    # No git, or a checkout that git does not trust.
    except (OSError, subprocess.SubprocessError):
        return unknown
    return done.stdout.strip()


def software(packages: Iterable[str] = ()) -> dict[str, str]:
    """Return the versions of softarm, Python and other packages (`not installed` for a missing one)."""
    return {
        "softarm": __version__,
        "git_revision": revision(),
        "python": sys.version.split()[0],
        **{name: _version(name) for name in packages},
    }


@lru_cache
def code_version(*packages: str) -> str:
    """Return the version of softarm with a hash of its code and policies, or of some of its packages.

    Equal texts mean equal results, wherever a job ran.
    """
    roots = [PACKAGE / name for name in packages or ("",)]
    found = sorted(path for root in roots for path in root.rglob("*") if path.suffix in _CODE)
    lines = [f"{path.relative_to(PACKAGE)} {sha256_of(path)}" for path in found]
    return f"{__version__}+{hashlib.sha256(chr(10).join(lines).encode()).hexdigest()[:12]}"


def machine() -> dict[str, str]:
    """Return the name and kind of this computer."""
    return {"name": platform.node(), "system": platform.platform(), "processor": platform.machine()}


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
