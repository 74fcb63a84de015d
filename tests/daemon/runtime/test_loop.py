"""Control loop: accurate ticks, robust against errors, safe devices at the end."""

import gc
import itertools
import threading
import time
import weakref

import pytest

from softarm.daemon.control.inbox import Inbox
from softarm.daemon.control.records import EStop, Mode
from softarm.daemon.runtime import loop as control_loop
from softarm.daemon.runtime.devices import Devices
from softarm.daemon.runtime.loop import PERIOD_NS, ControlLoop, Rehearsal
from softarm.daemon.tick import Controller
from softarm.drivers.bodies.in_process import InProcessRobot
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.policies.hold import Hold
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.policies.runner import InlineRunner
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import SAFE
from tests.daemon.rig import BUSY_MACHINE, Rig, Steady

WAIT_S = 20.0


class Watched:
    """Device of the simulated robot that records writes and stops."""

    def __init__(self, device, stop_error=None):
        self._device = device
        self._stop_error = stop_error
        self.written = []
        self.stopped = False

    def __getattr__(self, name):
        return getattr(self._device, name)

    def write(self, *values):
        self.written.append(values)
        self._device.write(*values)

    async def stop(self):
        self.stopped = True
        if self._stop_error:
            raise self._stop_error


class Loop:
    """Control loop on a simulated robot and its recorder, with a method that waits for ticks."""

    problem: str | None = None  # of the recorder
    dropped = 0

    def __init__(self, controller=None, rehearsal=None, **stop_errors):
        robot = InProcessRobot(SimulatedBody(), time.monotonic_ns())
        parts = {name: Watched(getattr(robot, name), stop_errors.get(name)) for name in ("mocap", "regulator", "rail")}
        self.devices = Devices(**parts)
        self.inbox = Inbox()
        self.good_ticks = 0
        self.ticks = []
        self.before_tick = {}
        self._ticked = threading.Condition()
        self.loop = ControlLoop(
            controller or Controller(Config(), InlineRunner(Hold())),
            self.devices,
            self.inbox,
            self,
            self,
            rehearsal=rehearsal,
        )

    def good_tick(self, _now_ns):
        self.good_ticks += 1

    def tick(self, inputs, outputs, timing):
        with self._ticked:
            self.ticks.append(outputs)
            self._ticked.notify_all()
        if len(self.ticks) in self.before_tick:
            self.before_tick[len(self.ticks)]()

    def until(self, condition):
        with self._ticked:
            assert self._ticked.wait_for(lambda: self.ticks and condition(self.ticks[-1]), WAIT_S)
        return self.ticks[-1]

    def __enter__(self):
        self.loop.start()
        return self

    def __exit__(self, *_):
        self.loop.stop()


@pytest.mark.slow
def test_the_loop_arms_on_request_and_writes_every_tick():
    with Loop(Controller(Config(failsafe=BUSY_MACHINE), InlineRunner(Hold()))) as loop:
        loop.until(lambda outputs: not outputs.arming_refusals)
        number = loop.inbox.post("arm")
        loop.until(lambda _: any(outputs.mode is Mode.ARMED for outputs in loop.ticks))
        outputs = next(outputs for outputs in loop.ticks if any(r.number == number for r in outputs.results))
        assert [r.accepted for r in outputs.results if r.number == number] == [True]
        assert loop.loop.snapshot.tick >= outputs.tick
    assert loop.devices.rail.written[0] == (False, 0.0)
    assert (True, 0.0) in loop.devices.rail.written
    assert abs(len(loop.devices.rail.written) - len(loop.ticks)) <= 1


class Rehearsed(list):
    """Rehearsal that stores what it is asked to repeat."""

    def tick(self, inputs, outputs, runners):
        self.append((inputs, outputs))


def test_a_tick_is_rehearsed_before_the_next_one():
    rehearsed = Rehearsed()
    with Loop(rehearsal=rehearsed) as loop:
        loop.until(lambda outputs: len(rehearsed) >= 3)
    assert all(inputs.t_ns == outputs.t_ns for inputs, outputs in rehearsed)
    ticks = [outputs.tick for _, outputs in rehearsed]
    assert ticks == sorted(set(ticks))


class Cycle:
    def __init__(self):
        self.own = self


def test_old_garbage_is_collected_too(monkeypatch):
    """A client's connection is a reference cycle that lives for seconds; without collection it leaks."""
    monkeypatch.setattr(control_loop, "COLLECT_ALL_EVERY", 5)
    with Loop() as loop:
        first = loop.until(lambda outputs: outputs.tick >= 1).tick
        cycle = Cycle()
        alive = weakref.ref(cycle)
        loop.until(lambda outputs: outputs.tick >= first + 4)
        del cycle
        loop.until(lambda outputs: alive() is None)


