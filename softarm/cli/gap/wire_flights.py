"""Flights of `softarm close-gap --config` on real interfaces, after a person has agreed."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.evaluation.closing.closed import Closed, Spent
    from softarm.evaluation.closing.wires import Twin, Wires


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
    if bench.yes:
        click.echo(wires.what_moves(closed.rail.patched, bench.config_file.name, bench.goals), err=True)
        return None
    if not sys.stdin.isatty():
        return "not confirmed, since there is no terminal; add --yes"
    click.echo("\n".join(story.sentences(closed)), err=True)
    click.echo(wires.what_moves(closed.rail.patched, bench.config_file.name, bench.goals), err=True)
    free = click.confirm("Is the area clear, and is a person at the emergency stop?", default=False, err=True)
    return None if free else "not confirmed"


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
