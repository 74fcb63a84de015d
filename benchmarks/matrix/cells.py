"""The cells of the matrix, what each of them left, and whether that was safe and rightly blamed. Pure."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

from softarm.benchmarks.matrix.guests import NAMES
from softarm.benchmarks.matrix.wires import Direction, Fault
from softarm.schemas.robot import RAIL_EXCURSION_M, RAIL_LIMIT_M, RAIL_TRAVEL_M

# From a fault that stops to a braked cart and a regulator switched off; for a silent axis a stop waits 1 s.
SAFE_S = 1.5
DEVICES = ("mocap", "regulator", "rail")
PHASES = ("open", "read", "write", "close")
# The events that name the guilty, by what they begin with.
BLAMES = {
    "mocap": ("mocap_", "tip_", "body_"),
    "regulator": ("regulator_", "pressure_"),
    "rail": ("rail_",),
    "policy": ("policy_",),
    "daemon": ("ticks_missed", "tick_late", "regulator_vented", "rail_"),
    "rail link": ("rail_",),
    "disk": ("not_recorded", "recorder_"),
}
# Whose remedy (home the axis, report the error) helps against nothing of what is broken here.
NEVER = ("rail_disagrees", "internal_error", "stop_requested")
# Faults of a policy that the daemon has an answer for other than to stop.
BORNE = ("sweep", "wild")


@dataclass(frozen=True)
class Cell:
    """One thing that goes wrong."""

    who: str
    phase: str
    fault: str

    @property
    def directions(self) -> tuple[Direction, ...]:
        """Of a wire: which ways are bad."""
        return ("write",) if self.phase == "write" else ("read",) if self.phase == "read" else ("read", "write")

    @property
    def must_stop(self) -> bool:
        """Whether flying on would be flying blind, or with a device that hears nothing."""
        if self.who in DEVICES:
            return self.fault not in (Fault.SLOW, Fault.CLOCK_JUMP)
        return self.who not in ("disk",) and self.fault not in BORNE

    @property
    def reach_m(self) -> float:
        """How far from the middle the cart may come. No law can count on a drive that is slow from one moment to the
        next by more than it was measured to be: then it is the hard stop that must not be reached.
        """
        slow = self.who == "rail" and self.fault == Fault.SLOW
        return RAIL_TRAVEL_M - RAIL_EXCURSION_M if slow else RAIL_LIMIT_M + RAIL_EXCURSION_M

    def __str__(self) -> str:
        return f"{self.who}, {self.phase}: {self.fault}"


@dataclass
class Outcome:
    """What a cell left."""

    stopped: bool = False  # the arm left `armed`, or could not be armed
    braked_ms: float | None = None  # from the fault; None: not seen
    vented_ms: float | None = None
    farthest_m: float = 0.0  # of the cart from the middle
    crashes: int = 0
    told: str = ""  # what the operator reads
    causes: tuple[str, ...] = ()  # the events that stopped it, by the log
    logged: tuple[str, ...] = ()  # all events that the log holds of that time
    again: str = ""  # how it goes on
    problems: list[str] = field(default_factory=list)  # of the cell itself: it could not be flown

    def as_json(self) -> dict[str, Any]:
        """For the results."""
        return asdict(self)


def cells() -> Iterator[Cell]:
    """All of them, in the order in which they are flown."""
    for device in DEVICES:
        for phase in PHASES:
            for fault in Fault:
                if exists(device, phase, fault):
                    yield Cell(device, phase, fault.value)
    yield from (Cell("policy", "step", name) for name in NAMES if name != "sweep")
    yield Cell("disk", "write", "full")
    yield from (Cell("rail link", "process", fault) for fault in ("SIGSTOP", "kill -9"))
    yield from (Cell("daemon", "process", fault) for fault in ("SIGSTOP", "kill -9"))


def exists(device: str, phase: str, fault: Fault) -> bool:
    """Whether there is such a thing: the daemon writes nothing to the cameras, and the drive has no clock."""
    if device == "mocap" and phase == "write":
        return False
    if fault is Fault.CLOCK_JUMP:
        return device != "rail" and phase != "write"
    return True


def faults_of(cell: Cell, outcome: Outcome) -> list[str]:
    """What is wrong with how a cell ended; empty: it is safe and rightly blamed."""
    wrong = list(outcome.problems)
    if outcome.crashes:
        wrong.append("unsafe: the cart struck the end of the rail")
    if outcome.farthest_m > cell.reach_m:
        wrong.append(f"unsafe: the cart was at {outcome.farthest_m:.3f} m")
    if cell.must_stop and not outcome.stopped:
        wrong.append("unsafe: it was flown on")
    if outcome.stopped and cell.phase != "open":
        for what, took_ms in (("the cart braked", outcome.braked_ms), ("the muscle vented", outcome.vented_ms)):
            if took_ms is None or took_ms > SAFE_S * 1e3:
                wrong.append(f"unsafe: {what} after {'never' if took_ms is None else f'{took_ms:.0f} ms'}")
    blamed = BLAMES[cell.who]
    others = [cause for cause in outcome.causes if cause in NEVER or not cause.startswith(blamed)]
    if others:
        wrong.append(f"wrongly blamed: {', '.join(others)}")
    if cell.must_stop and cell.phase not in ("close", "process") and not outcome.causes:
        wrong.append("nobody is blamed")
    return wrong