@pytest.mark.slow
def test_while_the_recorder_cannot_write_arming_is_refused():
    made = Loop()
    made.problem = "the log ends here: the disk is full"
    with made as loop:
        outputs = loop.until(lambda outputs: len(outputs.arming_refusals) == 1)
        assert "the disk is full" in outputs.arming_refusals[0]
        loop.problem = None
        loop.until(lambda outputs: not outputs.arming_refusals)


def test_a_late_tick_skips_whole_periods_and_stays_on_its_grid():
    loop = Loop()
    loop.before_tick[5] = lambda: time.sleep(0.08)  # a delay of the loop
    with loop:
        loop.until(lambda outputs: outputs.missed_total >= 1 and outputs.tick >= 10)
    deadlines = [outputs.t_ns - outputs.late_ns for outputs in loop.ticks]
    for earlier, later in itertools.pairwise(deadlines):
        periods = (later - earlier) / PERIOD_NS
        assert periods == pytest.approx(round(periods), abs=0.05 * round(periods))
    assert [outputs.tick for outputs in loop.ticks] == list(range(1, len(loop.ticks) + 1))
    assert loop.good_ticks < len(loop.ticks)  # the watchdog did not hear of the late one


class Failing:
    """Controller whose tick raises an error."""

    def __init__(self):
        self.calls = 0

    def tick(self, inputs, runners):
        self.calls += 1
        raise ZeroDivisionError("a bug")


def test_a_failed_tick_brakes_and_vents_and_the_loop_continues(caplog):
    controller = Failing()
    with Loop(controller) as loop:
        loop.until(lambda _: len(loop.ticks) >= 5)
    outputs = loop.loop.snapshot
    assert controller.calls == 1  # its state is not to be trusted any more
    assert (outputs.mode, outputs.estop, outputs.sent) == (Mode.STOPPED, EStop.ENGAGED, SAFE)
    assert "ZeroDivisionError: a bug" in outputs.arming_refusals[0]
    assert outputs.last_stop_ns == loop.ticks[0].t_ns < outputs.t_ns
    assert set(loop.devices.rail.written) == {(False, 0.0)}
    assert loop.good_ticks == 0  # so that the service is restarted
    assert "the control loop failed" in caplog.text


def test_stopping_tries_every_device_even_if_others_fail_and_ends_the_thread(caplog):
    with Loop(rail=OSError("no route"), regulator=RuntimeError("stuck")) as loop:
        loop.until(lambda _: True)
    assert loop.devices.rail.stopped
    assert loop.devices.regulator.stopped
    assert loop.devices.mocap.stopped
    assert "no route" in caplog.text
    assert not loop.loop._thread.is_alive()
    assert gc.isenabled()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_device_that_cannot_start_leaves_the_others_stopped(monkeypatch):
    def fail():
        raise OSError("no more processes")

    loop = Loop()
    monkeypatch.setattr(loop.devices.rail, "start", fail, raising=False)
    with loop:
        pass
    assert loop.devices.mocap.stopped
    assert loop.devices.regulator.stopped
    assert gc.isenabled()


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


class Observed(Rehearsal):
    """Rehearsal that records its outputs."""

    def __init__(self, policy):
        super().__init__(Config(), policy)
        self.made, repeat = [], self._controller.tick

        def tick(*args):
            self.made.append(repeat(*args))
            return self.made[-1]

        self._controller.tick = tick


def facts(outputs):
    return [(o.mode, o.estop, o.sent, o.action, o.policy, o.goal, o.events, o.observed) for o in outputs]


def test_a_flight_is_the_same_with_and_without_rehearsals():
    rehearsals = []

    def observed(policy):
        rehearsals.append(Observed(policy))
        return rehearsals[0]

    alone, beside = fly(lambda policy: Rehearsed()), fly(observed)
    assert sum(o.action is not None for o in alone) > 5
    assert {o.policy for o in alone if o.action is not None} == {"reach", "reach-robust"}
    assert alone[-1].results[-1].accepted  # of the acknowledgement
    assert facts(alone) == facts(beside)
    assert facts(rehearsals[0].made) == facts(alone)  # all of a tick is rehearsed, its network included


def test_every_rehearsal_reads_the_network_of_the_policy_in_use_once(monkeypatch):
    read, replica = [], OnnxPolicy.replica

    def counted(policy):
        other = replica(policy)
        step = other.step
        other.step = lambda *values: read.append(other.spec.name) or step(*values)
        return other

    monkeypatch.setattr(OnnxPolicy, "replica", counted)
    outputs = fly(lambda policy: Rehearsal(Config(), policy))
    change = next(tick for tick, kind in SCRIPT.items() if kind == "policy")
    assert read == ["reach"] * change + ["reach-robust"] * (len(outputs) - change)


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


def test_the_loop_works_with_a_thousand_open_descriptors(many_descriptors):
    with many_descriptors(), Loop() as loop:
        loop.until(lambda outputs: outputs.tick >= 3)
