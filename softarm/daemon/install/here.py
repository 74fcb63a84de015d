"""Facts about this computer, or a folder in its place, for an installation."""

import grp
import os
import pwd
import shutil
import subprocess
import tempfile
from pathlib import Path

from softarm.daemon.install.plan import GROUP, UNIT_PATH, System
from softarm.daemon.install.steps import StepError

VERIFY_S = 60.0


def look(root: Path) -> System:
    """Gather the facts of this computer, or of a folder unless root is /."""
    try:
        members = frozenset(grp.getgrnam(GROUP).gr_mem)
    except KeyError:
        members = frozenset()
    return System(
        root.absolute(),
        read,
        Path.is_dir,
        frozenset(each.pw_name for each in pwd.getpwall()),
        members,
        frozenset(each.gr_name for each in grp.getgrall()),
        Path("/run/systemd/system").is_dir(),
    )


def read(path: Path) -> str | None:
    """Return a file's text, or None if it does not exist. Raises StepError if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise StepError(f"{path}: cannot be read ({error}); root is required") from None


def verify(unit: str) -> str | None:
    """Return the errors of `systemd-analyze verify` for a unit, or None without errors or without that program."""
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / UNIT_PATH.name
        path.write_text(unit, encoding="utf-8")
        done = subprocess.run(
            [analyze, "verify", "--man=no", "--recursive-errors=no", str(path)],
            capture_output=True,
            text=True,
            timeout=VERIFY_S,
            env=os.environ | {"LC_ALL": "C"},
        )
    errors = "\n".join(line for line in done.stderr.splitlines() if UNIT_PATH.name in line)
    return errors.replace(f"{folder}/", "") or None
