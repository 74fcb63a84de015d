"""Files and modules named in docstrings, comments and pages exist."""

import ast
import re
import subprocess
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tools.prose import documented

ROOT = Path(__file__).parents[2]
LISTED = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
FILES = {name for name in LISTED if (ROOT / name).is_file()}
FOLDERS = {str(folder) for name in FILES for folder in Path(name).parents}
# Every file and folder, relative to each folder that holds it.
ENDS = {name.split("/", depth)[-1] for name in (*FILES, *FOLDERS) for depth in range(name.count("/") + 1)}
PACKAGES = {name.split("/")[1] for name in FILES if name.startswith("softarm/")}
TOP = PACKAGES | {name.partition("/")[0] for name in FILES if "/" in name}
# A path, or the file name of a module.
PATH = re.compile(r"(?<![\w./*<{~-])((?:[\w.-]+/)+[\w.-]*\w|[\w-]+\.py)(?![\w*{<(])")
DOTTED = re.compile(r"\bsoftarm((?:\.\w+)+)")
PLACEHOLDER = re.compile(r"\b[A-Z]+\b")


def prose(file: Path) -> Iterator[str]:
    """Yield the text of a page, or the docstrings and comments of a module."""
    if file.suffix == ".md":
        yield file.read_text(encoding="utf-8")
        return
    if not missing(file.read_text(encoding="utf-8")):
        return  # parsing every module takes seconds
    for node in documented(ast.parse(file.read_bytes())):
        yield ast.get_docstring(node) or ""
    with file.open("rb") as lines:
        yield from (token.string for token in tokenize.tokenize(lines.readline) if token.type == tokenize.COMMENT)


def is_present(path: str) -> bool:
    """Return whether a path, absolute or relative to any folder, exists in the repository, or is no path at all."""
    path = path.removeprefix("../").removeprefix("softarm/")
    if not path.endswith(".py") and path.partition("/")[0] not in TOP:
        return True  # another project's path, or a unit such as m/s
    return path in ENDS


def is_known(dotted: list[str]) -> bool:
    """Return whether a dotted name is a module, or a name in one."""
    place = ROOT / "softarm"
    if dotted[0] not in PACKAGES:
        return True
    while dotted and (place / dotted[0]).is_dir():
        place, dotted = place / dotted[0], dotted[1:]
    module = place / "__init__.py"
    if dotted and (place / f"{dotted[0]}.py").is_file():
        module, dotted = place / f"{dotted[0]}.py", dotted[1:]
    return not dotted or dotted[0] in words(module)


@cache
def words(module: Path) -> set[str]:
    """Return the words of a module."""
    return set(re.findall(r"\w+", module.read_text(encoding="utf-8")))


def missing(text: str) -> list[str]:
    """Return the files and names in a text that do not exist."""
    paths = (found for found in PATH.findall(text) if not is_present(found))
    names = (found[0] for found in DOTTED.finditer(text) if not is_known(found[1][1:].split(".")))
    return [name for name in (*paths, *names) if not PLACEHOLDER.search(name)]


@pytest.mark.slow
def test_every_named_file_and_module_exists():
    wrong = {
        name: stale
        for name in sorted(FILES)
        if name.endswith((".py", ".md")) and name != "CHANGELOG.md"  # names older files
        for text in prose(ROOT / name)
        if (stale := missing(text))
    }
    assert wrong == {}
