"""Replay of logs: the same commands, bit for bit, and gaps reported."""

import dataclasses
from contextlib import contextmanager
from itertools import pairwise

import pytest

from softarm.daemon.control.plausibility import WINDOW
from softarm.daemon.control.records import Problems
from softarm.daemon.logbook import logs
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.runtime.offline import Lockstep
from softarm.daemon.runtime.replay import replay
from softarm.policies import registry
from softarm.policies.runner import InlineRunner
from softarm.recordings.mcap_file import LogError
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from tests.processes import until


@contextmanager
def recording(directory, policy="reach", problem=None, **settings):
    """Yield a daemon on a simulated robot and its recorder; the long text of a problem fills a file sooner."""
    config, loaded = Config(recorder={"directory": directory, **settings}), registry.load(policy)
    recorder = Recorder(config, loaded.spec)
    recorder.start()

    def record(inputs, *made):
        recorder.tick(dataclasses.replace(inputs, problems=Problems(rail=problem)), *made)

    yield Lockstep(config, loaded, record=record), recorder
    recorder.stop()


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Record two goals, a new one in mid-swing, an emergency stop and its acknowledgement."""
    with recording(tmp_path_factory.mktemp("log")) as (daemon, recorder):
        daemon.arm()
        for goal in (Goal("reach", -0.3, 0.6), Goal("reach", -0.1, 0.65)):
            daemon.tick(daemon.request("goal", goal))
            for _ in range(20):
                daemon.tick()
        for kind in ("stop", "acknowledge", "arm"):
            daemon.tick(daemon.request(kind))
            daemon.tick()
    return logs.read(recorder.path)


def moving(ticks):
    """Return the index of the first tick with a moving cart."""
    return next(i for i, (_, outputs) in enumerate(ticks) if outputs.sent.cart_velocity_m_s)


def test_a_changed_command_is_found(log):
    """The comparison can fail: one recorded command is off by one part in ten million."""
    ticks = list(log.ticks())
    whole = replay(ticks, log.config, registry.load)
    assert (whole.differences, whole.gaps, whole.compared) == ([], [], len(ticks))
    inputs, outputs = ticks[moving(ticks)]
    sent = outputs.sent._replace(cart_velocity_m_s=outputs.sent.cart_velocity_m_s * (1 + 1e-7))
    ticks[moving(ticks)] = (inputs, dataclasses.replace(outputs, sent=sent))
    assert [d.field for d in replay(ticks, log.config, registry.load).differences] == ["sent"]


@pytest.fixture(scope="module")
def thinned(tmp_path_factory):
    """Record two flights with long rests around them, a change of policy and a latched stop."""
    with recording(tmp_path_factory.mktemp("thinned"), around_s=1.0) as (daemon, recorder):
        tick, runners = daemon.controller.tick, {}
        daemon.controller.tick = lambda inputs: tick(inputs, runners)

        def wait(seconds: int) -> None:
            for _ in range(30 * seconds):
                daemon.tick()

        def fly(*target: float) -> None:
            daemon.arm()
            daemon.tick(daemon.request("goal", Goal("reach", *target)))
            wait(2)

        wait(8)
        fly(-0.3, 0.6)
        daemon.tick(daemon.request("disarm"))
        wait(8)
        change = dataclasses.replace(daemon.request("policy"), policy="pid")
        runners[change.number] = InlineRunner(registry.load("pid"))
        daemon.tick(change)
        wait(8)
        fly(-0.1, 0.65)
        daemon.tick(daemon.request("stop"))
        wait(8)
        daemon.tick(daemon.request("acknowledge"))
    return logs.read(recorder.path)


def test_a_log_with_gaps_replays_the_same_outside_the_gaps(thinned):
    replayed = replay(thinned.ticks(), thinned.config, registry.load)
    assert replayed.differences == []
    assert not any(gap.armed for gap in replayed.gaps)
    outputs = [made for _, made in thinned.ticks()]
    missing = sum(gap.missing for gap in replayed.gaps)
    assert missing + replayed.ticks == outputs[-1].tick
    assert missing > 400
    assert replayed.compared > 250
    armed = [tick.tick for tick in outputs if tick.mode in ("arming", "armed", "stopping")]
    assert {tick.policy for tick in outputs if tick.mode == "armed"} == {"reach", "pid"}
    assert len(armed) == sum(b - a == 1 for a, b in pairwise(armed)) + 2  # two flights, both whole


def test_a_changed_command_is_found_after_a_gap_too(thinned):
    ticks = list(thinned.ticks())
    last = max(i for i, (_, outputs) in enumerate(ticks) if outputs.sent.cart_velocity_m_s)
    inputs, outputs = ticks[last]
    ticks[last] = (inputs, dataclasses.replace(outputs, sent=outputs.sent._replace(pressure_kpa=19.0)))
    assert [d.field for d in replay(ticks, thinned.config, registry.load).differences] == ["sent"]


def test_a_log_from_the_middle_of_a_run_resumes_its_state(thinned):
    """The file after a full one starts with the goal, the policy and the last stop of its run."""
    ticks = list(thinned.ticks())
    start = next(i for i, (_, outputs) in enumerate(ticks) if outputs.policy == "pid") + 1
    assert not ticks[start][0].requests  # the policy is not named again
    replayed = replay(ticks[start:], thinned.config, registry.load)
    assert replayed.differences == []
    assert (replayed.gaps[0].after, replayed.gaps[0].tick) == (None, ticks[start][1].tick)
    assert replayed.compared > 100


@pytest.fixture(scope="module")
def parted(tmp_path_factory):
    """Record a flight of many goals long enough for several files; return them in order."""
    directory = tmp_path_factory.mktemp("parted")
    with recording(directory, problem="refused " * 1000, file_max_mb=1) as (daemon, recorder):
        daemon.arm()
        for y_m in (-0.3, -0.1, -0.25, -0.05) * 2:
            outputs = daemon.tick(daemon.request("goal", Goal("reach", y_m, 0.62)))
            while outputs.goal.state == "running":
                outputs = daemon.tick()
            daemon.tick()
        until(lambda: not recorder._queue, "the queue")
    return logs.parts(sorted(directory.glob("*.mcap"), key=lambda path: int(logs.read(path).metadata["run"]["part"])))


@pytest.mark.slow
def test_a_split_flight_replays_the_same_joined_and_in_parts(parted):
    assert len(parted) >= 3
    whole = replay([tick for part in parted for tick in part.ticks()], parted[0].config, registry.load)
    assert (whole.differences, whole.gaps, whole.compared) == ([], [], whole.ticks)
    for part in parted[1:]:
        alone = replay(part.ticks(), part.config, registry.load)
        assert alone.differences == []
        assert [(gap.after, gap.armed) for gap in alone.gaps] == [(None, True)]
        assert 0 < alone.ticks - alone.compared < 60  # about two seconds


@pytest.mark.slow
def test_parts_out_of_order_or_of_different_runs_are_refused(parted, log):
    one, two, *_ = (part.path for part in parted)
    for wrong in ((two, one), (one, one), (one, log.path)):
        with pytest.raises(LogError, match=r"does not follow .* in one run"):
            logs.parts(wrong)


def test_a_goal_interrupted_by_a_gap_is_not_compared(log):
    """The policy's state at the gap is not in the log."""
    ticks = list(log.ticks())
    later = ticks[moving(ticks) + 5 :]
    replayed = replay(later, log.config, registry.load)
    assert replayed.differences == []
    flown = sum(outputs.goal.state == "running" for _, outputs in later)
    assert replayed.ticks - replayed.compared >= flown


