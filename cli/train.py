"""`softarm train`: learn a policy on the simulator and leave it as an ONNX file."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cli.options import model_option

if TYPE_CHECKING:
    from rich.console import Console

    from training.session import Session, Standing

FRAMES = {"reach": 6_000_000, "reach-wide": 10_000_000}  # what the shipped policies took


@click.group()
def train() -> None:
    """Learn a policy on the simulator and leave it as an ONNX file.

    \b
    Example:
      softarm train reach
    """


@train.command()
@click.option("--wide", is_flag=True, help="Targets up to z = 0.80 m and starts all along the rail (reach-wide).")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of everything random.")
@click.option("--frames", type=click.IntRange(min=1), help="Stop after so many control steps of single robots.")
@click.option("--minutes", type=click.FloatRange(min=0, min_open=True), help="Stop after so many minutes.")
@click.option("--robots", type=click.IntRange(min=8), default=4096, show_default=True, help="Side by side.")
@model_option
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for checkpoints, curve and policy.  [default: runs/TASK-SEED, runs/TASK-MODEL-SEED]",
)
@click.option("--resume", is_flag=True, help="Go on from the folder's last checkpoint.")
def reach(
    wide: bool,
    seed: int,
    frames: int | None,
    minutes: float | None,
    robots: int,
    model_file: Path | None,
    out: Path | None,
    resume: bool,
) -> None:
    """Train the tip to swing to a target in free space.

    Without --frames or --minutes it takes as many frames as the shipped policy did. Of the checkpoints, the one is
    exported that does best on a validation set of random targets and starts, never on the 54 test targets. With
    --model it is trained, validated and tested on that simulator, with all its effects; the policy's file names it.

    \b
    Examples:
      softarm train reach
      softarm train reach --wide --seed 3 --minutes 5
      softarm train reach --model no-delay
      softarm train reach --out runs/mine --resume
    """
    from rich.console import Console

    from cli.errors import fail
    from simulator import model_file as files
    from training.checkpoint import CheckpointError
    from training.inference import workers
    from training.ppo import PpoConfig
    from training.session import Session, TrainingConfig
    from training.tasks import TASKS

    task = TASKS["reach-wide" if wide else "reach"]
    name = model_file.stem if model_file else "seed"
    folder = out or Path("runs") / "-".join((task.name, *([name] if model_file else []), str(seed)))
    if frames is None and minutes is None:
        frames = FRAMES[task.name]
    if not resume and (folder / "latest.pt").exists():
        fail(f"{folder} holds a run already: add --resume to go on with it, or give another --out")
    console = Console()
    with workers() as pool:
        try:
            model = files.load(model_file) if model_file else None
            config = TrainingConfig(seed=seed, robots=robots)
            session = Session(task, config, PpoConfig(), folder, pool, resume, model, name)
        except (CheckpointError, files.ModelFileError, ValueError) as error:
            fail(str(error))
        policy = _run(session, frames, minutes, console)
        _tell(session, policy, console)


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
    name = f"my-{session.task.name}"
    console.print(f"{session.frames / 1e6:.2f} M frames in {session.seconds / 60:.1f} min, {session.out}:")
    console.print(f"  {policy.name}: the checkpoint with {session.best:.1%} of the validation set reached")
    console.print("  learning_curve.csv and .png, latest.pt (to resume), best.pt (`softarm export`)")
    tested = session.test()
    console.print(
        f"  54 test targets from three starts, at 1200 Hz: {tested.in_range:.1%} in range, "
        f"{tested.above:.1%} above, {tested.all:.1%} in all"
    )
    console.print("Next: fly them through the daemon's own tick:")
    click.echo(f"  echo '{{policies: {{{name}: {{plugin: onnx, options: {{model: {policy}}}}}}}}}' > mine.yaml")
    click.echo(f"  softarm evaluate --policy {name} --config mine.yaml")
