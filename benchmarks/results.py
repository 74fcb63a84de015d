"""What measurements leave: figures as JSON with where they come from, and the tables of the pages, made from them.

    python -m softarm.benchmarks.results            write every table anew
    python -m softarm.benchmarks.results --check    fail where a page does not say what the results say

Results lie in benchmarks/results/, a file a measurement. Under `about` stand the software's revision, the machine, the
date and the command; `transcribed` marks figures that were copied from a page and are no stored run: their revision is
the commit at which the page's table was last changed. A page holds `<!-- results: NAME -->` and `<!-- /results -->`
around each table of benchmarks/tables.py and benchmarks/diagnosis_tables.py.
"""

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from softarm.common import files
from softarm.common.processes import cores
from softarm.common.revision import ROOT, machine, revision

FOLDER = Path(__file__).parent / "results"
DOCS = Path(__file__).resolve().parents[1] / "docs"
_TABLE = re.compile(r"(<!-- results: ([\w-]+) -->\n).*?(<!-- /results -->)", re.DOTALL)

FILE = click.Path(path_type=Path, dir_okay=False)
json_option = click.option("--json", "json_file", type=FILE, help="Write the figures to this file.")


def write(file: Path, figures: Mapping[str, Any], command: str | None = None) -> None:
    """Write figures, by name, and where they come from. command: what gave them (default: this program)."""
    about = {
        "revision": measured(),
        "machine": {**machine(), "cpu": _cpu(), "cores": cores()},
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": command or _command(),
    }
    files.write_text(file, json.dumps({"about": about, **figures}, indent=1) + "\n")


def measured(root: Path = ROOT) -> str:
    """The revision that a measurement ran at: results and pages changed since change no figure."""
    aside = [f":(exclude){DOCS.name}", f":(exclude){FOLDER.parent.name}/{FOLDER.name}"]
    same = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", ".", *aside], cwd=root, check=False).returncode == 0
    return revision(root).removesuffix("+changes") if same else revision(root)


def _cpu() -> str:
    """The processor's own name; empty where the system does not say."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def read(name: str, folder: Path = FOLDER) -> dict[str, Any]:
    """A stored result."""
    found: dict[str, Any] = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    return found


def rendered(page: str) -> str:
    """A page with every table as the results have it. Raises KeyError for a table that there is none of."""
    from softarm.benchmarks.tables import TABLES

    return _TABLE.sub(lambda found: f"{found[1]}{TABLES[found[2]](read)}{found[3]}", page)


def _command() -> str:
    """How this program was started: a module of the package by its name, anything else by its file."""
    spec = sys.modules["__main__"].__spec__
    started = ["python", sys.argv[0]] if spec is None else ["python", "-m", spec.name.removesuffix(".__main__")]
    return shlex.join([*started, *sys.argv[1:]])


@click.command()
@click.option("--check", is_flag=True, help="Write nothing; exit code 1 when a page is stale.")
def main(check: bool) -> None:
    """Put the stored results into the tables of docs/.

    \b
    Example:
      python -m softarm.benchmarks.results --check
    """
    stale = [(page, new) for page in sorted(DOCS.glob("*.md")) if (new := rendered(text := _text(page))) != text]
    for page, new in stale:
        if not check:
            files.write_text(page, new)
        click.echo(f"{page.name}: {'stale; run python -m softarm.benchmarks.results' if check else 'written'}")
    raise SystemExit(check and bool(stale))


def _text(page: Path) -> str:
    return page.read_text(encoding="utf-8")


if __name__ == "__main__":
    main()
