"""What docstrings, comments and pages name is there: a file that was renamed is renamed in them too."""

import ast
import re
import subprocess
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LISTED = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
FILES = {name for name in LISTED if (ROOT / name).is_file()}
FOLDERS = {str(folder) for name in FILES for folder in Path(name).parents}
TOP = {name.partition("/")[0] for name in FILES if "/" in name}
# A path, or a module's file by its name alone. NAME in capitals and what holds * or {} stands for many.
PATH = re.compile(r"(?<![\w./*<{~-])((?:[\w.-]+/)+[\w.-]*\w|[\w-]+\.py)(?![\w*{<(])")
DOTTED = re.compile(r"\bsoftarm((?:\.\w+)+)")
STANDS_FOR_MANY = re.compile(r"\b[A-Z]+\b")


def prose(file: Path) -> Iterator[str]:
    """A page, or the docstrings and comments of a module."""
    if file.suffix == ".md":
        yield file.read_text(encoding="utf-8")
        return
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield ast.get_docstring(node) or ""
    with file.open("rb") as lines:
        yield from (token.string for token in tokenize.tokenize(lines.readline) if token.type == tokenize.COMMENT)


def is_there(path: str) -> bool:
    """Whether a path, from the top or from any folder, names a file or folder of ours."""
    path = path.removeprefix("softarm/")
    if not path.endswith(".py") and path.partition("/")[0] not in TOP:
        return True  # not of ours, or no path: m/s, and/or
    return path in FILES or path in FOLDERS or any(name.endswith(f"/{path}") for name in FILES)


def is_known(dotted: list[str]) -> bool:
    """Whether a dotted name begins with modules of ours and goes on with a name that stands in the last of them."""
    place = ROOT
    if dotted[0] not in TOP:
        return True
    while dotted and (place / dotted[0]).is_dir():
        place, dotted = place / dotted[0], dotted[1:]
    module = place / "__init__.py"
    if dotted and (place / f"{dotted[0]}.py").is_file():
        module, dotted = place / f"{dotted[0]}.py", dotted[1:]
    return not dotted or re.search(rf"\b{dotted[0]}\b", module.read_text(encoding="utf-8")) is not None


def unknown(text: str) -> list[str]:
    """What a text names that is not there."""
    paths = (found for found in PATH.findall(text) if not is_there(found))
    names = (found[0] for found in DOTTED.finditer(text) if not is_known(found[1][1:].split(".")))
    return [name for name in (*paths, *names) if not STANDS_FOR_MANY.search(name)]


@pytest.mark.slow
def test_every_file_and_name_of_ours_that_prose_names_is_there():
    wrong = {
        name: missing
        for name in sorted(FILES)
        if name.endswith((".py", ".md")) and name != "CHANGELOG.md"  # which tells of what was
        for text in prose(ROOT / name)
        if (missing := unknown(text))
    }
    assert wrong == {}


@pytest.mark.parametrize(
    "stale", ["air" + ".py", "simulator/kernel/air" + ".py", "docs/none.md", "softarm.daemon.nothing"]
)
def test_a_name_of_nothing_is_found(stale):
    assert unknown(f"Drag is in `{stale}`, after 3 m/s.") == [stale]
    assert (
        unknown("Drag is in softarm/simulator/kernel/joints.py, joints.py, docs/ and `softarm.simulator.kernel.rows`.")
        == []
    )
