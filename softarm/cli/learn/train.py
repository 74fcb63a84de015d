"""`softarm train`: train one policy or a sweep in the simulator and export it as ONNX."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.console import FILE, FOLDER, Number, given, model_option, typed, waiting
from softarm.cli.shared.errors import fail, failing, leaves
from softarm.common.batch import Workers, workers_options
from softarm.common.processes import bar

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from softarm.training.run.recipe import Recipe
    from softarm.training.run.session import Session

SHORT = 0.1  # share of the recipe's frames below which a policy is not evaluated


@click.command()
@click.argument("task", required=False)
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=1, show_default=True, help="Seed of the run.")
@click.option("--frames", type=click.IntRange(min=1), help="Stop after this number of steps, summed over robots.")
@click.option("--minutes", type=Number(min=0, min_open=True), help="Stop after this time.")
@click.option(
    "--robots", type=click.IntRange(min=8), help="Simulated in parallel.  [default: the recipe's, 1024 or 2048]"
)
@click.option("--device", help="Device of the training: cpu, or cuda for an NVIDIA card.  [default: cpu]")
@model_option
@click.option("--out", type=FOLDER, help="Folder of all results.  [default: runs/TASK-SEED or runs/TASK-MODEL-SEED]")
@click.option("--from", "dataset", type=FOLDER, help="Clone the actions of this LeRobot dataset instead.")
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
    dataset: Path | None,
    resume: bool,
    sweep: Path | None,
    workers: Workers,
) -> None:
    """Train a policy that swings the tip to a target, in free space (reach*) or into a shelf (shelf).

    Tasks: reach, reach-wide, reach-robust, shelf, and installed plug-ins. By default the run has as many frames as that
    of the shipped policy. The exported checkpoint is the best one on validation targets and starts, which differ from
    the test trials. --model sets the simulator for training, validation and test; the policy file names it.

    --from learns the actions of a dataset of `softarm logs export --to lerobot` instead (behaviour cloning). Episodes
    that missed their target are left out, and a tenth of the others is held out.

    \b
    Examples:
      softarm train reach
      softarm train reach-wide --seed 3 --minutes 5
      softarm train reach --model no-delay
      softarm train shelf --out runs/mine --resume
      softarm train reach-wide --from dataset
      softarm train --sweep benchmarks/ablation.yaml --out runs/ablation
    """
    if sweep is not None:
        _train_sweep(sweep, out or Path("runs") / sweep.stem, workers)
        return
    if wrong := [name for name in typed() if name in ("--workers", "--ray")]:
        raise click.UsageError(f"{wrong[0]} is for many runs: add --sweep FILE")
    task = task or (None if dataset is None else "reach")
    if task is None:
        raise click.UsageError("no task given: name one, e.g. `softarm train reach`, or use --sweep FILE")

    if dataset is not None and (robots is not None or device is not None):
        raise click.UsageError("--robots and --device are for learning in the simulator: leave them out with --from")

    from softarm.training.learn import inference
    from softarm.training.record import curve
    from softarm.training.run.recipe import begin, named
    from softarm.training.run.report import ending

    try:
        recipe = named(task)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    recipe = recipe.changed(model_file, {"run.robots": robots, "run.device": device})
    named_after = [each.stem for each in (model_file, dataset) if each is not None]
    folder = out or Path("runs") / "-".join((task, *named_after, str(seed)))
    if not resume and (folder / "latest.pt").exists():
        fail(f"{folder} already contains a run: continue it with --resume, or choose another --out")
    leaves(lambda: _left(folder))
    with inference.workers() as pool:
        with failing(ValueError), waiting("creating robots and network"):
            if dataset is None:
                session = begin(recipe, seed, folder, pool, resume)
            else:
                recipe, session = _cloning(recipe, dataset, seed, folder, pool, resume)
        if missing := curve.tensorboard_missing():
            click.secho(missing, fg="yellow")
        end = frames or (None if minutes else recipe.frames)
        with bar("starting", done=session.finished(end, minutes), stay=True) as shown:
            policy = session.run(end, minutes, lambda: shown.report(session.sentence, session.finished(end, minutes)))
        if session.frames < SHORT * recipe.frames:
            same = given("seed", "robots", "device", "model_file", "out", "dataset")
            click.echo(
                f"{session.frames / 1e6:.2f} M frames in {session.seconds / 60:.1f} min, {policy}: "
                f"too short to matter, so not evaluated; the least are {SHORT * recipe.frames / 1e6:.2f} M frames"
            )
            click.echo(f"next: `softarm train {task}{same} --resume` continues to the recipe's end")
            return
        for line in ending(session, policy):
            click.echo(line)


def _cloning(
    recipe: "Recipe", dataset: Path, seed: int, folder: Path, pool: "Executor", resume: bool
) -> tuple["Recipe", "Session"]:
    """Return recipe and session of a run that clones a dataset; raise ValueError if it cannot be used."""
    from softarm.recordings import lerobot
    from softarm.training.run import clone
    from softarm.training.run.clone import Demonstration

    try:
        episodes = lerobot.read(dataset)
    except ModuleNotFoundError as error:
        fail(f"--from needs {error.name}, which is not installed: pip install 'softarm[diagnosis]'")
    kept = [Demonstration(episode.state, episode.action) for episode in episodes if episode.reached]
    click.echo(f"{dataset}: {len(kept)} episodes; {len(episodes) - len(kept)} that missed their target are left out")
    recipe = recipe.model_copy(update={"frames": clone.FRAMES})
    return recipe, clone.CloningSession(recipe, kept, str(dataset), seed, folder, pool, resume)


def _train_sweep(file: Path, out: Path, workers: Workers) -> None:
    """Train the unfinished runs of a sweep and write OUT/results.json and OUT/results.md."""
    from softarm.training.record import curve
    from softarm.training.run import sweep

    if missing := curve.tensorboard_missing():
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
        return "no checkpoint was written yet; start again"
    return f"the newest checkpoint is in {folder}; the same command with --resume continues from it"
