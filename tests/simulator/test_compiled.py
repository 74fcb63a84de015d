"""A stale compiled kernel never runs; tests with copies of the package."""

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from softarm.simulator import compiled, kernel
from softarm.simulator.kernel.compiled import SOURCES

SIMULATOR = Path(kernel.__file__).parents[1]
PACKAGE = SIMULATOR.parent
ROOT = PACKAGE.parent
# Two files, `law` inlined into `entry`: numba by itself looks at the second alone, which does not change.
MADE = """
from pathlib import Path
from softarm.simulator.compiled import compiler
compiled = compiler(*(Path(__file__).with_name(name) for name in ("law.py", "entry.py")))
"""
LAW = "from made import compiled\n@compiled\ndef law(x): return 2 * x\n"
ENTRY = "from made import compiled\nfrom law import law\n@compiled\ndef entry(x): return law(x)\n"


def process(code, path):
    """Start Python in a folder, with the modules in it before softarm's."""
    # Python's own cache distinguishes versions of a file by the second and the length only.
    env = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    env |= {"PYTHONPATH": f"{path}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": "1"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([sys.executable, "-c", code], cwd=path, env=env, text=True, **pipes)


def answer(started):
    """Return what a process printed; it must not have complained."""
    with started:
        out, complaints = started.communicate(timeout=120)
    assert (started.returncode, complaints) == (0, "")
    return out.split()


def kept(folder):
    return sorted(path.name for path in folder.rglob("*.nbi"))


def test_the_kernels_stamp_covers_every_imported_project_file():
    code = (
        "import sys, softarm.simulator.kernel; print(*(m.__file__ for n, m in sys.modules.items() if 'softarm.' in n))"
    )
    files = map(Path, answer(process(code, ROOT)))
    assert set(files) - {SIMULATOR / "__init__.py"} == set(SOURCES)


def test_no_function_is_kept_by_numbas_own_cache():
    for file in PACKAGE.rglob("*.py"):
        assert not re.search(r"^ *@.*\bcache=True", file.read_text(), re.MULTILINE), file


@pytest.fixture
def package(tmp_path, monkeypatch):
    """The two files in a folder of their own; the user's cache would lie in `home` beside it."""
    folder = tmp_path / "package"
    folder.mkdir()
    for name, text in (("made", MADE), ("law", LAW), ("entry", ENTRY)):
        (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(compiled.numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    compiled._warn_once.cache_clear()
    yield folder
    forget()


def forget():
    for name in ("made", "law", "entry"):
        sys.modules.pop(name, None)


def entry():
    """The function as a process that starts now would have it."""
    forget()
    importlib.invalidate_caches()
    return importlib.import_module("entry").entry


def hits(function):
    return sum(function.stats.cache_hits.values())


def edit(package):
    (package / "law.py").write_text(LAW.replace("2 * x", "3 * x"))


def test_a_cached_function_is_reused_and_deleted_after_an_edit(package):
    assert entry()(1.0) == 2.0
    before, again = kept(package), entry()
    assert (again(1.0), hits(again)) == (2.0, 1)
    edit(package)
    assert entry()(1.0) == 3.0
    assert len(kept(package)) == len(before) == 2
    assert not set(kept(package)) & set(before)


def test_another_version_compiles_again(package, monkeypatch):
    entry()(1.0)
    monkeypatch.setattr(compiled, "VERSIONS", (*compiled.VERSIONS[:-1], "another"))
    new = entry()
    assert (new(1.0), hits(new)) == (2.0, 0)


def test_a_process_older_than_an_edit_saves_no_old_code(package):
    old = entry()
    edit(package)
    assert entry()(1.0) == 3.0
    assert old(1) == 2
    assert entry()(1) == 3


# One process reads the index; before it writes, another has compiled for another type and saved, if it may.
SLOW = """
import os, time
from numba.core.caching import IndexDataCacheFile
from entry import entry
save = IndexDataCacheFile._save_index
def late(self, overloads):
    if "entry" in self._index_name:
        open("reading", "w").close()
        until = time.monotonic() + 1.0
        while not os.path.exists("saved") and time.monotonic() < until:
            time.sleep(0.01)
    save(self, overloads)
IndexDataCacheFile._save_index = late
print(entry(1))
"""
QUICK = """
import os, time
from entry import entry
while not os.path.exists("reading"):
    time.sleep(0.01)
print(entry(1.0))
open("saved", "w").close()
"""


@pytest.mark.prove
def test_two_processes_can_save_at_the_same_time(package):
    slow, quick = (process(code, package) for code in (SLOW, QUICK))
    assert (answer(slow), answer(quick)) == (["2"], ["2.0"])
    again = entry()
    assert (again(1), again(1.0), hits(again)) == (2, 2.0, 2)


def test_a_read_only_package_uses_the_users_cache_and_warns_once(package, caplog):
    (package / "__pycache__").touch()  # no folder can be made there, not even by root
    home = package.with_name("home")
    assert entry()(1.0) == 2.0
    (said,) = (record.getMessage() for record in caplog.records)
    assert f"{package} cannot be written" in said
    assert str(home) in said
    before, again = kept(home), entry()
    assert (again(1.0), hits(again)) == (2.0, 1)
    edit(package)
    assert entry()(1.0) == 3.0
    assert len(kept(home)) == len(before) == 2
    assert len(caplog.records) == 1


def test_without_a_writable_cache_each_start_compiles_and_warns_once(package, caplog):
    (package / "__pycache__").touch()
    package.with_name("home").touch()
    assert entry()(1.0) == 2.0
    edit(package)
    assert entry()(1.0) == 3.0
    (said,) = (record.getMessage() for record in caplog.records)
    assert "set NUMBA_CACHE_DIR" in said


def test_the_first_compile_is_announced_once(package, caplog):
    compiled._inform_once.cache_clear()
    with caplog.at_level("INFO", compiled.__name__):
        assert entry()(1.0) == 2.0
        assert [record.getMessage() for record in caplog.records] == [compiled.COMPILING]
        forget()
        compiled._inform_once.cache_clear()
        assert entry()(1.0) == 2.0
    assert [record.getMessage() for record in caplog.records] == [compiled.COMPILING]
