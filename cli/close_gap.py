"""`softarm close-gap`: from recordings of a robot to a policy that was trained on what they showed."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.options import FILE, FOLDER, flown_model
from softarm.cli.printing import print_table, print_text, warn
from softarm.cli.rail_limits import tell_stricter
from softarm.cli.wires import GOALS, Bench, check_wires, through_wires
from softarm.common.processes import WorkerDied, bar

if TYPE_CHECKING:
    from softarm.flights.closing.closed import Closed
    from softarm.flights.closing.steps import Spent

REALITY = "reality"
KEEP_THE_OLD = 3  # exit code: all was done, and the retrained policy is not the one to fly


@click.command("close-gap")
@click.argument("campaign", type=click.Path(path_type=Path))
@click.option("--out", type=FOLDER, required=True, help="Folder for everything that comes out.")
@click.option("--policy", default="reach-robust", show_default=True, help="To train on: a shipped name or .onnx file.")
@click.option("--model", "model_file", type=FILE, help="Nominal simulator (default: the campaign's, else seed).")
@click.option("--robot", default=REALITY, show_default=True, help="To prove it on: the independent one, or a model.")
@click.option("--fault", "faults", multiple=True, metavar="GROUP.QUANTITY=VALUE", help="Of that robot; again for more.")
@click.option("--config", "config_file", type=FILE, help="To fly and train by; both then fly through its wires.")
@click.option("--twin", is_flag=True, help="With --config: our twin, as the robot of --robot, stands for its devices.")
@click.option("--yes", is_flag=True, help="With --config: move the robot without asking.")
@click.option("--goals", default=GOALS, show_default=True, type=click.IntRange(1, 1000), help="On wires, each manner.")
@click.option("--mppi/--no-mppi", default=True, help="Fly mppi on the patched model too, which takes no training.")
@click.option("--seconds", type=click.FloatRange(1, 86400), help="Of retraining, at most.  [default: 120]")
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
    mppi: bool,
    seconds: float | None,
) -> None:
    """Diagnose CAMPAIGN, patch the simulator, train the policy on in it, fly old and new, and say which to fly.

    Both fly the paper's 54 targets, from rest and chained, by the daemon's own tick, on the nominal simulator, the
    patched one and a held-back robot; with --config then through its wires, where the robot moves: you are asked first.
    Leaves verdict.json, report.html, summary.json, limits-patch.yaml (what the campaign shows of the rail, by which is
    trained and flown), and, when an effect was named, patched-model.yaml and the retrained policy (.onnx, .pt). A robot
    that is declared (--fault, --robot MODEL) counts as the campaign's own: its flights are the verdict's success_real.

    Exit code 0: fly the retrained policy. 3: all was done; keep the old one.

    \b
    Examples:
      softarm close-gap campaign --out closed
      softarm close-gap campaign --out closed --fault regulator.dead_time_s=0.06 --fault arm.payload_kg=0.03
      softarm close-gap campaign --out closed --robot other-robot.yaml --config softarm.yaml --twin
    """
    from softarm.daemon.config.configuration import ConfigurationError, load
    from softarm.daemon.limits.findings import findings
    from softarm.diagnosis import report
    from softarm.diagnosis.data.read import rail_motions
    from softarm.diagnosis.data.trials import TrialError
    from softarm.diagnosis.from_files import diagnose_files
    from softarm.flights.closing import steps
    from softarm.policies.base import PolicyError
    from softarm.schemas.config import Config
    from softarm.simulator.model_file import ModelFileError
    from softarm.training.run.checkpoint import CheckpointError
    from softarm.training.run.retrain import RetrainingConfig

    if faults and robot != REALITY:
        raise click.UsageError("--fault is for the independent robot: leave --robot out, or put it into that model")
    check_wires(config_file, twin, yes)
    wrong = (ConfigurationError, TrialError, ModelFileError, CheckpointError, PolicyError, WorkerDied)
    recipe = RetrainingConfig() if seconds is None else RetrainingConfig(seconds=seconds)
    spent = steps.Spent()
    try:
        config = load(config_file) if config_file else Config()
        model = None if robot == REALITY else flown_model(Path(robot))
        held_back = steps.independent(faults) if model is None else steps.simulated(robot, model)
        file = steps.policy_file(policy)
        steps.make_folder(out)
        leaves(f"what was done so far lies in {out}; nothing goes on from there, start again with another --out")
        with steps.timed(spent, "diagnose"), bar("reading") as shown:
            found = diagnose_files([campaign], model_file, tell=shown.tell, warn=warn)
        print_text("\n".join(report.answer(found)))
        rail = findings(rail_motions([campaign]), config)
        if clock := [name for name in (found.patched.effects if found.patched else ()) if name.startswith("clock.")]:
            warn(f"{', '.join(clock)}: trained with, not flown; the control loop that flies is the real one")
        own = bool(faults) or robot != REALITY
        through = through_wires(Bench(config_file, twin, robot, own, yes, goals, out, spent))
        closed = steps.close(found, rail, file, out, held_back, own, recipe, spent, replanned=mppi, through=through)
    except (*wrong, ValueError, RuntimeError) as error:
        fail(str(error))
    except OSError as error:
        fail(f"{error.filename}: cannot be written ({error.strerror}); name another --out")
    _show(closed, spent, out)
    if closed.advice.fly == "old":
        raise SystemExit(KEEP_THE_OLD)


def _show(closed: "Closed", spent: "Spent", out: Path) -> None:
    """A row a robot and manner, what came of it, where it stands."""
    from softarm.flights.closing import steps, story

    print_table(*story.lines(closed), width=120)
    print_text("\n".join(story.sentences(closed)))
    tell_stricter(closed.rail)
    print_text(", ".join(f"{step} {t['wall_s']:.0f} s ({t['cpu_s']:.0f} s of CPU)" for step, t in spent.items()))
    click.echo(f"wrote {', '.join(name for name in steps.FILES if (out / name).exists())} to {out}")
    warn(*(f"warning: {text}" for text in closed.diagnosis.verdict.warnings))
