"""`softarm close-gap`: diagnose recordings of a robot, patch the simulator and compare the ways to use the patch."""

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.gap.recorded import print_stricter
from softarm.cli.shared.console import FILE, FOLDER, Number, flown_model, load_config, print_table, print_text, warn
from softarm.cli.shared.errors import failing, leaves
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.evaluation.closing.closed import Closed, Spent
    from softarm.evaluation.closing.wires import Twin, Wires

REALITY = "reality"
QUICK = 36  # --quick: largest number of flights of a way
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
@click.option("--goals", type=click.IntRange(1, 1000), default=18, show_default=True, help="Per start, on the wires.")
@click.option("--quick", is_flag=True, help=f"At most {QUICK} flights of a way: only large gains are proven.")
@click.option(
    "--adaptive", default="reach-robust", show_default=True, help="Also fly this policy, which needs no diagnosis."
)
@click.option("--seconds", type=Number(1, 86400), help="Longest retraining.  [default: 120]")
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
    goals: int,
    quick: bool,
    adaptive: str,
    seconds: float | None,
) -> None:
    """Diagnose CAMPAIGN, patch the simulator, and compare the ways to use the patch.

    The ways are mppi planning on the patched model, a policy that adapts in flight, and the old policy trained on in
    the patched simulator. The real control loop flies each against the old policy, to the paper's 54 targets, from rest
    and in mid-swing, until the decision is clear. With --fault or --robot MODEL you declare that the held-out robot is
    the one that was recorded: the flights are on it. Otherwise they are on the patched simulator.

    With --config the old and the retrained policy then fly on its wires: the robot moves, and you are asked first.
    Writes verdict.json, report.html, summary.json, limits-patch.yaml (the rail limits that the campaign shows) and, if
    an effect was named, patched-model.yaml and the retrained policy (.onnx, .pt).

    Exit code 0: fly the recommended policy. 3: finished; keep the old policy.

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
    from softarm.diagnosis.diagnose import diagnose_files
    from softarm.evaluation.closing import fly, steps
    from softarm.evaluation.closing.closed import Spent, advise
    from softarm.evaluation.closing.outcomes import OLD
    from softarm.training.run.retrain import RetrainingConfig

    if faults and robot != REALITY:
        raise click.UsageError("--fault is for the independent robot: omit --robot, or add the effect to its model")
    check_wires(config_file, twin, yes)
    recipe = RetrainingConfig() if seconds is None else RetrainingConfig(seconds=seconds)
    spent: Spent = {}
    with failing(ValueError, RuntimeError):
        config = load_config(config_file)
        model = None if robot == REALITY else flown_model(Path(robot))
        held_out = steps.independent(faults) if model is None else steps.simulated(robot, model)
        file, other = steps.policy_file(policy, True), steps.policy_file(adaptive, False)
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
        options = steps.Options(adaptive=None if other == file else other, draws=QUICK if quick else fly.MOST)
        closed = steps.close(found, rail, file, out, held_out, own, recipe, spent, options, through, click.echo)
    _show(closed, out)
    if advise(closed).fly == OLD:
        raise SystemExit(KEEP_THE_OLD)


def _show(closed: "Closed", out: Path) -> None:
    """Print the results per way, the recommendation, stricter limits, times, files and warnings."""
    from softarm.evaluation.closing import steps, story

    print_table(*story.lines(closed), width=120)
    print_text("\n".join(story.sentences(closed)))
    print_stricter(closed.rail)
    print_text(", ".join(f"{step} {t['wall_s']:.0f} s ({t['cpu_s']:.0f} s of CPU)" for step, t in closed.spent.items()))
    click.echo(f"wrote {', '.join(name for name in steps.FILES if (out / name).exists())} to {out}")
    warn(*(f"warning: {text}" for text in closed.diagnosis.verdict.warnings))


@dataclass(frozen=True)
class Bench:
    """Options of the flights on real interfaces."""

    config_file: Path | None  # None: no such flights
    twin: bool
    robot: str  # --robot, the held-out robot
    declared: bool
    yes: bool
    goals: int  # per policy: from rest, and as many chained
    out: Path
    spent: "Spent"


def check_wires(config_file: Path | None, twin: bool, yes: bool) -> None:
    """Check the options of the wire flights before the long work. Raises UsageError without a configuration."""
    if config_file is None:
        if twin or yes:
            raise click.UsageError("--twin and --yes go with --config: name a configuration")
    elif not (twin or yes or sys.stdin.isatty()):
        click.echo(f"{config_file}: its robot will not move without confirmation; add --yes or --twin", err=True)


def through_wires(bench: Bench, closed: "Closed") -> "Wires | None":
    """Fly through the wires after all other flights; return None without --config."""
    from softarm.evaluation.closing import wires

    if bench.config_file is None or closed.retrained is None:
        return None
    title = f"the robot of {bench.config_file.name}"
    if not bench.twin and (why := _refusal(bench, closed)):
        return wires.Wires.unflown(title, why)
    return _flown(bench, closed, title)


def _refusal(bench: Bench, closed: "Closed") -> str | None:
    """Return why the robot must not move, or None if a person has agreed."""
    from softarm.evaluation.closing import story, wires

    assert bench.config_file is not None
    if refused := wires.refusals(closed.rail.config, closed.rail):
        return "; ".join(refused)
    if not (bench.yes or sys.stdin.isatty()):
        return "not confirmed, since there is no terminal; add --yes"
    if not bench.yes:
        click.echo("\n".join(story.sentences(closed)), err=True)
    click.echo(wires.what_moves(closed.rail.patched, bench.config_file.name, bench.goals), err=True)
    question = "Is the area clear, and is a person at the emergency stop?"
    return None if bench.yes or click.confirm(question, default=False, err=True) else "not confirmed"


def _flown(bench: Bench, closed: "Closed", title: str) -> "Wires":
    """Fly through the wires; an error there keeps all earlier results."""
    from softarm.evaluation.closing import wires
    from softarm.evaluation.closing.outcomes import NEW, OLD
    from softarm.evaluation.closing.steps import timed
    from softarm.evaluation.software_in_the_loop import SoftwareInTheLoopError

    assert closed.retrained is not None
    config, twin = closed.rail.patched, _twin(bench, closed) if bench.twin else None
    policies = {OLD: closed.policy, NEW: closed.retrained.policy}
    logs = config.recorder.directory if twin is None else bench.out / "wires"
    try:
        with timed(bench.spent, "wires"), bar("flying on the wires") as shown:
            return wires.fly(config, policies, bench.goals, title, logs, twin, shown.report)
    except (SoftwareInTheLoopError, ValueError, OSError) as error:
        return wires.Wires.unflown(title if twin is None else twin.title, str(error))


def _twin(bench: Bench, closed: "Closed") -> "Twin":
    """Return the held-out robot as a twin process behind the wires."""
    from softarm.evaluation.closing.outcomes import HELD_OUT
    from softarm.evaluation.closing.wires import Twin
    from softarm.schemas.model import Model
    from softarm.simulator import model_file

    place, nominal = closed.place(HELD_OUT), closed.diagnosis.nominal
    assert nominal is not None
    title = f"our twin, as {place.title}"
    if isinstance(place.robot, Model):
        return Twin(title, ("--model", bench.robot), bench.declared)
    body = bench.out / "wires" / "robot.yaml"  # arm and cart only, as in the earlier flights
    body.parent.mkdir(parents=True, exist_ok=True)
    model_file.save(Model(arm=nominal.arm, cart=nominal.cart), body)
    faults = (part for fault in place.faults for part in ("--fault", fault))
    return Twin(title, ("--reality", "--model", str(body), *faults), bench.declared)
