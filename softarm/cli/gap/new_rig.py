"""`softarm new rig`: write the stage.yaml of another rig from its recordings.

Unknown facts are asked for at a terminal; otherwise an error names the option.
"""

import math
import os
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from softarm.cli.shared.console import FILE, INPUT, Number, check_places, print_table, waiting, warn, write
from softarm.cli.shared.errors import NOTHING, Failure, fail, leaves
from softarm.common.quantity import PURE
from softarm.schemas.stage_model import DESCRIBED

if TYPE_CHECKING:
    from softarm.diagnosis.describe.joints import ModelJoint
    from softarm.diagnosis.describe.proposal import Answers, Proposal, Question
    from softarm.diagnosis.describe.survey import Survey
    from softarm.diagnosis.rigs.mjcf.actuators import Actuator
    from softarm.diagnosis.rigs.mjcf.mechanism import Joint

UNIT_ERROR = 0.2  # relative difference of an actuator's gain and stiffness up to which its command has a unit
KINDS = click.Choice(DESCRIBED)
# Option -> kinds of mechanism that use it.
_USED_BY = {
    **dict.fromkeys(("name", "kind", "measured", "nominal"), DESCRIBED),
    "command": ("tracking", "driven_mass", "chain"),
    "base": ("pendulum", "chain"),
    "angles": ("chain",),
}
ANGLES = click.Choice(("absolute", "relative"))
RATE = Number(min=0, min_open=True)
_VALUES = {"--unit": "UNIT", "--nominal": "NUMBER", "--rate": "HZ", "--command": "COLUMN", "--measured": "COLUMN"}


def _pairs(_: click.Context, option: click.Parameter, texts: tuple[str, ...]) -> dict[str, str]:
    """Return KEY=VALUE options by their keys; the last equals sign separates, since headers may hold others."""
    for text in texts:
        if not all(text.rpartition("=")):
            raise click.UsageError(f"{option.opts[0]} {text}: has no value; write {option.opts[0]} NAME=VALUE")
    return {text.rpartition("=")[0]: text.rpartition("=")[2] for text in texts}


@click.command()
@click.argument("data", metavar="DATA...", type=INPUT, nargs=-1, required=True)
@click.option("--out", type=FILE, default=Path("stage.yaml"), show_default=True, help="The file to write.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--name", default="", help="Name of the mechanism in the answer (default: the folder's).")
@click.option("--kind", type=KINDS, help="Kind of mechanism.")
@click.option("--command", multiple=True, metavar="COLUMN", help="Command, force or torques; may be repeated.")
@click.option("--measured", multiple=True, metavar="COLUMN", help="Measured output; may be repeated, from link 1 on.")
@click.option("--base", default="", metavar="COLUMN", help="Position of the cart below a pendulum or chain.")
@click.option("--time", default="", metavar="COLUMN", help="Time column.")
@click.option("--rate", "rate_hz", type=RATE, metavar="HZ", help="Rows a second, for tables without a time column.")
@click.option(
    "--unit",
    "units",
    multiple=True,
    callback=_pairs,
    metavar="COLUMN=UNIT",
    help='Unit of a column; * fits several: "q*=rad".',
)
@click.option(
    "--nominal",
    multiple=True,
    callback=_pairs,
    metavar="KEY=NUMBER",
    help="Value of the nominal model: mass_kg=0.4,0.3.",
)
@click.option("--angles", type=ANGLES, help="Angles of a chain: from the vertical, or from link to link.")
def rig(data: tuple[Path, ...], out: Path, overwrite: bool, name: str, **given: Any) -> None:
    """Describe the recordings of another rig in a stage.yaml, and check it.

    DATA are tables (.csv, .tsv, .txt, .dat, .parquet, .mat), ROS bags (.mcap, .db3, .bag) or folders of them. Columns,
    units and rates that the recordings show are written with their reason. The rest is asked for, or without a terminal
    taken from the options.
    With an MJCF or URDF file (.xml, .urdf) among DATA, columns are found by the names of its joints, actuators
    and sensors. Torques, such as efforts of joint states, drive the joints without commands.

    \b
    Examples:
      softarm new rig recordings
      softarm new rig robot.xml recordings
      softarm new rig runs/*.csv --kind tracking --unit "angle*=deg" --out servo.yaml
      softarm new rig swings --kind pendulum --nominal mass_kg=0.15 --nominal centre_m=0.15 --nominal inertia_kg_m2=1e-4
    """
    from softarm.diagnosis.data import mjcf
    from softarm.diagnosis.data.stage_file import called
    from softarm.diagnosis.describe import joints as of_joints
    from softarm.diagnosis.describe import stage_text
    from softarm.diagnosis.describe.proposal import Answers, propose
    from softarm.diagnosis.describe.survey import survey

    leaves(NOTHING)
    _may_be_written(out, overwrite)
    models = [path for path in data if path.suffix.lower() in (".xml", ".urdf")]
    if len(models) > 1:
        raise click.UsageError(f"{', '.join(map(str, models))}: allowed is one model; name one")
    if len(models) == len(data):
        raise click.UsageError(f"{models[0]}: a model and no recordings; name their files or folders as well")
    with waiting("reading the recordings"):
        found = survey([path for path in data if path not in models])
    if models:
        joints, loaded = _joints(models[0]), mjcf.load(models[0])
        found = of_joints.named(found, joints, _sensors(*loaded))
    _show(found)
    if models:
        where, leaders = os.path.relpath(models[0].resolve(), out.parent.resolve()), partial(_leaders, models[0])
        known = joints, where, leaders, mjcf.places(*loaded)
        proposal = proposed(Answers(**given), lambda answers: of_joints.propose(found, answers, *known))
    else:
        proposal = proposed(Answers(**given), lambda answers: propose(found, answers))
    _refuse_unused(proposal.kind, {"name": name, **given})
    text = stage_text.text(found, proposal, name or called(out), out.parent, f"softarm check {out}")
    write(out, text)
    if models:
        warn(*(f"warning: {note}" for note in proposal.notes))
    leaves(f"{out} was written")
    _check(out, bool(proposal.model))


