"""How long until a policy is as good as the paper's robot was, and how fast the learner is beside rl_games.

The clock runs from the making of a run to the validation at which its averaged policy reaches the paper's level on the
54 targets and holds it over the next three; only the flying of those targets is left out of it. It counts whatever
else the machine does, so measure on a quiet one.

    python -m softarm.benchmarks.training --json FILE
"""

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypedDict

import click

from softarm.benchmarks import results
from softarm.schemas.flights import Shares
from softarm.training.learn.inference import Workers, workers
from softarm.training.run import validation
from softarm.training.run.recipe import RECIPES, begin
from softarm.training.run.session import Session

LEVEL = Shares(in_range=0.94, above=0.50, all=0.80)  # [P] section 4.1, on its hardware
HELD = 3  # evaluations after the first, as high
FRAMES_MOST = 8_000_000
SEEDS = (1, 2, 3, 4, 5)


class Point(NamedTuple):
    """A run at one of its validations."""

    seconds: float
    frames: int
    report: Shares


class TimesToLevel(TypedDict):
    """What `--json` writes; a list has one entry a seed."""

    seconds_to_seed_level: list[float | None]  # None: never, within FRAMES_MOST
    frames_to_seed_level: list[int | None]
    steps_per_s: float  # control steps of single robots, over all runs
    rl_games_steps_per_s: float | None  # None: rl_games is not installed
    curves: list[list[tuple[float, int, float, float, float]]]  # seconds, frames, in range, above, all


def first_held(reached: list[bool], held: int = HELD) -> int | None:
    """Index of the first of `held` + 1 successive truths; None when there is none."""
    for k in range(len(reached) - held):
        if all(reached[k : k + held + 1]):
            return k
    return None


def is_at_level(report: Shares) -> bool:
    """As good as the paper's robot, in each of its three figures."""
    return all(ours >= theirs for ours, theirs in zip(report, LEVEL, strict=True))


def follow(make: Callable[[], Session], pool: Workers, frames_most: int = FRAMES_MOST) -> list[Point]:
    """Train until the level is held, or for so many frames; a point a validation."""
    points: list[Point] = []
    start, aside = time.monotonic(), 0.0
    session = make()
    while session.frames < frames_most and first_held([is_at_level(point.report) for point in points]) is None:
        standing = session.advance()
        if len(session.curve) % session.config.validate_every:
            continue
        now = time.monotonic()
        report = validation.grid_shares(session.average, session.task, pool)
        points.append(Point(now - start - aside, standing.frames, report))
        aside += time.monotonic() - now
    return points


def run(seeds: tuple[int, ...], frames_most: int, tell: Callable[[str], None]) -> TimesToLevel:
    """Measure all seeds, then rl_games if it is there."""
    times: list[float | None] = []
    frames_there: list[int | None] = []
    curves = []
    frames = seconds = 0.0
    with workers() as pool, TemporaryDirectory() as folder:
        for seed in seeds:
            out = Path(folder) / str(seed)
            points = follow(lambda: begin(RECIPES["reach"], seed, out, pool, resume=False), pool, frames_most)  # noqa: B023
            place = first_held([is_at_level(point.report) for point in points])
            times.append(None if place is None else points[place].seconds)
            frames_there.append(None if place is None else points[place].frames)
            frames, seconds = frames + points[-1].frames, seconds + points[-1].seconds
            curves.append([(point.seconds, point.frames, *point.report) for point in points])
            after = (
                "never"
                if place is None
                else f"{points[place].seconds:.0f} s, {points[place].frames / 1e6:.1f} M frames"
            )
            tell(f"seed {seed}: {after}")
        theirs = _rl_games(tell)
    return TimesToLevel(
        seconds_to_seed_level=times,
        frames_to_seed_level=frames_there,
        steps_per_s=frames / seconds,
        rl_games_steps_per_s=theirs,
        curves=curves,
    )


def _rl_games(tell: Callable[[str], None]) -> float | None:
    try:
        from softarm.benchmarks.rl_games_peer import steps_per_s
    except ModuleNotFoundError as error:
        tell(f"rl_games is left out: the package '{error.name}' is not installed (pip install rl_games)")
        return None
    return steps_per_s()


@click.command()
@results.json_option
@click.option("--seed", "seeds", type=click.IntRange(min=0), multiple=True, help="Again for more.  [default: 1 to 5]")
@click.option("--frames", type=click.IntRange(min=1), help="Give a seed up after so many control steps of its robots.")
def main(json_file: Path | None, seeds: tuple[int, ...], frames: int | None) -> None:
    """Wall time from a run's start to the paper's 94/50/80 %, held over three more evaluations; beside rl_games.

    \b
    Example:
      python -m softarm.benchmarks.training --json training.json
    """
    result = run(seeds or SEEDS, frames or FRAMES_MOST, click.echo)
    if json_file is not None:
        results.write(json_file, result)
    theirs = result["rl_games_steps_per_s"]
    beside = "" if theirs is None else f"; rl_games, the seed's settings: {theirs:,.0f}"
    click.echo(f"control steps of single robots a second: {result['steps_per_s']:,.0f}{beside}")


if __name__ == "__main__":
    main()
