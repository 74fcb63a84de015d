"""`softarm plan`: optimise trajectories for the policy `trajectory`, or search how much can be reached at all."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.interrupt import NOTHING, leaves
from softarm.cli.options import FILE, json_option, load_model, model_option, write_json
from softarm.cli.printing import print_table, print_text
from softarm.schemas.flights import CART_STARTS_M

if TYPE_CHECKING:
    from softarm.training.trajectory.rows import Row

OUT = Path("runs/trajectories.npz")
LISTED = 12  # so many plans are shown one by one


@click.command()
@click.option("--target", "targets", type=(float, float), multiple=True, metavar="Y Z", help="Default: the paper's 54.")
@click.option(
    "--start",
    "starts",
    type=click.FloatRange(-0.2, 0.2),
    multiple=True,
    default=CART_STARTS_M,
    show_default=True,
    metavar="M",
    help="Where the cart begins.",
)
@model_option
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the first guesses.")
@click.option("--out", type=FILE, default=OUT, show_default=True, help="The file of plans to write.")
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

    from softarm.common.processes import bar
    from softarm.schemas.flights import TEST_TARGETS
    from softarm.training.trajectory import planner, rows
    from softarm.training.trajectory.ceiling import ROUNDS

    leaves(NOTHING)
    model = load_model(model_file) if model_file else None
    wanted = np.array(targets or [(goal.y_m, goal.z_m) for goal in TEST_TARGETS], dtype=np.float32)
    wall, cpu = time.perf_counter(), time.process_time()
    if ceiling:
        with bar("searching", ROUNDS * len(starts)) as shown:
            found = rows.of_searches(wanted, starts, model, seed, shown.advance)
    else:
        with bar("flying random swings") as shown:
            name = model_file.stem if model_file else "seed"
            report = planner.plan(wanted, starts, model, name, seed, lambda text, share: shown.advance(share, text))
        out.parent.mkdir(parents=True, exist_ok=True)
        report.plans.save(out)
        found = rows.of_plans(report)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    _show(found)
    done = "searched" if ceiling else "planned and flown"
    print_text(f"{len(found)} {done} in {wall:.1f} s ({cpu:.1f} s of processor time)")
    write_json(json_file, {"wall_s": wall, "cpu_s": cpu, "rows": found})
    if not ceiling:
        print_text(f"wrote {out}. Next: fly them through the daemon's own tick:")
        click.echo(f"  echo '{{policies: {{mine: {{plugin: trajectory, options: {{plans: {out}}}}}}}}}' > mine.yaml")
        click.echo("  softarm evaluate --policy mine --config mine.yaml")


def _show(found: "list[Row]") -> None:
    """A few plans one by one, many by their height; and what was not reached."""
    from softarm.training.trajectory import rows

    told = []
    if len(found) <= LISTED:
        for row in found:
            start, place, miss = f"{row['start']:.2f}", f"{row['y']:.2f}, {row['z']:.2f}", f"{row['miss_m'] * 1e3:.1f}"
            planned = "-" if row["planned_miss_m"] is None else f"{row['planned_miss_m'] * 1e3:.1f}"
            told.append((start, place, planned, miss, "not" if row["time_s"] is None else f"{row['time_s']:.2f}"))
        columns = ("start (m)", "y, z (m)", "planned (mm)", "in the simulator (mm)", "reached after (s)")
        print_table(columns, told)
        return
    for label, part in rows.by_height(found).items():
        planned = "-" if part.planned is None else f"{100 * part.planned:.1f} %"
        after = "-" if part.mean_time_s is None else f"{part.mean_time_s:.2f} on average"
        told.append((label, str(part.rows), planned, f"{100 * part.reached:.1f} %", after))
    print_table(("targets", "from starts", "in the plan", "in the simulator", "reached after (s)"), told)
    if missed := sorted({(row["y"], row["z"]) for row in found if not row["reached"]}):
        print_text("missed from a start or more: " + ", ".join(f"({y:.2f}, {z:.2f})" for y, z in missed))
