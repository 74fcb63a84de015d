"""Fill the tables of the documentation from stored results.

    python -m tools.render            write every table
    python -m tools.render --check    exit with 1 if a page differs from the results

A page marks each table with `<!-- results: NAME -->` and `<!-- /results -->`; NAME is a key of TABLES in
benchmarks/tables.py. Below the table a line states when and on which revision its figures were measured.
"""

import re
from typing import Any

import click

from benchmarks import results
from benchmarks.tables import TABLES
from softarm.common import files
from softarm.common.revision import CHECKOUT

DOCS = CHECKOUT / "docs"
_TABLE = re.compile(r"(<!-- results: ([\w-]+) -->\n).*?(<!-- /results -->)", re.DOTALL)


def rendered(page: str) -> str:
    """Return a page with all its tables filled from the stored results. Raises KeyError for an unknown table."""
    return _TABLE.sub(lambda found: f"{found[1]}{_table(found[2])}{found[3]}", page)


def _table(name: str) -> str:
    measured: dict[str, str] = {}

    def read(result: str) -> dict[str, Any]:
        found = results.read(result)
        about = found["about"]
        origin = "copied from this page" if about.get("transcribed") else "measured"
        measured[f"{origin} {about['date'][:10]} at {about['revision'][:8]}"] = ""
        return found

    table = TABLES[name](read)
    return f"{table}\n*{'; '.join(measured).capitalize()}.*\n"


@click.command()
@click.option("--check", is_flag=True, help="Write nothing; exit with 1 if a page differs from the results.")
def main(check: bool) -> None:
    """Fill the tables of docs/ from the stored results.

    \b
    Example:
      python -m tools.render --check
    """
    stale = False
    for page in sorted(DOCS.rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        if (new := rendered(text)) == text:
            continue
        stale = True
        if not check:
            files.write_text(page, new)
        click.echo(f"{page.name}: {'stale; run python -m tools.render' if check else 'written'}")
    raise SystemExit(check and stale)


if __name__ == "__main__":
    main()
