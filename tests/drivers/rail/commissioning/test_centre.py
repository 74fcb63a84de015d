"""The middle of the rail from a push from end to end, on axes that count rightly, wrongly, backwards and not at all."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.drivers.rail.commissioning.centre import Centre, Sample, centre
from softarm.schemas.config import DryveRail

RAIL = DryveRail()


def pushed(
    rail: DryveRail = RAIL,
    zero_m: float = 0.3,  # of the true axis, from its zero to the rail's middle
    counts: float = 1.0,  # by a wrong feed
    sense: int = 1,
    reach_m: float = 0.3,
    seen: bool = True,
    frame_m: float = 0.0,
    stray_m: float = 0.0,
) -> Centre:
    """From the middle to one end and to the other."""
    samples = []
    for step in range(81):
        y_m = -reach_m * math.cos(math.pi * step / 80)
        mocap_m = y_m + frame_m + stray_m * math.sin(step) if seen else None
        samples.append(Sample((sense * y_m + zero_m) * counts, mocap_m))
    return centre(samples, rail)


def test_a_right_axis_has_its_middle_found_and_nothing_else_changed() -> None:
    told = pushed(zero_m=0.287)
    assert told.values == {"centre_m": 0.287}
    assert told.found[0] == "travel 0.600 m, from -0.0130 to 0.5870 m on the axis"
    assert told.found[1] == "the axis counts with motion capture, 1.0000 m seen for a metre counted"
    assert pushed(seen=False, zero_m=0.287).values == {"centre_m": 0.287}


def test_what_the_configuration_says_already_is_not_proposed() -> None:
    assert pushed() == pushed()._replace(values={}, wrong=())
    assert pushed().proposes


@pytest.mark.parametrize("counts", [0.5, 0.97, 1.03, 10.0])
def test_a_wrong_feed_shows_as_a_slope_and_is_mended_with_the_centre(counts: float) -> None:
    told = pushed(counts=counts, zero_m=0.287)
    assert told.values["units_per_m"] == round(100_000 * counts)
    assert told.values["centre_m"] == pytest.approx(0.287, abs=1e-3)
    right = DryveRail.model_validate(RAIL.model_dump() | told.values)
    again = pushed(right, counts=counts * 100_000 / right.units_per_m, zero_m=0.287)
    assert again.proposes
    assert not again.values


def test_a_mirrored_axis_is_said_to_be_reversed() -> None:
    told = pushed(sense=-1, zero_m=0.287)
    assert told.values == {"centre_m": 0.287, "reversed": True}
    assert "counts AGAINST motion capture" in told.found[1]
    mended = DryveRail.model_validate(RAIL.model_dump() | told.values)
    assert pushed(mended, sense=-1, zero_m=0.287).values == {}
    assert pushed(mended, zero_m=0.287).values == {"reversed": False}


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ({"reach_m": 0.02}, "moved 40 mm by the axis: push it slowly from end to end"),
        ({"reach_m": 0.2, "seen": False}, "0.400 m by the axis and 0.6 m by the rail: push the cart until it stops"),
        ({"counts": 1.5, "seen": False}, "farther than the rail is long; if both ends were reached, drivers.rail."),
        ({"counts": 1.5, "seen": False}, "units_per_m is 150000, not 100000"),
        ({"frame_m": 0.02}, "motion capture's zero lies 20 mm beside the middle of the travel"),
        ({"stray_m": 0.03}, "mm from one line: push slowly"),
    ],
)
def test_what_does_not_fit_is_said_and_nothing_is_proposed(how: dict[str, Any], says: str) -> None:
    told = pushed(**how)
    assert not told.proposes
    assert says in " ".join(told.wrong)
    assert told.values == {}


def test_without_both_ends_motion_capture_tells_the_middle() -> None:
    told = pushed(reach_m=0.2, zero_m=0.287)
    assert told.values == {"centre_m": 0.287}
    assert "the ends were not both reached" in told.found[-1]


def test_nothing_at_all_is_no_push() -> None:
    assert not centre([], RAIL).proposes


@given(st.floats(-1, 1), st.floats(0.5, 2), st.sampled_from([-1, 1]), st.floats(-0.003, 0.003))
def test_with_what_is_proposed_the_axis_reads_what_motion_capture_sees(
    zero_m: float, counts: float, sense: int, frame_m: float
) -> None:
    told = pushed(zero_m=zero_m, counts=counts, sense=sense, frame_m=frame_m)
    rail = RAIL.model_copy(update=told.values)
    for y_m in (-0.3, 0.1, 0.25):
        axis_m = (sense * y_m + zero_m) * counts * RAIL.units_per_m / rail.units_per_m
        read_m = (-1 if rail.reversed else 1) * (axis_m - rail.centre_m)
        assert read_m == pytest.approx(y_m, abs=0.01 * abs(zero_m) + 0.004 + 0.01)
