"""`softarm train`: train one policy or a sweep in the simulator and export it as ONNX."""

from pathlib import Path

import click

from softarm.cli.shared.errors import fail, failing
from softarm.cli.shared.interrupt import leaves
from softarm.cli.shared.options import FILE, FOLDER, given, model_option, typed
from softarm.cli.shared.printing import waiting
from softarm.common.batch import Workers
from softarm.common.batch_options import workers_options
from softarm.common.processes import bar

SHORT = 0.1  # share of the recipe's frames below which a policy is not evaluated


@click.command()
@click.argument("task", required=False)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the run.")
@click.option("--frames", type=click.IntRange(min=1), help="Stop after this number of steps, summed over robots.")
@click.option("--minutes", type=click.FloatRange(min=0, min_open=True), help="Stop after this time.")
@click.option(
    "--robots", type=click.IntRange(min=8), help="Simulated in parallel.  [default: the recipe's, 1024 or 2048]"
)
@click.option("--device", help="Device of the training: cpu, or cuda for an NVIDIA card.  [default: cpu]")
@model_option
@click.option("--out", type=FOLDER, help="Folder of all results.  [default: runs/TASK-SEED or runs/TASK-MODEL-SEED]")
@click.option("--resume", is_flag=True, help="Continue from the folder's last checkpoint.")
@click.option(
    "--sweep", type=FILE, help="Train all runs of this file, seeds x configurations; the same command resumes."
)
@workers_options("With --sweep: ")
def train(
    task: str | None,
    seed: int,
    frames: int | None,
    minutes: float | None,
    robots: int | None,
    device: str | None,
    model_file: Path | None,
    out: Path | None,
    resume: bool,
    sweep: Path | None,
    workers: Workers,
) -> None:
    """Train a policy that swings the tip to a target, in free space (reach*) or into a shelf (shelf).

    Tasks: reach, reach-wide, reach-robust, shelf, and installed plug-ins. By default the run has as many frames as that
    of the shipped policy. The exported checkpoint is the best one on validation targets and starts, which differ from
    the test trials. --model sets the simulator for training, validation and test; the policy file names it.

    \b
    Examples:
      softarm train reach
      softarm train reach-wide --seed 3 --minutes 5
      softarm train reach --model no-delay
      softarm train shelf --out runs/mine --resume
      softarm train --sweep benchmarks/ablation.yaml --out runs/ablation
    """
    if sweep is not None:
        _train_sweep(sweep, out or Path("runs") / sweep.stem, workers)
        return
    if task is None:
        raise click.UsageError("no task given: name one, e.g. `softarm train reach`, or use --sweep FILE")

    from softarm.training.learn import inference
    from softarm.training.record import tensorboard
    from softarm.training.run.recipe import begin, named
    from softarm.training.run.report import ending

    try:
        recipe = named(task)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    recipe = recipe.changed(model_file, {"run.robots": robots, "run.device": device})
    folder = out or Path("runs") / "-".join((task, *([model_file.stem] if model_file else []), str(seed)))
    if not resume and (folder / "latest.pt").exists():
        fail(f"{folder} already contains a run: continue it with --resume, or choose another --out")
    leaves(lambda: _left(folder))
    with inference.workers() as pool:
        with failing(ValueError), waiting("creating robots and network"):
            session = begin(recipe, seed, folder, pool, resume)
        if missing := tensorboard.missing():
            click.secho(missing, fg="yellow")
        end = frames or (None if minutes else recipe.frames)
        with bar("starting", done=session.finished(end, minutes), stay=True) as shown:
            policy = session.run(end, minutes, lambda: shown.report(session.sentence, session.finished(end, minutes)))
        if session.frames < SHORT * recipe.frames:
            same = given("seed", "robots", "device", "model_file", "out")
            click.echo(
                f"{session.frames / 1e6:.2f} M frames in {session.seconds / 60:.1f} min, {policy}: "
                f"too short to matter, so not evaluated; the least are {SHORT * recipe.frames / 1e6:.2f} M frames"
            )
            click.echo(f"next: `softarm train {task}{same} --resume` continues to the recipe's end")
            return
        for line in ending(session, policy):
            click.echo(line)


def _train_sweep(file: Path, out: Path, workers: Workers) -> None:
    """Train the unfinished runs of a sweep and write OUT/results.json and OUT/results.md."""
    from softarm.training.record import tensorboard
    from softarm.training.run import sweep

    if missing := tensorboard.missing():
        click.secho(missing, fg="yellow")
    leaves(f"finished runs are kept in {out}; the same command continues with the others")
    sweep.refuse_beside(typed())
    configured = sweep.load(file)

    def show(result: "sweep.Result") -> None:
        shares = ", ".join(f"{name} {share:.1%}" for name, share in result.test.items())
        click.echo(f"{result.name}, seed {result.seed}: validation {result.validation:.1%}; {shares}")

    results = sweep.run_all(sweep.plan(configured, out), workers, show)
    click.echo(f"{sweep.save(configured, results, out)}wrote {out / 'results.json'} and {out / 'results.md'}")


def _left(folder: Path) -> str:
    if not (folder / "latest.pt").exists():
        return f"no checkpoint yet; {folder} may be deleted"
    return f"the newest checkpoint is in {folder}; the same command with --resume continues from it"
