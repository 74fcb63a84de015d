"""Compare recipes for continuing the training of a policy when the simulator changes, on the validation set.

    python -m benchmarks.retraining patched-model.yaml --std 0.3 --std 0.5 --std 0.85 --frames 1000000

The 54 test targets are not flown, since a recipe must not be chosen on them.
"""

import tempfile
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from softarm.common.processes import bar
from softarm.policies.base import MODELS
from softarm.simulator import model_file
from softarm.training.record.checkpoint import CheckpointError
from softarm.training.run.retrain import Retrained, RetrainingConfig, retrain

_DEFAULT = RetrainingConfig()


def compare(
    policy: Path, model: Path, recipes: list[RetrainingConfig]
) -> list[tuple[RetrainingConfig, Retrained, float]]:
    """Return every recipe with its result and its processor seconds.

    Raises:
        CheckpointError: The policy cannot be trained further.
        ModelFileError: The model file is invalid.
    """
    robot, found = model_file.load(model), []
    with bar("", float(len(recipes))) as shown:
        for number, recipe in enumerate(recipes):

            def show_progress(text: str, share: float, before: int = number) -> None:
                shown.show(before + share, text=text)

            with tempfile.TemporaryDirectory() as folder:
                began = time.process_time()
                result = retrain(policy, robot, model.stem, Path(folder), recipe, show_progress)
                found.append((recipe, result, time.process_time() - began))
    return found


@click.command()
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--policy", type=click.Path(path_type=Path, dir_okay=False), default=MODELS / "reach.onnx")
@click.option("--std", multiple=True, type=click.FloatRange(0.01, 2), default=(_DEFAULT.std,), show_default=True)
@click.option("--rate", multiple=True, type=click.FloatRange(1e-6, 1e-1), default=(_DEFAULT.learning_rate,))
@click.option("--robots", multiple=True, type=click.IntRange(8), default=(_DEFAULT.robots,), show_default=True)
@click.option("--spread", type=click.FloatRange(0, 0.5), default=_DEFAULT.spread, show_default=True)
@click.option("--frames", type=click.IntRange(1), default=_DEFAULT.frames, show_default=True)
def main(
    model: Path,
    policy: Path,
    std: tuple[float, ...],
    rate: tuple[float, ...],
    robots: tuple[int, ...],
    spread: float,
    frames: int,
) -> None:
    """Continue the training of POLICY on MODEL with every combination of the options; validate before and after.

    \b
    Example:
      python -m benchmarks.retraining patched-model.yaml --std 0.3 --std 0.85 --frames 1000000
    """
    recipes = [
        replace(_DEFAULT, std=s, learning_rate=r, robots=n, spread=spread, frames=frames, seconds=float("inf"))
        for s, r, n in product(std, rate, robots)
    ]
    console = Console()
    try:
        rows = compare(policy, model, recipes)
    except (CheckpointError, model_file.ModelFileError) as error:
        raise click.ClickException(str(error)) from None
    table = Table("std", "rate", "robots", "before", "best", "last", "frames", "wall s", "CPU s")
    for recipe, result, cpu_s in rows:
        last = result.curve[-1].validation
        table.add_row(
            f"{recipe.std:g}",
            f"{recipe.learning_rate:g}",
            str(recipe.robots),
            f"{result.before:.1%}",
            f"{result.after:.1%}",
            "-" if last is None else f"{last:.1%}",
            str(result.frames),
            f"{result.seconds:.0f}",
            f"{cpu_s:.0f}",
        )
    console.print(table)


if __name__ == "__main__":
    main()
