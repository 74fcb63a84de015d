"""A rehearsal follows the controller, one tick behind, and changes nothing in it."""

import pytest

from softarm.daemon.control.records import Mode
from softarm.daemon.runtime.rehearsal import Rehearsal
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.policies.runner import InlineRunner
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from tests.daemon.rig import Rig, Steady

SCRIPT = {30: "arm", 33: "goal", 36: "cancel_goal", 37: "policy", 38: "goal", 42: "stop", 45: "acknowledge"}


def fly(rehearse):
    """Return the outputs of a flight with two goals, another policy and a stop; rehearse each tick with `rehearse`."""
    rig = Rig(OnnxPolicy("reach"))
    rehearsal = rehearse(rig.controller._policy)
    outputs = []
    for tick in range(50):
        kinds = [SCRIPT[tick]] if tick in SCRIPT else []
        inputs = rig.inputs(*kinds, goal=Goal("reach", -0.2, 0.6))
        runners = {rig.number: InlineRunner(OnnxPolicy("reach-robust"))} if kinds == ["policy"] else {}
        made = rig.controller.tick(inputs, runners)
        rig.on = made.sent.enable
        outputs.append(made)
        rehearsal.tick(inputs, made, runners)
    return outputs


class Absent:
    def tick(self, *_):
        pass


class Observed(Rehearsal):
    """Rehearsal that records its outputs."""

    def __init__(self, policy):
        super().__init__(Config(), policy)
        self.made, repeat = [], self._controller.tick
        self._controller.tick = lambda *args: self.made.append(repeat(*args))


def facts(outputs):
    return [(o.mode, o.estop, o.sent, o.action, o.policy, o.goal, o.events, o.observed) for o in outputs]


def test_a_flight_is_the_same_with_and_without_rehearsals():
    rehearsals = []

    def observed(policy):
        rehearsals.append(Observed(policy))
        return rehearsals[0]

    alone, beside = fly(lambda policy: Absent()), fly(observed)
    assert sum(o.action is not None for o in alone) > 5
    assert {o.policy for o in alone if o.action is not None} == {"reach", "reach-robust"}
    assert alone[-1].results[-1].accepted  # of the acknowledgement
    assert facts(alone) == facts(beside)
    assert facts(rehearsals[0].made) == facts(alone)  # all of a tick is rehearsed, its network included


def test_missed_rehearsals_are_made_up_for():
    rig = Rig().armed()
    rehearsal = Observed(InlineRunner(Steady()))
    made = [rig.tick() for _ in range(3)][-1]  # the ticks that armed were not rehearsed
    rehearsal.tick(rig.inputs(), made, {})
    rehearsal.tick(rig.inputs(), made, {})
    assert rehearsal.made[-1].mode is Mode.ARMED


@pytest.mark.parametrize("broken", ["tick", "resume"])
def test_a_failed_rehearsal_ends_rehearsals_and_nothing_else(broken, caplog):
    rig = Rig()
    rehearsal, calls = Rehearsal(Config(), InlineRunner(Steady())), []

    def fail(*_):
        calls.append(1)
        raise RuntimeError("a defect")

    setattr(rehearsal._controller, broken, fail)
    for _ in range(3):
        inputs = rig.inputs()
        rehearsal.tick(inputs, rig.controller.tick(inputs), {})
    assert len(calls) == 1
    assert "a rehearsal of the control tick failed" in caplog.text
