"""Sweeps of training runs: `softarm train --sweep`."""

from pathlib import Path

import click

from softarm.cli.shared.interrupt import leaves
from softarm.cli.shared.options import typed
from softarm.common.processes import bar, cores


def train_sweep(file: Path, out: Path, processes: int, ray_address: str | None) -> None:
    """Train the unfinished runs of a sweep and write OUT/results.json and OUT/results.md."""
    from softarm.training.record import tensorboard
    from softarm.training.run import sweep

    if missing := tensorboard.missing():
        click.secho(missing, fg="yellow")
    leaves(f"finished runs are kept in {out}; the same command continues with the others")
    sweep.refuse_beside(typed())
    configured = sweep.load(file)
    todo, results = sweep.plan(configured, out, max(1, cores() // processes))
    with bar("training", len(todo) + len(results), done=len(results), stay=True) as shown:
        for result in sweep.on_ray(todo, ray_address) if ray_address else sweep.locally(todo, processes):
            results.append(result)
            shares = ", ".join(f"{name} {share:.1%}" for name, share in result.test.items())
            click.echo(f"{result.name}, seed {result.seed}: validation {result.validation:.1%}; {shares}")
            shown.advance()
    click.echo(f"{sweep.save(configured, results, out)}wrote {out / 'results.json'} and {out / 'results.md'}")
