"""`softarm train`: learn a policy on the simulator and leave it as an ONNX file; or many at once."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.options import model_option

if TYPE_CHECKING:
    from rich.console import Console

    from softarm.training.run.recipe import Recipe
    from softarm.training.run.session import Session, Standing


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
    type=click.Path(path_type=Path, file_okay=False),
    help="For checkpoints, curve, report and policy.  [default: runs/TASK-SEED, runs/TASK-MODEL-SEED, runs/SWEEP]",
)
@click.option("--resume", is_flag=True, help="Go on from the folder's last checkpoint.")
@click.option(
    "--sweep",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Train all runs of this file instead, seeds x configurations; started again, it goes on.",
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
    from softarm.cli.errors import fail

    if sweep is not None:
        _sweep(sweep, out or Path("runs") / sweep.stem, workers, ray_address)
        return
    name = task or task_option
    if name is None:
        raise click.UsageError("give a task, e.g. `softarm train reach`, or a file with --sweep")
    if wide and name not in ("reach", "reach-wide"):
        raise click.UsageError(f"--wide is for reach, not for {name}")

    from softarm.training.run.recipe import RECIPES

    name = "reach-wide" if wide else name
    if name not in RECIPES:
        raise click.UsageError(f"no task '{name}'; there is {', '.join(RECIPES)}")
    recipe = RECIPES[name]
    given = {"run.robots": robots, "run.device": device}
    settings = recipe.settings | {name: value for name, value in given.items() if value is not None}
    recipe = recipe.model_copy(update={"settings": settings})
    if model_file is not None:
        recipe = recipe.model_copy(update={"model": str(model_file)})
    folder = out or Path("runs") / "-".join((name, *([model_file.stem] if model_file else []), str(seed)))
    if not resume and (folder / "latest.pt").exists():
        fail(f"{folder} holds a run already: add --resume to go on with it, or give another --out")
    _train(recipe, seed, frames or (None if minutes else recipe.frames), minutes, folder, resume)


def _train(recipe: "Recipe", seed: int, frames: int | None, minutes: float | None, folder: Path, resume: bool) -> None:
    from rich.console import Console

    from softarm.cli.errors import fail
    from softarm.simulator.model_file import ModelFileError
    from softarm.training.learn.inference import workers
    from softarm.training.run.checkpoint import CheckpointError
    from softarm.training.run.recipe import begin

    console = Console()
    with workers() as pool:
        try:
            run = begin(recipe, seed, folder, pool, resume)
        except (CheckpointError, ModelFileError, ValueError) as error:
            fail(str(error))
        _tell_missing(console)
        policy = _run(run, frames, minutes, console)
        _tell(run, policy, console)


def _run(session: "Session", frames: int | None, minutes: float | None, console: "Console") -> Path:
    """Train behind a progress bar; returns the policy's path."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        shown = bar.add_task("starting", total=frames if minutes is None else minutes * 60)

        def tell(now: "Standing") -> None:
            validation = "-" if now.validation is None else f"{now.validation:.1%}, best {now.best:.1%}"
            bar.update(
                shown,
                completed=now.frames if minutes is None else now.seconds,
                description=f"{now.frames / 1e6:.1f} M frames, {now.frames_per_s / 1e3:.0f} k/s, "
                f"reward {now.reward:.2f}, valid {validation}",
            )

        return session.run(frames, minutes, tell)


def _tell(session: "Session", policy: Path, console: "Console") -> None:
    """Say what came out and what to do with it."""
    from softarm.training.record import tensorboard

    name = f"my-{session.task.name}"
    console.print(f"{session.frames / 1e6:.2f} M frames in {session.seconds / 60:.1f} min, {session.out}:")
    console.print(f"  {policy.name}: the checkpoint with {session.best:.1%} of the validation set reached")
    console.print("  learning_curve.csv and .png, latest.pt (to resume), best.pt (`softarm export`)")
    tested = session.test()
    console.print(f"  {tested.report.sentence}")
    page = session.write_report(tested)
    console.print(f"  {page.name}: the curves and the tip's paths at these trials, also in tip_paths.png")
    if session.events.fault is None:
        console.print(f"  tensorboard/: see it with `tensorboard --logdir {session.out}`")
    elif session.events.fault != tensorboard.missing():  # that has been said
        console.print(f"  {session.events.fault}")
    console.print("Next: fly them through the daemon's own tick:")
    click.echo(f"  echo '{{policies: {{{name}: {{plugin: onnx, options: {{model: {policy}}}}}}}}}' > mine.yaml")
    click.echo(f"  softarm evaluate --policy {name} --config mine.yaml")


def _tell_missing(console: "Console") -> None:
    """Say what training goes on without."""
    from softarm.training.record import tensorboard

    if (missing := tensorboard.missing()) is not None:
        console.print(missing, style="yellow")


def _sweep(file: Path, out: Path, processes: int | None, ray_address: str | None) -> None:
    """Train what is not finished; leave OUT/results.json and OUT/results.md."""
    import json

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from softarm.cli.errors import fail
    from softarm.training.run import sweep

    console = Console(soft_wrap=True)
    _tell_missing(console)
    cores = len(os.sched_getaffinity(0))
    processes = processes or cores
    try:
        wanted = sweep.load(file)
        todo, results = sweep.plan(wanted, out, max(1, cores // processes))
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, console=console) as bar:
            shown = bar.add_task("training", total=len(todo) + len(results), completed=len(results))
            coming = sweep.on_ray(todo, ray_address) if ray_address else sweep.locally(todo, processes)
            for result in coming:
                results.append(result)
                shares = ", ".join(f"{name} {share:.1%}" for name, share in result.test.items())
                bar.print(f"{result.name}, seed {result.seed}: validation {result.validation:.1%}; {shares}")
                bar.advance(shown)
    except sweep.SweepError as error:
        fail(str(error))
    names = list(wanted.runs)
    results.sort(key=lambda each: (names.index(each.name), each.seed))
    text = sweep.markdown(sweep.table(results))
    (out / "results.json").write_text(json.dumps([each._asdict() for each in results], indent=1) + "\n")
    (out / "results.md").write_text(text)
    click.echo(text, nl=False)
    click.echo(f"wrote {out / 'results.json'} and {out / 'results.md'}")
