"""Count lines, words and functions of this checkout or of another one, by package.

python -m tools.sizes                 this checkout
python -m tools.sizes ../before       another checkout, for a table of before and after
"""

import ast
import subprocess
from pathlib import Path
from typing import NamedTuple

import click
from rich.console import Console
from rich.table import Table

from softarm.common.revision import CHECKOUT

LONG_FUNCTION_LINES = 50


class Size(NamedTuple):
    """Python lines and files of a package, and of its tests."""

    lines: int
    files: int
    test_lines: int


def packages(root: Path) -> dict[str, Size]:
    """Return the size of every package, of everything next to the package, and the totals."""
    names = _tracked(root)
    inside = {name.split("/")[1] for name in names if name.startswith("softarm/") and name.count("/") > 1}
    outside = {name.split("/")[0] for name in names if "/" in name} - {"softarm", "tests", "docs"}
    places = {name: f"softarm/{name}/" for name in sorted(inside)} | {name: f"{name}/" for name in sorted(outside)}
    sizes = {}
    for name, place in places.items():
        code = [each for each in names if each.startswith(place)]
        tests = [each for each in names if each.startswith(f"tests/{name}/")]
        if code:
            sizes[name] = Size(_lines(root, code), len(code), _lines(root, tests))
    rest = [name for name in names if name.startswith("tests/")]
    lines, files = (sum(column) for column in list(zip(*sizes.values(), strict=True))[:2])
    sizes["total"] = Size(lines, files, _lines(root, rest))
    return sizes


def counts(root: Path) -> dict[str, int]:
    """Return the counts that belong to no package: words, long functions, thresholds, named constants."""
    modules = [ast.parse((root / name).read_bytes()) for name in _tracked(root) if not name.startswith("tests/")]
    functions = [
        node
        for module in modules
        for node in ast.walk(module)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    pages = [root / name for name in _listed(root, "*.md") if name != "CHANGELOG.md" and not (root / name).is_symlink()]
    return {
        "words in pages": sum(len(page.read_text(encoding="utf-8").split()) for page in pages),
        "pages": len(pages),
        "functions": len(functions),
        f"functions over {LONG_FUNCTION_LINES} lines": sum(_length(each) > LONG_FUNCTION_LINES for each in functions),
        "thresholds of the diagnosis": _thresholds(root),
        "named numeric constants": sum(_constants(module) for module in modules),
    }


def _tracked(root: Path) -> list[str]:
    return [name for name in _listed(root, "*.py") if not name.startswith("docs/") and not (root / name).is_symlink()]


def _listed(root: Path, pattern: str) -> list[str]:
    done = subprocess.run(["git", "ls-files", pattern], cwd=root, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def _lines(root: Path, names: list[str]) -> int:
    return sum(len((root / name).read_text(encoding="utf-8").splitlines()) for name in names)


def _length(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def _constants(module: ast.Module) -> int:
    """Return how many upper-case names at the top of a module are bound to a number."""
    found = 0
    for node in module.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant | ast.BinOp | ast.UnaryOp):
            is_text = isinstance(node.value, ast.Constant) and not isinstance(node.value.value, int | float)
            found += sum(isinstance(name, ast.Name) and name.id.isupper() and not is_text for name in node.targets)
    return found


def _thresholds(root: Path) -> int:
    """Return how many fields the engine's record of thresholds has."""
    (file,) = [root / name for name in _tracked(root) if name.endswith("diagnosis/engine/thresholds.py")]
    records = (node for node in ast.parse(file.read_bytes()).body if isinstance(node, ast.ClassDef))
    return sum(isinstance(line, ast.AnnAssign) for record in records for line in record.body)


@click.command()
@click.argument("root", default=CHECKOUT, type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(root: Path) -> None:
    """Print the sizes of a checkout, by package.

    \b
    Example:
      python -m tools.sizes
    """
    table = Table("package", "lines", "files", "lines of tests")
    for name, size in packages(root).items():
        table.add_row(name, *map(str, size))
    Console().print(table)
    for what, count in counts(root).items():
        click.echo(f"{what}: {count}")


if __name__ == "__main__":
    main()
