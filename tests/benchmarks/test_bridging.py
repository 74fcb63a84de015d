"""The benchmark of bridged drop-outs flies what it says: cameras that blink, and an estimate better than none."""

from itertools import pairwise

import pytest

from softarm.benchmarks import bridging
from softarm.policies import registry
from softarm.schemas.flights import TEST_TARGETS


def flown(dark_s):
    daemon, kept = bridging.begun(registry.load("reach"), bridging.SIMULATOR, 0.1, seed=3, dark_s=dark_s)
    daemon.pursue(TEST_TARGETS[-1])
    return [frame.t_capture_ns for tick in kept.ticks for frame in tick.mocap]


def gaps_ms(stamps_ns):
    """But for the second in which the robot is put where it starts."""
    gaps = [round((after - before) * 1e-6, 1) for before, after in pairwise(stamps_ns)]
    return [gap for gap in gaps if gap < 900]


def test_cameras_that_do_not_blink_show_120_frames_a_second():
    assert set(gaps_ms(flown(0.0))) == {8.3}


def test_cameras_that_blink_leave_out_what_falls_into_the_dark():
    gaps = gaps_ms(flown(0.1))
    dark = [gap for gap in gaps if gap > 9]
    assert len(dark) >= 2
    assert all(100 <= gap <= 117 for gap in dark)


@pytest.mark.slow
def test_the_model_is_off_by_a_tenth_of_what_holding_on_is():
    off = bridging.errors(bridging.SIMULATOR)
    for hold_m, model_m in zip(off["hold"], off["model"], strict=True):
        assert model_m < 0.1 * hold_m
    assert off["model"][-1] < 0.015  # after 167 ms


@pytest.mark.slow
def test_no_robot_is_more_unlike_the_model_than_it_says():
    """What a policy is told of the tip's deviation, beside what it is on a robot with a payload that nobody told of."""
    off = bridging.errors("payload")["model"]
    for tick, rms_m in enumerate(off, 1):
        assert rms_m < 1.2 * bridging.TipModel().deviation_m(tick * bridging.CONTROL_PERIOD_S)
