"""Old and retrained policy through the wires of a configuration, if a person says so: `softarm close-gap --config`."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.flights.closing.closed import Closed
    from softarm.flights.closing.steps import Spent
    from softarm.flights.closing.wires import Twin, Wires

GOALS = 18  # from rest, and as many chained, of each policy


@dataclass(frozen=True)
class Bench:
    """What is to be flown on, and by whose leave."""

    config_file: Path | None  # None: nothing
    twin: bool
    robot: str  # the held-back one's: --robot
    declared: bool
    yes: bool
    goals: int
    out: Path
    spent: "Spent"


def check_wires(config_file: Path | None, twin: bool, yes: bool) -> None:
    """Before minutes of work. Raises UsageError for options without a configuration."""
    if config_file is None:
        if twin or yes:
            raise click.UsageError("--twin and --yes are about the wires of a configuration: name it with --config")
    elif not (twin or yes or sys.stdin.isatty()):
        click.echo(f"{config_file}: its robot will not move, for nobody can be asked; give --yes, or --twin", err=True)


def through_wires(bench: Bench) -> "Callable[[Closed], Wires | None]":
    """What flies through the wires once all else has flown: None without a configuration."""

    def through(closed: "Closed") -> "Wires | None":
        from softarm.flights.closing import wires

        if bench.config_file is None or closed.retrained is None:
            return None
        title = f"the robot of {bench.config_file.name}"
        if not bench.twin and (why := _kept_still(bench, closed)):
            return wires.Wires.unflown(title, why)
        return _flown(bench, closed, title)

    return through


def _kept_still(bench: Bench, closed: "Closed") -> str | None:
    """Why the robot does not move; None when somebody says that it may."""
    from softarm.flights.closing import story, wires

    assert bench.config_file is not None
    if refused := wires.refusals(closed.rail.config, closed.rail):
        return "; ".join(refused)
    if bench.yes:
        click.echo(wires.what_moves(closed.rail.patched, bench.config_file.name, bench.goals), err=True)
        return None
    if not sys.stdin.isatty():
        return "nobody could be asked; give --yes"
    click.echo("\n".join(story.sentences(closed)), err=True)
    click.echo(wires.what_moves(closed.rail.patched, bench.config_file.name, bench.goals), err=True)
    free = click.confirm("Is its surrounding free, and somebody at the emergency stop?", default=False, err=True)
    return None if free else "not wanted"


def _flown(bench: Bench, closed: "Closed", title: str) -> "Wires":
    """Fly; what does not come up is said, and costs nothing of what was found before."""
    from softarm.flights.closing import wires
    from softarm.flights.closing.outcomes import NEW, OLD
    from softarm.flights.closing.steps import timed
    from softarm.flights.software_in_the_loop import SoftwareInTheLoopError

    assert closed.retrained is not None
    config, twin = closed.rail.patched, _twin(bench, closed) if bench.twin else None
    policies = {OLD: closed.policy, NEW: closed.retrained.policy}
    logs = config.recorder.directory if twin is None else bench.out / "wires"
    try:
        with timed(bench.spent, "wires"), bar("on the wires") as shown:
            return wires.fly(config, policies, bench.goals, title, logs, twin, shown.tell)
    except (SoftwareInTheLoopError, ValueError, OSError) as error:
        return wires.Wires.unflown(title if twin is None else twin.title, str(error))


def _twin(bench: Bench, closed: "Closed") -> "Twin":
    """The held-back robot, in a process of its own behind the wires."""
    from softarm.flights.closing.outcomes import HELD_BACK
    from softarm.flights.closing.wires import Twin
    from softarm.schemas.model import Model
    from softarm.simulator import model_file

    place, nominal = closed.place(HELD_BACK), closed.diagnosis.nominal
    assert nominal is not None
    title = f"our twin, as {place.title}"
    if isinstance(place.robot, Model):
        return Twin(title, ("--model", bench.robot), bench.declared)
    body = bench.out / "wires" / "robot.yaml"  # its actuators are its own, as in the flights before
    body.parent.mkdir(parents=True, exist_ok=True)
    model_file.save(Model(arm=nominal.arm, cart=nominal.cart), body)
    faults = (part for fault in place.faults for part in ("--fault", fault))
    return Twin(title, ("--reality", "--model", str(body), *faults), bench.declared)
