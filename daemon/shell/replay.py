"""The same tick over a recorded log: it must give the same commands, bit for bit, wherever the log holds every tick.

Where ticks are missing (of a still arm that was switched off, most are; a log may begin in the middle of a run) the
controller is put where the log says it stood. A few ticks later it has seen all that a tick remembers of the devices,
and is compared again; where a goal was flown, once that is over, for its policy remembers more.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from softarm.daemon.control.checks import DISAGREEING_TICKS
from softarm.daemon.control.plausibility import WINDOW
from softarm.daemon.control.records import Inputs, Outputs
from softarm.daemon.control.safety import KNOWN_S
from softarm.daemon.tick import Controller
from softarm.policies.base import Array, Policy
from softarm.policies.runner import InlineRunner, PolicyOutcome, PolicyRunner
from softarm.schemas.config import Config


@dataclass(frozen=True, slots=True)
class Difference:
    """A tick that came out otherwise than it was recorded."""

    tick: int
    field: str
    recorded: object
    replayed: object


class _RecordedFaults:
    """Runs the policy again, but fails where the recorded one failed: lateness is not in the numbers."""

    def __init__(self, policy: Policy) -> None:
        self._inline = InlineRunner(policy)
        self.policy = policy
        self.recorded: Outputs | None = None

    def reset(self) -> None:
        self._inline.reset()

    def step(self, observation: Array, goal: Array) -> PolicyOutcome:
        outcome = self._inline.step(observation, goal)
        recorded = self.recorded
        if recorded is None:
            return outcome
        if recorded.policy_fault is not None:
            return PolicyOutcome(None, recorded.policy_fault, recorded.policy_ns)
        return outcome._replace(duration_ns=recorded.policy_ns)

    def close(self) -> None:
        self._inline.close()


COMPARED = ("mode", "estop", "sent", "action", "clamps", "observed", "goal", "events")


@dataclass(frozen=True, slots=True)
class Gap:
    """Ticks that the daemon made and the log does not hold."""

    after: int | None  # the last tick before it; None: the log begins in the middle of a run
    tick: int  # the first one after it
    missing: int
    seconds: float  # from the last tick before it; 0 at the beginning of a log
    armed: bool  # the drive was on before or after it: what follows need not come out as it was


@dataclass(frozen=True, slots=True)
class Replayed:
    """How a replay went."""

    ticks: int  # that the log holds
    compared: int  # the others follow a gap too closely
    differences: list[Difference]
    gaps: list[Gap]


TOLD = 10  # of what is alike


def told(replayed: Replayed) -> Iterator[str]:
    """How a replay went, in sentences: the differences, what the log does not hold, and last what came of it."""
    differences = replayed.differences
    for one in differences[:TOLD]:
        yield f"tick {one.tick} {one.field}: was {one.recorded}, is {one.replayed}"
    yield from _gaps_told(replayed)
    if differences:
        yield f"{len(differences)} differences in {replayed.compared} ticks"
    else:
        yield f"{replayed.compared} ticks, every command the same"


def _gaps_told(replayed: Replayed) -> Iterator[str]:
    """What the log does not hold, and what could not be compared for it."""
    armed = [gap for gap in replayed.gaps if gap.armed]
    off = [gap for gap in replayed.gaps if not gap.armed]
    for gaps in (armed, off):
        if gaps and gaps[0].after is None:
            yield f"the log begins at tick {gaps.pop(0).tick} of its run: an earlier file holds what was before"
    if off:
        missing, seconds = sum(gap.missing for gap in off), sum(gap.seconds for gap in off)
        yield f"not in this log: {missing} ticks ({seconds:.0f} s) of an arm that was switched off and still"
    for gap in armed[:TOLD]:
        yield (
            f"tick {gap.tick}: the {gap.missing} before it are not in this log, and the drive was on: "
            "what follows may differ for that alone"
        )
    if unsure := replayed.ticks - replayed.compared:
        yield (
            f"run but not compared: {unsure} ticks after some that are missing: the first few, and of a goal that was "
            "flown there all"
        )


def replay(ticks: Iterable[tuple[Inputs, Outputs]], config: Config, load: Callable[[str], Policy]) -> Replayed:
    """Run a log through a new controller. `load` makes a policy by name."""
    runners: dict[str, _RecordedFaults] = {}

    def runner(name: str) -> _RecordedFaults:
        if name not in runners:
            runners[name] = _RecordedFaults(load(name))
        return runners[name]

    # A pair of readings that disagrees counts for so long, a frame that cannot be true, and one is differenced over.
    memory = max(DISAGREEING_TICKS, WINDOW, math.ceil(config.failsafe.mocap_stale_s * config.control.rate_hz) + 1)
    # What was sent may matter to the safety filter for so long.
    sent_s = KNOWN_S + config.drivers.rail.hold_s + config.limits.rail.latency_s
    sent_memory = memory + math.ceil(sent_s * config.control.rate_hz)
    controller: Controller | None = None
    before: Outputs | None = None
    differences: list[Difference] = []
    gaps: list[Gap] = []
    number = compared = unsure = 0
    unknown: int | None = None  # the goal that was flown at a gap: what its policy remembers of before is not known
    for inputs, recorded in ticks:
        flown = _flown(recorded)
        if (gap := _gap(before, recorded)) is not None:
            gaps.append(gap)
            unsure, unknown = sent_memory if gap.armed else memory, flown
        if controller is None:
            controller = Controller(config, runner(config.control.policy if gap is None else recorded.policy))
        changes: dict[int, PolicyRunner] = {
            r.number: runner(r.policy) for r in inputs.requests if r.kind == "policy" and r.policy is not None
        }
        for known in runners.values():
            known.recorded = recorded
        replayed = controller.tick(inputs, changes)
        number, before = number + 1, recorded
        if unsure or unknown is not None:
            unsure = max(unsure - 1, 0)
            unknown = unknown if flown == unknown else None
            controller.resume(recorded)
            continue
        compared += 1
        differences += [
            Difference(recorded.tick, name, was, now)
            for name in COMPARED
            if not _same(was := getattr(recorded, name), now := getattr(replayed, name))
        ]
    return Replayed(number, compared, differences, gaps)


def _flown(recorded: Outputs) -> int | None:
    """Number of the goal that a policy flew in a tick."""
    goal = recorded.goal
    return goal.number if goal.state == "running" and goal.goal is not None and goal.goal.kind != "hold" else None


def _gap(before: Outputs | None, recorded: Outputs) -> Gap | None:
    """What is missing before a tick; nothing before the daemon's first."""
    missing = recorded.tick - 1 - (0 if before is None else before.tick)
    if missing <= 0:  # a tick that failed is number -1
        return None
    seconds = 0.0 if before is None else (recorded.t_ns - before.t_ns) * 1e-9
    armed = recorded.sent.enable or (before is not None and before.sent.enable)
    return Gap(None if before is None else before.tick, recorded.tick, missing, seconds, armed)


def _same(one: object, other: object) -> bool:
    """Equal, with NaN equal to NaN (a hold has no target)."""
    return one == other or repr(one) == repr(other)
