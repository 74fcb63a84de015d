"""Count the Python lines of this checkout or of another one by package, and the words of its pages.

python -m tools.sizes                 this checkout
python -m tools.sizes ../before       another checkout, for a table of before and after
"""

import ast
import subprocess
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from softarm.common.revision import CHECKOUT

LONG_FUNCTION_LINES = 50


def listed(root: Path, *patterns: str) -> list[str]:
    """Return the files that git tracks, without symbolic links."""
    done = subprocess.run(["git", "ls-files", "--", *patterns], cwd=root, capture_output=True, text=True, check=True)
    return [name for name in done.stdout.splitlines() if not (root / name).is_symlink()]


def package(name: str) -> str:
    """Return the package of a file: the folder inside softarm/ or tests/, or else the first folder."""
    folders = name.split("/")[:-1]
    return "/".join(folders[: 2 if folders[:1] in (["softarm"], ["tests"]) else 1])


def long_functions(source: str) -> int:
    """Return how many functions of a module are longer than LONG_FUNCTION_LINES."""
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    return sum((node.end_lineno or node.lineno) - node.lineno >= LONG_FUNCTION_LINES for node in functions)


@click.command()
@click.argument("root", default=CHECKOUT, type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(root: Path) -> None:
    """Print the sizes of a checkout, by package.

    \b
    Example:
      python -m tools.sizes
    """
    sources = {name: (root / name).read_text(encoding="utf-8") for name in listed(root, "*.py")}
    lines: dict[str, int] = {}
    for name, source in sources.items():
        lines[package(name)] = lines.get(package(name), 0) + len(source.splitlines())
    table = Table("package", "lines")
    for name, count in sorted(lines.items()):
        table.add_row(name, str(count))
    Console().print(table)
    in_tests = sum(count for name, count in lines.items() if name.startswith("tests"))
    pages = [root / name for name in listed(root, "*.md") if name != "CHANGELOG.md"]
    click.echo(f"lines: {sum(lines.values()) - in_tests}, and {in_tests} of tests")
    click.echo(f"functions over {LONG_FUNCTION_LINES} lines: {sum(map(long_functions, sources.values()))}")
    click.echo(f"words in pages: {sum(len(page.read_text(encoding='utf-8').split()) for page in pages)}")


if __name__ == "__main__":
    main()
