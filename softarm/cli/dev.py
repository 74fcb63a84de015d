"""`softarm dev`: tools of softarm's makers."""

from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

import click

from softarm.cli.shared.console import (
    FILE,
    NUMBER,
    Number,
    json_option,
    load_model,
    model_option,
    print_table,
    print_text,
    waiting,
    write_json,
)
from softarm.cli.shared.errors import NOTHING, leaves
from softarm.schemas.flights import CART_STARTS_M, in_range

if TYPE_CHECKING:
    from softarm.schemas.model import Model
    from softarm.training.trajectory.problem import Array

OUT = Path("runs/trajectories.npz")
LISTED = 12  # so many plans are shown one by one


@click.group()
def dev() -> None:
    """Optimise trajectories, and write policy files: tools of softarm's makers.

    \b
    Example:
      softarm dev export runs/reach-1/best.pt --out my-reach.onnx
    """


@dev.command(short_help="Write a checkpoint as an ONNX policy.")
@click.argument("checkpoint", type=FILE)
@click.option("--out", type=FILE, required=True, help="The ONNX file to write.")
def export(checkpoint: Path, out: Path) -> None:
    """Write the policy of a training checkpoint (latest.pt or best.pt) as an ONNX file that describes itself.

    \b
    Example:
      softarm dev export runs/reach-1/best.pt --out my-reach.onnx
    """
    leaves(NOTHING)
    with waiting(f"reading {checkpoint}"):
        from softarm.training.record.export import export_checkpoint

        export_checkpoint(checkpoint, out)
    click.echo(f"wrote {out}")


@dev.command(short_help="Optimise trajectories for the policy that tracks them.")
@click.option(
    "--target", "targets", type=(NUMBER, NUMBER), multiple=True, metavar="Y Z", help="Default: the paper's 54."
)
@click.option(
    "--start",
    "starts",
    type=Number(-0.2, 0.2),
    multiple=True,
    default=CART_STARTS_M,
    show_default=True,
    metavar="M",
    help="Start of the cart; repeatable.",
)
@model_option
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the first guesses.")
@click.option("--out", type=FILE, default=OUT, show_default=True, help="The file of plans to write.")
@click.option("--needs", is_flag=True, help="Only search what would bring the missed targets into reach.")
@json_option
def plan(
    targets: tuple[tuple[float, float], ...],
    starts: tuple[float, ...],
    model_file: Path | None,
    seed: int,
    out: Path,
    needs: bool,
    json_file: Path | None,
) -> None:
    """Optimise commands that swing the tip onto targets (the paper's upper bound) and write them to a file.

    Every plan starts with the arm straight and at rest. It is simulated at 1200 Hz with the daemon's braking limit
    before it is written. The policy `trajectory` tracks it.

    \b
    Examples:
      softarm dev plan
      softarm dev plan --target -0.2 0.7 --start 0
      softarm dev plan --needs
    """
    import time

    import numpy as np

    from softarm.common.processes import bar
    from softarm.schemas.flights import TEST_TARGETS
    from softarm.training.trajectory import planner

    leaves(NOTHING)
    model = load_model(model_file) if model_file else None
    aims = np.array(targets or [(goal.y_m, goal.z_m) for goal in TEST_TARGETS], dtype=np.float32)
    if needs:
        _show_needs(aims, model, seed, json_file)
        return
    out.parent.mkdir(parents=True, exist_ok=True)
    wall, cpu = time.perf_counter(), time.process_time()
    with bar("planning") as shown:
        name = model_file.stem if model_file else "seed"
        report = planner.plan(aims, starts, model, name, seed, shown.advance)
    report.plans.save(out)
    found = planner.rows(report)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    show(found)
    print_text(f"{len(found)} planned and flown in {wall:.1f} s ({cpu:.1f} s of processor time)")
    write_json(json_file, {"wall_s": wall, "cpu_s": cpu, "rows": found})
    print_text(f"wrote {out}. Next: fly the plans with the real control loop:")
    click.echo(f"  echo '{{policies: {{mine: {{plugin: trajectory, options: {{plans: {out}}}}}}}}}' > mine.yaml")
    click.echo("  softarm evaluate mine --config mine.yaml")


def show(found: list[dict[str, Any]]) -> None:
    """Print a row per plan, or per height if there are many, and the targets that were missed."""
    lines = []
    if len(found) <= LISTED:
        for row in found:
            start, place, miss = f"{row['start']:.2f}", f"{row['y']:.2f}, {row['z']:.2f}", f"{row['miss_m'] * 1e3:.1f}"
            planned = f"{row['planned_miss_m'] * 1e3:.1f}"
            lines.append((start, place, planned, miss, "not" if row["time_s"] is None else f"{row['time_s']:.2f}"))
        columns = ("start (m)", "y, z (m)", "planned (mm)", "in the simulator (mm)", "reached after (s)")
        print_table(columns, lines)
        return
    low, above = ([row for row in found if in_range(row["z"]) == inside] for inside in (True, False))
    for label, some in (("z <= 0.70 m", low), ("z > 0.70 m", above), ("all", found)):
        if some:
            planned, reached = (f"{100 * fmean(row[key] for row in some):.1f} %" for key in ("planned", "reached"))
            times_s = [row["time_s"] for row in some if row["reached"]]
            after = f"{fmean(times_s):.2f} on average" if times_s else "-"
            lines.append((label, str(len(some)), planned, reached, after))
    print_table(("targets", "from starts", "in the plan", "in the simulator", "reached after (s)"), lines)
    if missed := sorted({(row["y"], row["z"]) for row in found if not row["reached"]}):
        print_text("missed from at least one start: " + ", ".join(f"({y:.2f}, {z:.2f})" for y, z in missed))


def _show_needs(targets_m: "Array", model: "Model | None", seed: int, json_file: Path | None) -> None:
    """Print and write the smallest change of each quantity that reaches each missed target."""
    from softarm.common.processes import bar
    from softarm.training.trajectory import ceiling

    with bar("searching", None) as shown:
        found = ceiling.figures(ceiling.of_missed(targets_m, model, seed, lambda doing: shown.advance(text=doing)))
    print_table(*ceiling.lines(found))
    write_json(json_file, found)
