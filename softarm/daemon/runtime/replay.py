"""Replay of a recorded log: the same tick must give the same commands, bit for bit, if the log holds every tick.

Where ticks are missing (most of a still, disarmed arm; or before the start of the log) the controller takes over the
recorded state. The comparison resumes after the few ticks that the controller remembers, or, if a goal was running,
after the end of that goal, since its policy remembers more.
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
    """A replayed value that differs from the recorded one."""

    tick: int
    field: str
    recorded: object
    replayed: object


class _RecordedFaults(InlineRunner):
    """Runner that computes the policy again and repeats the recorded faults, such as lateness."""

    recorded: Outputs  # of the present tick

    def step(self, observation: Array, goal: Array) -> PolicyOutcome:
        outcome = super().step(observation, goal)
        recorded = self.recorded
        if recorded.policy_fault is not None:
            return PolicyOutcome(None, recorded.policy_fault, recorded.policy_ns)
        return outcome._replace(duration_ns=recorded.policy_ns)


COMPARED = ("mode", "estop", "sent", "action", "clamps", "observed", "goal", "events")


@dataclass(frozen=True, slots=True)
class Gap:
    """Ticks of the daemon that are missing in the log."""

    after: int | None  # last tick before it; None at the start of a log
    tick: int  # first tick after it
    missing: int
    seconds: float  # since the last tick before it; 0 at the start of a log
    armed: bool  # the drive was on before or after it, so later ticks may differ


@dataclass(frozen=True, slots=True)
class Replayed:
    """Result of a replay."""

    ticks: int  # in the log
    compared: int  # the others follow a gap too closely
    differences: list[Difference]
    gaps: list[Gap]


SHOWN_MAX = 10  # differences or gaps listed one by one


def describe(replayed: Replayed) -> Iterator[str]:
    """Yield the result of a replay in sentences: differences, gaps, summary."""
    differences = replayed.differences
    for each in differences[:SHOWN_MAX]:
        yield f"tick {each.tick} {each.field}: recorded {each.recorded}, replayed {each.replayed}"
    yield from _describe_gaps(replayed)
    if differences:
        yield f"{len(differences)} differences in {replayed.compared} ticks"
    else:
        yield f"{replayed.compared} ticks, every command the same"


def _describe_gaps(replayed: Replayed) -> Iterator[str]:
    """Yield the gaps and the ticks that could not be compared because of them."""
    armed = [gap for gap in replayed.gaps if gap.armed]
    off = [gap for gap in replayed.gaps if not gap.armed]
    for gaps in (armed, off):
        if gaps and gaps[0].after is None:
            yield f"the log begins at tick {gaps.pop(0).tick} of its run: an earlier file holds the ticks before"
    if off:
        missing, seconds = sum(gap.missing for gap in off), sum(gap.seconds for gap in off)
        yield f"not in this log: {missing} ticks ({seconds:.0f} s) of a still, disarmed arm"
    for gap in armed[:SHOWN_MAX]:
        yield (
            f"tick {gap.tick}: {gap.missing} ticks before it are missing, and the drive was on: "
            "later ticks may differ for this reason alone"
        )
    if unsure := replayed.ticks - replayed.compared:
        yield (
            f"replayed but not compared: {unsure} ticks after missing ones (the first few, or all of a goal that was "
            "running)"
        )


def replay(ticks: Iterable[tuple[Inputs, Outputs]], config: Config, load: Callable[[str], Policy]) -> Replayed:
    """Run the ticks of a log through a new controller; `load` returns a policy by name."""
    runners: dict[str, _RecordedFaults] = {}

    def runner(name: str) -> _RecordedFaults:
        if name not in runners:
            runners[name] = _RecordedFaults(load(name))
        return runners[name]

    # Ticks that the observer and the checks remember.
    memory = max(DISAGREEING_TICKS, WINDOW, math.ceil(config.failsafe.mocap_stale_s * config.control.rate_hz) + 1)
    # Ticks for which the safety filter remembers sent commands.
    sent_s = KNOWN_S + config.drivers.rail.hold_s + config.limits.rail.latency_s
    sent_memory = memory + math.ceil(sent_s * config.control.rate_hz)
    controller: Controller | None = None
    before: Outputs | None = None
    differences: list[Difference] = []
    gaps: list[Gap] = []
    number = compared = unsure = 0
    unknown: int | None = None  # goal running at a gap, with a policy of unknown memory
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
    """Return the number of the goal that a policy was executing."""
    goal = recorded.goal
    return goal.number if goal.state == "running" and goal.goal is not None and goal.goal.kind != "hold" else None


def _gap(before: Outputs | None, recorded: Outputs) -> Gap | None:
    """Return the gap before a tick, or None."""
    missing = recorded.tick - 1 - (0 if before is None else before.tick)
    if missing <= 0:  # a failed tick has number -1
        return None
    seconds = 0.0 if before is None else (recorded.t_ns - before.t_ns) * 1e-9
    armed = recorded.sent.enable or (before is not None and before.sent.enable)
    return Gap(None if before is None else before.tick, recorded.tick, missing, seconds, armed)


def _same(one: object, other: object) -> bool:
    """Compare values; NaN equals NaN, since a hold has no target."""
    return one == other or repr(one) == repr(other)
