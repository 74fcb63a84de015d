"""What software this is and where it runs: for the status and for the head of every log."""

import platform
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("numpy", "onnxruntime", "pyserial", "eclipse-zenoh", "pydantic", "mcap", "fastapi", "uvicorn")


def package_version(name: str) -> str:
    """Version of an installed distribution, or `not installed`."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def git_revision() -> str:
    """Commit that this runs from, with `+changes` when edited since; `unknown` outside a source tree."""
    here = Path(__file__).resolve().parent
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--abbrev=40", "--dirty=+changes", "--exclude=*"],
            cwd=here,
            capture_output=True,
            text=True,
            timeout=2.0,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return described.stdout.strip() or "unknown"


def software() -> dict[str, str]:
    """Versions of this program, of Python and of what the daemon stands on."""
    return {
        "softarm": package_version("softarm"),
        "git_revision": git_revision(),
        "python": sys.version.split()[0],
        **{name: package_version(name) for name in PACKAGES},
    }


def machine() -> dict[str, str]:
    """The computer's name and kind."""
    return {"name": platform.node(), "system": platform.platform(), "processor": platform.machine()}
