"""A Ray instance of a test: apart from others, and gone after the test."""

import tempfile
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest

import softarm
from tests.processes import gone, until

ROOT = Path(softarm.__file__).parents[1]
# Ray reads its settings when it is imported, so no test module imports it.
WITH_RAY = pytest.mark.skipif(find_spec("ray") is None, reason="needs the extra `ray`")


@contextmanager
def apart():
    """Give Ray a folder with a name short enough for its sockets, and wait for the end of its processes."""
    with tempfile.TemporaryDirectory(prefix="ray-") as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_TMPDIR", folder)
        patch.setenv("RAY_AUTH_MODE", "token")
        patch.setenv("RAY_AUTH_TOKEN", "f" * 64)  # or Ray creates a token in the home folder
        patch.setenv("PYTHONPATH", str(ROOT))
        yield Path(folder)
        until(lambda: not processes(folder), "Ray's processes to end")


def processes(folder):
    """Return the processes of the Ray instance with this folder."""
    found = []
    for each in Path("/proc").glob("[0-9]*"):
        try:
            if f"RAY_TMPDIR={folder}".encode() in (each / "environ").read_bytes() and not gone(int(each.name)):
                found.append(int(each.name))
        except OSError:
            continue  # ended meanwhile, or not ours
    return found
