"""Run a command and store its figures in benchmarks/results/.

    python -m benchmarks.keep grid-reach -- softarm evaluate reach

Stored is the file that the command writes with `--json FILE`.
"""

import json
import shlex
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from benchmarks import results

# A checkout without installation has no `softarm` on its path.
STARTED = {"python": [sys.executable], "softarm": [sys.executable, "-m", "softarm.cli.main"]}


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--without", multiple=True, metavar="KEY", help="Leave this out of what is kept; again for more.")
@click.argument("name")
@click.argument("command", nargs=-1, required=True, type=click.UNPROCESSED)
def main(without: tuple[str, ...], name: str, command: tuple[str, ...]) -> None:
    """Run COMMAND, which takes `--json FILE`, and store its figures as NAME.

    \b
    Example:
      python -m benchmarks.keep --without targets grid-reach -- softarm evaluate reach
    """
    try:
        results.depends_on(name)
    except KeyError:
        raise click.ClickException(f"unknown result {name}: add it to DEPENDS in benchmarks/results.py") from None
    with TemporaryDirectory() as folder:
        written = Path(folder) / "figures.json"
        program = [*STARTED.get(command[0], [command[0]]), *command[1:]]
        done = subprocess.run([*program, "--json", str(written)], check=False)
        if done.returncode or not written.exists():
            raise click.ClickException(f"{shlex.join(command)} ended with {done.returncode}; nothing was kept")
        figures = json.loads(written.read_text(encoding="utf-8"))
    kept = {key: value for key, value in figures.items() if key not in (*without, "about")}
    results.write(results.FOLDER / f"{name}.json", kept, shlex.join(command))
    click.echo(f"kept {name}; `python -m tools.render` puts it into the pages")


if __name__ == "__main__":
    main()
