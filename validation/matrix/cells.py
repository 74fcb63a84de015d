"""Cells of the fault matrix, their outcomes, and the judgement of each outcome."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product

from softarm.schemas.robot import RAIL_EXCURSION_M, RAIL_LIMIT_M, RAIL_TRAVEL_M
from validation.matrix.faulty_policies import FAULTS
from validation.matrix.wires import Direction, Fault

# Maximum time from a fault to a braked cart and a vented muscle; a stop waits 1 s for a silent axis.
SAFE_S = 1.5
DEVICES = ("mocap", "regulator", "rail")
PHASES = ("open", "read", "write", "close")
# Device or process -> prefixes of the events that name it.
NAMED_BY = {
    "mocap": ("mocap_", "tip_", "body_"),
    "regulator": ("regulator_", "pressure_"),
    "rail": ("rail_",),
    "policy": ("policy_",),
    "daemon": ("ticks_missed", "tick_late", "regulator_vented", "rail_"),
    "rail link": ("rail_",),
    "disk": ("not_recorded", "recorder_"),
}
# Events whose remedy does not fit any of these faults.
NEVER = ("rail_disagrees", "internal_error", "stop_requested")
# Faults of a policy that stop the whole daemon meanwhile: it then misses what the devices send, and says so as well.
FREEZING = ("holds-the-lock",)
FROZEN = ("mocap_", "pressure_", "rail_", "regulator_", "ticks_")
# Faults of a policy that do not require a stop.
TOLERATED = ("excessive",)


@dataclass(frozen=True)
class Cell:
    """One fault of one device or process."""

    who: str
    phase: str
    fault: str

    @property
    def directions(self) -> tuple[Direction, ...]:
        """Return the disturbed directions of a wire."""
        return ("write",) if self.phase == "write" else ("read",) if self.phase == "read" else ("read", "write")

    @property
    def must_stop(self) -> bool:
        """Return whether the arm must stop, because it would lack sensing or actuation."""
        if self.who in DEVICES:
            return self.fault not in (Fault.SLOW, Fault.CLOCK_JUMP)
        return self.who not in ("disk",) and self.fault not in TOLERATED

    @property
    def reach_m(self) -> float:
        """Return how far from the middle the cart may come.

        A drive that suddenly reacts later than measured can pass the soft limit, but must not reach the hard stop.
        """
        slow = self.who == "rail" and self.fault == Fault.SLOW
        return RAIL_TRAVEL_M - RAIL_EXCURSION_M if slow else RAIL_LIMIT_M + RAIL_EXCURSION_M

    def __str__(self) -> str:
        return f"{self.who}, {self.phase}: {self.fault}"


@dataclass
class Outcome:
    """Outcome of a cell."""

    stopped: bool = False  # the arm left `armed`, or could not be armed
    braked_ms: float | None = None  # from the fault; None if not observed
    vented_ms: float | None = None
    farthest_m: float = 0.0  # cart from the middle
    crashes: int = 0
    message: str = ""  # shown to the operator
    causes: tuple[str, ...] = ()  # events that stopped the arm, from the log
    logged: tuple[str, ...] = ()  # all events in the log during the fault
    recovery: str = ""  # how operation resumed
    problems: list[str] = field(default_factory=list)  # reasons why the cell could not be flown


def cells() -> Iterator[Cell]:
    """Yield all cells in the order in which they are flown."""
    yield from (Cell(*each) for each in product(DEVICES, PHASES, Fault) if exists(*each))
    yield from (Cell("policy", "step", fault) for fault in FAULTS)
    yield Cell("disk", "write", "full")
    yield from (Cell("rail link", "process", fault) for fault in ("SIGSTOP", "kill -9"))
    yield from (Cell("daemon", "process", fault) for fault in ("SIGSTOP", "kill -9"))


def exists(device: str, phase: str, fault: Fault) -> bool:
    """Return whether a fault is possible; the daemon writes nothing to the cameras, and the drive has no clock."""
    if device == "mocap" and phase == "write":
        return False
    if fault is Fault.CLOCK_JUMP:
        return device != "rail" and phase != "write"
    return True


def faults_of(cell: Cell, outcome: Outcome) -> list[str]:
    """Return the defects of an outcome; an empty list means safe and attributed to the right device."""
    wrong = list(outcome.problems)
    if outcome.crashes:
        wrong.append("unsafe: the cart struck the end of the rail")
    if outcome.farthest_m > cell.reach_m:
        wrong.append(f"unsafe: the cart was at {outcome.farthest_m:.3f} m")
    if cell.must_stop and not outcome.stopped:
        wrong.append("unsafe: the arm was not stopped")
    if outcome.stopped and cell.phase != "open":
        for what, took_ms in (("the cart braked", outcome.braked_ms), ("the muscle vented", outcome.vented_ms)):
            if took_ms is None or took_ms > SAFE_S * 1e3:
                wrong.append(f"unsafe: {what} after {'never' if took_ms is None else f'{took_ms:.0f} ms'}")
    prefixes = NAMED_BY[cell.who]
    if cell.fault in FREEZING and outcome.causes and outcome.causes[0].startswith(prefixes):
        prefixes += FROZEN
    others = [cause for cause in outcome.causes if cause in NEVER or not cause.startswith(prefixes)]
    if others:
        wrong.append(f"wrong cause: {', '.join(others)}")
    if cell.must_stop and cell.phase not in ("close", "process") and not outcome.causes:
        wrong.append("no cause is named")
    return wrong
