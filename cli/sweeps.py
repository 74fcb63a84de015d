"""Many training runs: `softarm train --sweep`."""

from pathlib import Path

import click

from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.options import typed
from softarm.common.processes import bar, cores


def train_sweep(file: Path, out: Path, processes: int, ray_address: str | None) -> None:
    """Train what is not finished; leave OUT/results.json and OUT/results.md."""
    from softarm.training.record import tensorboard
    from softarm.training.run import sweep

    if missing := tensorboard.missing():
        click.secho(missing, fg="yellow")
    leaves(f"finished runs are kept in {out}; the same command goes on with the others")
    try:
        sweep.refuse_beside(typed())
        wanted = sweep.load(file)
        todo, results = sweep.plan(wanted, out, max(1, cores() // processes))
        with bar("training", len(todo) + len(results), done=len(results), stay=True) as shown:
            for result in sweep.on_ray(todo, ray_address) if ray_address else sweep.locally(todo, processes):
                results.append(result)
                shares = ", ".join(f"{name} {share:.1%}" for name, share in result.test.items())
                click.echo(f"{result.name}, seed {result.seed}: validation {result.validation:.1%}; {shares}")
                shown.advance()
    except sweep.SweepError as error:
        fail(str(error))
    click.echo(f"{sweep.save(wanted, results, out)}wrote {out / 'results.json'} and {out / 'results.md'}")
