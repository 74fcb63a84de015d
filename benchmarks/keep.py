"""Run a command and keep its figures in benchmarks/results/, with where they come from.

    python -m softarm.benchmarks.keep grid-reach -- softarm evaluate --policy reach

What is kept is what the command writes to `--json FILE`.
"""

import json
import shlex
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from softarm.benchmarks import results

# A checkout that is not installed has no `softarm` on its path.
STARTED = {"python": [sys.executable], "softarm": [sys.executable, "-m", "softarm.cli.main"]}


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--without", multiple=True, metavar="KEY", help="Leave this out of what is kept; again for more.")
@click.argument("name")
@click.argument("command", nargs=-1, required=True, type=click.UNPROCESSED)
def main(without: tuple[str, ...], name: str, command: tuple[str, ...]) -> None:
    """Run COMMAND, which takes `--json FILE`, and keep what it writes as NAME.

    \b
    Example:
      python -m softarm.benchmarks.keep --without targets grid-reach -- softarm evaluate --policy reach
    """
    with TemporaryDirectory() as folder:
        written = Path(folder) / "figures.json"
        program = [*STARTED.get(command[0], [command[0]]), *command[1:]]
        done = subprocess.run([*program, "--json", str(written)], check=False)
        if done.returncode or not written.exists():
            raise click.ClickException(f"{shlex.join(command)} ended with {done.returncode}; nothing was kept")
        figures = json.loads(written.read_text(encoding="utf-8"))
    kept = {key: value for key, value in figures.items() if key not in (*without, "about")}
    results.write(results.FOLDER / f"{name}.json", kept, shlex.join(command))
    click.echo(f"kept {name}; `python -m softarm.benchmarks.results` puts it into the pages")


if __name__ == "__main__":
    main()
