"""This computer, or a folder in the place of one, as an installation finds it; and systemd's word on a unit."""

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
    """Of this computer where root is /."""
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
    """A file's text; None where there is none. Raises StepError for one that cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise StepError(f"{path}: cannot be read ({error}); it takes root") from None


def verify(unit: str) -> str | None:
    """What `systemd-analyze verify` has against a unit; None: nothing, or it is not here to be asked."""
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
    said = "\n".join(line for line in done.stderr.splitlines() if UNIT_PATH.name in line)
    return said.replace(f"{folder}/", "") or None if done.returncode or said else None