def _refuse_unused(kind: str, given: Mapping[str, Any]) -> None:
    """Raise UsageError if an option is given that this kind of mechanism does not use."""
    for option, kinds in _USED_BY.items():
        if given[option] and kind not in kinds:
            raise click.UsageError(f"--{option} is for {', '.join(kinds)}; this mechanism is {kind}: omit it")


def _joints(model: Path) -> "tuple[ModelJoint, ...]":
    """Return the joints of a model with their ranges and actuators."""
    from softarm.diagnosis.describe.joints import ModelJoint
    from softarm.diagnosis.rigs.mjcf.mechanism import mechanism

    found, robot = [], mechanism(model)
    for pose in robot.poses:
        found += [ModelJoint(name, "m", math.inf, "", "", moved=True) for name in pose.place]
        found += [ModelJoint(name, PURE, math.inf, "", "", moved=True) for name in pose.turn]
    for joint in robot.joints.values():
        unit, actuator = "rad" if joint.turns else "m", joint.actuator
        name, span = actuator.name if actuator is not None else "", joint.range[1] - joint.range[0]
        shares = {each: _command_unit(joint, own) for each, own in actuator.shares.items()} if actuator else {}
        command_unit = _command_unit(joint, actuator)
        if len(shares) == 1:  # a muscle alone, whose column may have any name of a command
            command_unit, shares = shares[name], {}
        found.append(ModelJoint(joint.name, unit, span, name, command_unit, shares=shares))
    return tuple(found)


def _sensors(mujoco: Any, model: Any) -> dict[str, tuple[str, str]]:
    """Return what each sensor of a position or joint torque reads, by its name: an object, and a torque's unit."""
    kinds = mujoco.mjtSensor
    units = dict.fromkeys((kinds.mjSENS_JOINTPOS, kinds.mjSENS_FRAMEPOS, kinds.mjSENS_FRAMEQUAT), "")
    units[kinds.mjSENS_JOINTACTFRC] = "N m"
    return {
        model.sensor(i).name: (mujoco.mj_id2name(model, model.sensor_objtype[i], model.sensor_objid[i]), units[kind])
        for i, kind in enumerate(map(kinds, model.sensor_type))
        if model.sensor(i).name and kind in units and model.sensor_refid[i] < 0
    }


def _command_unit(joint: "Joint", actuator: "Actuator | None") -> str:
    """Return the unit of an actuator's command: position, speed, or torque of its joint, or PURE as for 0 to 255."""
    unit, torque = ("rad", "N m") if joint.turns else ("m", "N")
    if actuator is None:
        return torque
    worth = {unit: actuator.kp, f"{unit}/s": actuator.kd, torque: 1.0}
    wanted = unit if actuator.kp > 0 else f"{unit}/s" if actuator.kd > 0 else torque
    return wanted if math.isclose(abs(actuator.scale), worth[wanted], rel_tol=UNIT_ERROR) else PURE


