"""`softarm train`: learn a policy on the simulator and leave it as an ONNX file; or many at once."""

from pathlib import Path

import click

from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.options import FILE, FOLDER, model_option
from softarm.cli.printing import waiting
from softarm.cli.sweeps import train_sweep
from softarm.common.processes import bar, cores


@click.command()
@click.argument("task", required=False)
@click.option("--task", "task_option", hidden=True, help="The same as the argument.")
@click.option("--wide", is_flag=True, help="Short for the task reach-wide: z up to 0.80 m, starts all along the rail.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of everything random.")
@click.option("--frames", type=click.IntRange(min=1), help="Stop after so many control steps of single robots.")
@click.option("--minutes", type=click.FloatRange(min=0, min_open=True), help="Stop after so many minutes.")
@click.option("--robots", type=click.IntRange(min=8), help="Side by side.  [default: the recipe's, 1024 or 2048]")
@click.option("--device", help="Where the network learns: cpu, or cuda for a graphics card.  [default: cpu]")
@model_option
@click.option(
    "--out",
    type=FOLDER,
    help="For checkpoints, curve, report and policy.  [default: runs/TASK-SEED, runs/TASK-MODEL-SEED, runs/SWEEP]",
)
@click.option("--resume", is_flag=True, help="Go on from the folder's last checkpoint.")
@click.option(
    "--sweep", type=FILE, help="Train all runs of this file instead, seeds x configurations; started again, it goes on."
)
@click.option("--workers", type=click.IntRange(min=1), help="Of a sweep: runs side by side.  [default: one a core]")
@click.option("--ray", "ray_address", help="Of a sweep: run on this Ray cluster; 'local' starts one here.")
def train(
    task: str | None,
    task_option: str | None,
    wide: bool,
    seed: int,
    frames: int | None,
    minutes: float | None,
    robots: int | None,
    device: str | None,
    model_file: Path | None,
    out: Path | None,
    resume: bool,
    sweep: Path | None,
    workers: int | None,
    ray_address: str | None,
) -> None:
    """Train the tip to swing to a target: in free space (reach, reach-wide, reach-robust) or into a shelf (shelf).

    Without --frames or --minutes it takes as many frames as the shipped policy did. Of the checkpoints, the one is
    exported that does best on a validation set of random targets and starts, never on the test trials. With
    --model it is trained, validated and tested on that simulator, with all its effects; the policy's file names it.

    \b
    Examples:
      softarm train reach
      softarm train reach --wide --seed 3 --minutes 5
      softarm train reach --model no-delay
      softarm train shelf --out runs/mine --resume
      softarm train --sweep benchmarks/ablation.yaml --out runs/ablation
    """
    if sweep is not None:
        train_sweep(sweep, out or Path("runs") / sweep.stem, workers or cores(), ray_address)
        return
    name = task or task_option
    if name is None:
        raise click.UsageError("give a task, e.g. `softarm train reach`, or a file with --sweep")
    if wide and name not in ("reach", "reach-wide"):
        raise click.UsageError(f"--wide is for reach, not for {name}")

    from softarm.simulator.model_file import ModelFileError
    from softarm.training.learn import inference
    from softarm.training.record import tensorboard
    from softarm.training.run.checkpoint import CheckpointError
    from softarm.training.run.ending import ending
    from softarm.training.run.recipe import begin, named

    name = "reach-wide" if wide else name
    try:
        recipe = named(name)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    recipe = recipe.changed(model_file, {"run.robots": robots, "run.device": device})
    folder = out or Path("runs") / "-".join((name, *([model_file.stem] if model_file else []), str(seed)))
    if not resume and (folder / "latest.pt").exists():
        fail(f"{folder} holds a run already: add --resume to go on with it, or give another --out")
    leaves(lambda: _left(folder))
    with inference.workers() as pool:
        try:
            with waiting("making robots and network"):
                session = begin(recipe, seed, folder, pool, resume)
        except (CheckpointError, ModelFileError, ValueError) as error:
            fail(str(error))
        if missing := tensorboard.missing():
            click.secho(missing, fg="yellow")
        end = frames or (None if minutes else recipe.frames)
        with bar("starting", float(end or 0) if minutes is None else 60 * minutes, stay=True) as shown:
            policy = session.run(
                end, minutes, lambda now: shown.show(now.seconds if minutes else now.frames, text=now.sentence)
            )
        for line in ending(session, policy):
            click.echo(line)


def _left(folder: Path) -> str:
    if not (folder / "latest.pt").exists():
        return f"no checkpoint yet, so nothing to go on with; {folder} may be deleted"
    return f"the newest checkpoint is in {folder}; the same command with --resume goes on from there"
