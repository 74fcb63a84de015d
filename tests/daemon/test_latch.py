"""Latch of the emergency stop under random requests and faults.

The law: it is freed by an acknowledgement in a tick in which no cause of a stop holds, and by nothing else.
"""

import itertools
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softarm.daemon.control.failsafe import ACKNOWLEDGE
from softarm.daemon.control.records import EStop, Mode, Outputs
from softarm.schemas.config import Config, Failsafe
from softarm.schemas.messages import SAFE
from tests.daemon.rig import Rig as RobotAtRest
from tests.daemon.rig import Steady

KINDS = ("stop", "acknowledge", "arm", "disarm")
ORDERS = [order for size in range(len(KINDS) + 1) for order in itertools.permutations(KINDS, size)]
# What may be wrong in a tick, with nothing wrong among it: a name, and the changed fields of a reading.
CAUSES = {
    "nothing": {},
    "rail_fault": {"rail": {"faults": ("E12 limit switch",)}},
    "remote_off": {"rail": {"remote": False}},
    "regulator_fault": {"pressure": {"faults": ("supply low",)}},
    "regulator_vented": {"pressure": {"armed": False}},
    "rail_disabled": {"rail": {"enabled": False}},
    "mocap_clock": {},  # the cameras' clock is ahead
}
STARTS = {
    Mode.DISARMED: (),
    Mode.ARMING: ("arm",),
    Mode.ARMED: ("arm", ""),
    Mode.STOPPING: ("arm", "", "disarm"),
    Mode.STOPPED: ("stop",),
}


class Rig(RobotAtRest):
    """Controller with devices that accept every command at once, and a cart that still rolls in a soft stop."""

    def __init__(self, mode: Mode = Mode.DISARMED, **first: str) -> None:
        super().__init__(Steady((0.0, 0.0)), Config(failsafe=Failsafe(arming_frames=1)), frames=1)
        self.tick(**first)
        for request in STARTS[mode]:
            self.tick(*filter(None, [request]))
        assert first or self.outputs.mode is mode

    def tick(self, *kinds: str, cause: str = "nothing", **first: str) -> Outputs:
        self.before = self.outputs
        self.ahead_ns = 50_000_000 if cause == "mocap_clock" else 0
        wrong = {"rail": {}} | CAUSES[cause]
        wrong["rail"] = {"velocity_m_s": 0.5 if self.on else 0.0} | wrong["rail"]
        return super().tick(*kinds, **wrong, **first)

    def obeys(self, kinds: Sequence[str]) -> None:
        """Assert the latch's rules over the last tick."""
        was = self.before is not None and self.before.estop is not EStop.CLEAR
        made = self.outputs
        causes = [event.name for event in made.events if event.response == "stop"]
        results = dict(zip(kinds, made.results[len(made.results) - len(kinds) :], strict=True))
        accepted = {kind: result.accepted for kind, result in results.items()}
        latched = made.estop is not EStop.CLEAR
        assert ("stop_requested" in causes) == ("stop" in kinds)
        assert latched == (made.mode is Mode.STOPPED)
        assert made.sent == SAFE or not latched
        if "stop" in kinds:
            assert latched
            assert not accepted.get("arm", False)
        if was:
            freed = "acknowledge" in kinds and not causes
            assert latched is not freed
            assert accepted.get("acknowledge", freed) is freed
            if "acknowledge" in kinds and causes:
                assert "the cause is still active" in results["acknowledge"].reasons[0]
        if latched:
            assert made.estop is (EStop.ENGAGED if causes else EStop.LATCHED)
            assert made.last_stop
            assert made.arming_refusals


@pytest.mark.parametrize("cause", CAUSES)
@pytest.mark.parametrize("mode", STARTS)
def test_no_order_of_requests_in_a_tick_clears_a_latch_with_a_cause(mode: Mode, cause: str) -> None:
    for order in ORDERS:
        rig = Rig(mode)
        rig.tick(*order, cause=cause)
        rig.obeys(order)


ticks = st.lists(st.tuples(st.sampled_from(ORDERS), st.sampled_from(list(CAUSES))), min_size=1, max_size=12)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(ticks)
def test_only_an_acknowledgement_without_a_cause_clears_a_latch(story) -> None:
    rig = Rig()
    for kinds, cause in story:
        rig.tick(*kinds, cause=cause)
        rig.obeys(kinds)


def test_a_latch_of_an_earlier_run_holds_from_the_first_tick_with_its_reason() -> None:
    rig = Rig(latched="the drive reports a fault (E12)")
    assert (rig.outputs.mode, rig.outputs.estop, rig.outputs.sent) == (Mode.STOPPED, EStop.LATCHED, SAFE)
    assert (rig.outputs.last_stop, rig.outputs.last_stop_ns) == ("the drive reports a fault (E12)", None)
    rig.tick("arm")
    reason = f"the emergency stop is latched: make sure that the arm is free, {ACKNOWLEDGE}"
    assert rig.outputs.results[-1].reasons == (reason,)
    rig.tick("acknowledge", cause="rail_fault")
    assert rig.outputs.estop is EStop.ENGAGED
    rig.tick("acknowledge", "arm")
    assert (rig.outputs.mode, rig.outputs.estop) == (Mode.ARMING, EStop.CLEAR)


def test_arming_is_refused_while_stops_cannot_be_saved() -> None:
    rig = Rig()
    rig.tick("arm", latch_problem="stop.json: cannot be written (Input/output error)")
    assert rig.outputs.mode is Mode.DISARMED
    assert "would be lost if the daemon restarted (stop.json: cannot" in rig.outputs.results[-1].reasons[0]
