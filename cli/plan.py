"""`softarm plan`: optimise trajectories for the policy `trajectory`, or search how much can be reached at all."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import click

from softarm.cli.options import json_option, model_option

if TYPE_CHECKING:
    from rich.console import Console

    from softarm.schemas.model import Model
    from softarm.training.trajectory.problem import Array

OUT = Path("runs/trajectories.npz")
STARTS_M = (0.0, 0.1, 0.2)  # as `softarm evaluate`
LISTED = 12  # so many plans are shown one by one


class Row(TypedDict):
    """One target from one start; distances of the tip from the target."""

    y: float
    z: float
    start: float
    planned: bool | None  # reached in the plan, the cart within its limit; None: a search plans nothing
    planned_miss_m: float | None
    miss_m: float
    reached: bool
    time_s: float | None  # until it was reached


@click.command()
@click.option("--target", "targets", type=(float, float), multiple=True, metavar="Y Z", help="Default: the paper's 54.")
@click.option(
    "--start",
    "starts",
    type=click.FloatRange(-0.2, 0.2),
    multiple=True,
    default=STARTS_M,
    show_default=True,
    metavar="M",
    help="Where the cart begins.",
)
@model_option
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the first guesses.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    default=OUT,
    show_default=True,
    help="The file of plans to write.",
)
@click.option("--ceiling", is_flag=True, help="Search by trial alone and write no plans: what can be reached at all?")
@json_option
def plan(
    targets: tuple[tuple[float, float], ...],
    starts: tuple[float, ...],
    model_file: Path | None,
    seed: int,
    out: Path,
    ceiling: bool,
    json_file: Path | None,
) -> None:
    """Optimise commands that swing the tip onto targets (the paper's upper bound) and write them to a file.

    Every plan begins with the arm straight and at rest, and is flown at 1200 Hz behind the daemon's braking clamp
    before it is written. The policy `trajectory` tracks it.

    \b
    Examples:
      softarm plan
      softarm plan --target -0.2 0.7 --start 0
      softarm plan --ceiling
    """
    import time

    import numpy as np
    from rich.console import Console

    from softarm.cli.errors import fail
    from softarm.schemas.goals import TEST_TARGETS
    from softarm.simulator import model_file as files

    console = Console()
    try:
        model = files.load(model_file) if model_file else None
    except files.ModelFileError as error:
        fail(str(error))
    wanted = np.array(targets or [(goal.y_m, goal.z_m) for goal in TEST_TARGETS], dtype=np.float32)
    wall, cpu = time.perf_counter(), time.process_time()
    if ceiling:
        rows = _search(wanted, starts, model, seed, console)
    else:
        rows = _plan(wanted, starts, model, model_file.stem if model_file else "seed", seed, out, console)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    _show(rows, console)
    done = "searched" if ceiling else "planned and flown"
    console.print(f"{len(rows)} {done} in {wall:.1f} s ({cpu:.1f} s of processor time)")
    if json_file is not None:
        json_file.write_text(json.dumps({"wall_s": wall, "cpu_s": cpu, "rows": rows}, indent=1) + "\n")
        console.print(f"wrote {json_file}")
    if not ceiling:
        console.print(f"wrote {out}. Next: fly them through the daemon's own tick:")
        click.echo(f"  echo '{{policies: {{mine: {{plugin: trajectory, options: {{plans: {out}}}}}}}}}' > mine.yaml")
        click.echo("  softarm evaluate --policy mine --config mine.yaml")


def _plan(
    targets_m: "Array",
    starts_m: tuple[float, ...],
    model: "Model | None",
    name: str,
    seed: int,
    out: Path,
    console: "Console",
) -> list[Row]:
    """Plan behind a progress bar and write the file."""
    from rich.progress import Progress

    from softarm.training.trajectory.planner import plan

    with Progress(console=console, transient=True) as bar:
        shown = bar.add_task("flying random swings", total=1.0)
        report = plan(
            targets_m,
            starts_m,
            model,
            name,
            seed,
            on_advance=lambda doing, share: bar.update(shown, description=doing, advance=share),
        )
    plans = report.plans
    out.parent.mkdir(parents=True, exist_ok=True)
    plans.save(out)
    columns = (
        plans.target_m,
        plans.cart_start_m,
        plans.miss_m,
        report.reached_s,
        report.planned,
        report.planned_miss_m,
    )
    return [_row(*values) for values in zip(*columns, strict=True)]


def _search(
    targets_m: "Array", starts_m: tuple[float, ...], model: "Model | None", seed: int, console: "Console"
) -> list[Row]:
    """Search behind a progress bar."""
    from rich.progress import Progress

    from softarm.training.trajectory.ceiling import ROUNDS, search

    rows = []
    with Progress(console=console, transient=True) as bar:
        shown = bar.add_task("searching", total=ROUNDS * len(starts_m))
        for start in starts_m:
            found = search(targets_m, start, model, seed, on_round=lambda: bar.advance(shown))
            columns = zip(targets_m, found.closest_m, found.reached_s, strict=True)
            rows += [_row(target, start, miss, reached_s) for target, miss, reached_s in columns]
    return rows


def _row(
    target_m: "Array",
    start_m: float,
    miss_m: float,
    reached_s: float,
    planned: bool | None = None,
    planned_miss_m: float | None = None,
) -> Row:
    """Plain numbers, for the table and for JSON."""
    reached = reached_s == reached_s
    return Row(
        y=round(float(target_m[0]), 6),
        z=round(float(target_m[1]), 6),
        start=round(float(start_m), 6),
        planned=None if planned is None else bool(planned),
        planned_miss_m=None if planned_miss_m is None else float(planned_miss_m),
        miss_m=float(miss_m),
        reached=bool(reached),
        time_s=float(reached_s) if reached else None,
    )


def _show(rows: list[Row], console: "Console") -> None:
    """A few plans one by one, many by their height; and what was not reached."""
    from rich.table import Table

    from softarm.schemas.goals import TRAINED_Z_MAX_M

    if len(rows) <= LISTED:
        table = Table("start (m)", "y, z (m)", "planned (mm)", "in the simulator (mm)", "reached after (s)")
        for row in rows:
            planned = "-" if row["planned_miss_m"] is None else f"{row['planned_miss_m'] * 1e3:.1f}"
            after = "not" if row["time_s"] is None else f"{row['time_s']:.2f}"
            place = f"{row['y']:.2f}, {row['z']:.2f}"
            table.add_row(f"{row['start']:.2f}", place, planned, f"{row['miss_m'] * 1e3:.1f}", after)
        console.print(table)
        return
    high = TRAINED_Z_MAX_M + 1e-4
    table = Table("targets", "from starts", "in the plan", "in the simulator", "reached after (s)")
    parts = (("z <= 0.70 m", 0.0, high), ("z > 0.70 m", high, 9.0), ("all", 0.0, 9.0))
    for label, low, top in parts:
        part = [row for row in rows if low < row["z"] <= top]
        if not part:
            continue
        hits = [row["planned"] for row in part if row["planned"] is not None]
        times = [row["time_s"] for row in part if row["time_s"] is not None]
        table.add_row(
            label,
            str(len(part)),
            f"{100 * sum(hits) / len(hits):.1f} %" if hits else "-",
            f"{100 * len(times) / len(part):.1f} %",
            f"{sum(times) / len(times):.2f} on average" if times else "-",
        )
    console.print(table)
    missed = sorted({(row["y"], row["z"]) for row in rows if not row["reached"]})
    if missed:
        console.print("missed from a start or more: " + ", ".join(f"({y:.2f}, {z:.2f})" for y, z in missed))
