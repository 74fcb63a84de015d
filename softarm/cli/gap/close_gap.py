"""`softarm close-gap`: diagnose recordings of a robot, patch the simulator and retrain a policy in it."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.gap.rail_limits import print_stricter
from softarm.cli.gap.wire_flights import GOALS, Bench, check_wires, through_wires
from softarm.cli.shared.errors import failing, writing
from softarm.cli.shared.interrupt import leaves
from softarm.cli.shared.options import FILE, FOLDER, flown_model, load_config
from softarm.cli.shared.printing import print_table, print_text, warn
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.evaluation.closing.closed import Closed
    from softarm.evaluation.closing.steps import Spent

REALITY = "reality"
TENTH = 10  # --quick: one of so many test targets and goals
KEEP_THE_OLD = 3  # exit code: finished, and the old policy is the better one


@click.command("close-gap")
@click.argument("campaign", type=click.Path(path_type=Path))
@click.option("--out", type=FOLDER, required=True, help="Folder for all results.")
@click.option("--policy", default="reach-robust", show_default=True, help="To retrain: a shipped name or .onnx file.")
@click.option("--model", "model_file", type=FILE, help="Nominal simulator (default: the campaign's, else seed).")
@click.option("--robot", default=REALITY, show_default=True, help="Held-out robot: the independent one, or a model.")
@click.option("--fault", "faults", multiple=True, metavar="GROUP.QUANTITY=VALUE", help="Of that robot; repeatable.")
@click.option("--config", "config_file", type=FILE, help="Configuration to fly with, also on its real interfaces.")
@click.option("--twin", is_flag=True, help="With --config: fly on the twin of --robot instead of real devices.")
@click.option("--yes", is_flag=True, help="With --config: move the robot without asking.")
@click.option("--goals", type=click.IntRange(1, 1000), help=f"Per start, on the wires.  [default: {GOALS}]")
@click.option("--quick", is_flag=True, help="Fly a tenth of the flights; all intervals are about three times as wide.")
@click.option("--mppi/--no-mppi", default=True, help="Also fly mppi on the patched model; it needs no training.")
@click.option("--seconds", type=click.FloatRange(1, 86400), help="Longest retraining.  [default: 120]")
def close_gap(
    campaign: Path,
    out: Path,
    policy: str,
    model_file: Path | None,
    robot: str,
    faults: tuple[str, ...],
    config_file: Path | None,
    twin: bool,
    yes: bool,
    goals: int | None,
    quick: bool,
    mppi: bool,
    seconds: float | None,
) -> None:
    """Diagnose CAMPAIGN, patch the simulator, retrain the policy in it, fly old and new, and recommend one of them.

    Both policies fly the paper's 54 targets, from rest and chained, by the real control loop, on the nominal simulator,
    the patched one and a held-out robot. With --config they then fly on its wires: the robot moves, and you are asked
    first. Writes verdict.json, report.html, summary.json, limits-patch.yaml (the rail limits that the campaign shows)
    and, if an effect was named, patched-model.yaml and the retrained policy (.onnx, .pt). With --fault or --robot MODEL
    you declare that the held-out robot is the one that was recorded: only then does its success enter the verdict, as
    success_real.

    Exit code 0: fly the retrained policy. 3: finished; keep the old policy.

    \b
    Examples:
      softarm close-gap campaign --out closed
      softarm close-gap campaign --out closed --quick
      softarm close-gap campaign --out closed --fault regulator.dead_time_s=0.06 --fault arm.payload_kg=0.03
      softarm close-gap campaign --out closed --robot other-robot.yaml --config softarm.yaml --twin
    """
    from softarm.daemon.limits.findings import findings
    from softarm.diagnosis import report
    from softarm.diagnosis.data.read import rail_motions
    from softarm.diagnosis.from_files import diagnose_files
    from softarm.evaluation.closing import steps
    from softarm.evaluation.closing.advice import advise
    from softarm.training.run.retrain import RetrainingConfig

    if faults and robot != REALITY:
        raise click.UsageError("--fault is for the independent robot: omit --robot, or add the effect to its model")
    check_wires(config_file, twin, yes)
    every = TENTH if quick else 1
    goals = goals or -(-GOALS // every)
    recipe = RetrainingConfig() if seconds is None else RetrainingConfig(seconds=seconds)
    spent = steps.Spent()
    with failing(ValueError, RuntimeError), writing("choose another --out"):
        config = load_config(config_file)
        model = None if robot == REALITY else flown_model(Path(robot))
        held_out = steps.independent(faults) if model is None else steps.simulated(robot, model)
        file = steps.policy_file(policy)
        steps.make_folder(out)
        leaves(f"the results so far are in {out}; they cannot be continued: start again with another --out")
        with steps.timed(spent, "diagnose"), bar("reading") as shown:
            found = diagnose_files([campaign], model_file, progress=shown.report, warn=warn)
        print_text("\n".join(report.answer(found)))
        rail = findings(rail_motions([campaign]), config)
        if clock := [name for name in (found.patched.effects if found.patched else ()) if name.startswith("clock.")]:
            warn(f"{', '.join(clock)}: used in training, not in flights, which run the real control loop")
        own = bool(faults) or robot != REALITY
        through = partial(through_wires, Bench(config_file, twin, robot, own, yes, goals, out, spent))
        closed = steps.close(found, rail, file, out, held_out, own, recipe, spent, mppi, every, through)
    _show(closed, spent, out)
    if advise(closed).fly == "old":
        raise SystemExit(KEEP_THE_OLD)


def _show(closed: "Closed", spent: "Spent", out: Path) -> None:
    """Print the results per robot and start, the recommendation, stricter limits, times, files and warnings."""
    from softarm.evaluation.closing import steps, story

    print_table(*story.lines(closed), width=120)
    print_text("\n".join(story.sentences(closed)))
    print_stricter(closed.rail)
    print_text(", ".join(f"{step} {t['wall_s']:.0f} s ({t['cpu_s']:.0f} s of CPU)" for step, t in spent.items()))
    click.echo(f"wrote {', '.join(name for name in steps.FILES if (out / name).exists())} to {out}")
    warn(*(f"warning: {text}" for text in closed.diagnosis.verdict.warnings))