def test_ticks_lost_while_armed_are_reported(log):
    """Ticks lost from a full queue are unknown, unlike omitted ticks of an arm at rest."""
    ticks = list(log.ticks())
    first = moving(ticks)
    del ticks[first : first + 3]
    (gap,) = replay(ticks, log.config, registry.load).gaps
    assert (gap.missing, gap.armed) == (3, True)


def test_state_from_before_a_gap_is_not_a_difference(tmp_path):
    """Disagreement in every other tick is no event, although the remaining ticks alone would be one."""
    with recording(tmp_path, "hold", idle_interval_s=0) as (daemon, recorder):
        read = daemon.robot.rail.read
        apart = [0.0]
        daemon.robot.rail.read = lambda: dataclasses.replace(read(), position_m=read().position_m + apart[0])
        for number in range(240):
            apart[0] = 0.04 if number % 10 == 0 or number >= 190 else 0.0
            daemon.tick()
    ticks = [t for i, t in enumerate(logs.read(recorder.path).ticks()) if (i % 10 == 0 and i > 30) or i >= 190]
    assert "rail_disagrees" in [event.name for event in ticks[-1][1].events]
    replayed = replay(ticks, daemon.config, lambda _: registry.load("hold"))
    assert replayed.differences == []
    assert replayed.compared == 50 - WINDOW