def _leaders(model: Path, measured: Collection[str]) -> dict[str, str]:
    """Return the measured joints that follow another by the model's equalities, with that joint."""
    from softarm.diagnosis.rigs.mjcf.mechanism import mechanism

    robot = mechanism(model, measured)
    found = {name: robot.leader(robot.joint(name)) for name in measured}
    return {name: leader for name, leader in found.items() if leader}


def _may_be_written(out: Path, overwrite: bool) -> None:
    """End the command if its file exists and may not be replaced."""
    check_places(out)
    if out.exists() and not overwrite:
        if not is_terminal():
            fail(f"{out}: exists and is not overwritten; choose another --out, or add --overwrite")
        if not click.confirm(f"{out} exists. Replace it?"):
            fail(f"{out}: not changed; choose another --out")


def _show(found: "Survey") -> None:
    """Print what the columns hold."""
    rows = []
    for signal in found.signals:
        low, high = (f"{x:.4g}" for x in (signal.all.min(), signal.all.max())) if len(signal.all) else ("-", "-")
        marks = ", ".join(map(str, signal.marks))
        rows.append((signal.label, low, high, signal.header.unit or "", signal.header.role, marks))
    count = len(found.recordings)
    title = f"{count} recording{'s' * (count > 1)}: columns"
    print_table(("column", "from", "to", "unit in header", "role by name", "missing values"), rows, title, width=120)


def _check(out: Path, has_model: bool) -> None:
    """Check the new file as `softarm check` does, and print the next command; has_model: its values are given."""
    from softarm.cli.setup.check import check_stage
    from softarm.diagnosis.data.trials import TrialError

    try:
        check_stage(out, None)
    except (Failure, TrialError):
        click.echo(f"next: correct {out}, then\n  softarm check {out}")
        raise
    missing = "" if has_model else f"complete `model:` in {out} with the values of your simulator, then"
    click.echo(f"next: {missing}".rstrip())
    click.echo(f"  softarm diagnose {out} --report {out.with_suffix('.html').name}")


def is_terminal() -> bool:
    """Return whether somebody can be asked."""
    return sys.stdin.isatty()


def proposed(answers: "Answers", propose: "Callable[[Answers], Proposal]") -> "Proposal":
    """Return the content of the file; ask for unknown facts at a terminal, else end the command with all of them."""
    from softarm.diagnosis.data.trials import TrialError
    from softarm.diagnosis.describe.proposal import Unknown

    before = answers
    while True:
        try:
            return propose(answers)
        except Unknown as unknown:
            if not is_terminal():
                fail("\n".join(map(_lacking, unknown.questions)))
            before, answers = answers, _asked(unknown.questions, answers)
        except TrialError as error:
            if before is answers:
                raise
            click.echo(str(error), err=True)
            answers = before


def _lacking(question: "Question") -> str:
    """Return the error about a fact that no option gives."""
    value = question.prefix + (question.likely or "|".join(question.choices[:1]) or _VALUES[question.option])
    allowed = f"; allowed {', '.join(question.choices)}" if question.choices else ""
    return f"{question.option} is missing: {question.text}{allowed}; add e.g. {question.option} {_quoted(value)}"


def _quoted(value: str) -> str:
    return value if value.replace("=", "").replace("_", "").replace(".", "").isalnum() else f'"{value}"'


def _asked(questions: Sequence["Question"], answers: "Answers") -> "Answers":
    """Return the answers with the reply to the first question."""
    question = questions[0]
    choices = click.Choice(question.choices) if question.choices and question.option != "--measured" else None
    kind: Any = RATE if question.option == "--rate" else choices
    said = click.prompt(question.text[0].upper() + question.text[1:], default=question.likely or None, type=kind)
    match question.option:
        case "--unit":
            return replace(answers, units={**answers.units, question.prefix[:-1]: said})
        case "--nominal":
            return replace(answers, nominal={**answers.nominal, question.prefix[:-1]: said})
        case "--rate":
            return replace(answers, rate_hz=said)
        case "--command":
            return replace(answers, command=(said,))
        case "--measured":
            return replace(answers, measured=tuple(part.strip() for part in said.split(",")))
        case plain:
            return replace(answers, **{plain.removeprefix("--"): said})
