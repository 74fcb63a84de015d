"""Middle of the rail from a push from end to end, on axes with right, wrong and reversed counts."""

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
    zero_m: float = 0.3,
    counts: float = 1.0,
    sense: int = 1,
    reach_m: float = 0.3,
    tracked: bool = True,
    frame_m: float = 0.0,
    deviation_m: float = 0.0,
) -> Centre:
    """Return the result of a push from the middle to one end and to the other.

    `zero_m` is the middle on the true axis, `counts` the factor of a wrong feed.
    """
    samples = []
    for step in range(81):
        y_m = -reach_m * math.cos(math.pi * step / 80)
        mocap_m = y_m + frame_m + deviation_m * math.sin(step) if tracked else None
        samples.append(Sample((sense * y_m + zero_m) * counts, mocap_m))
    return centre(samples, rail)


def test_on_a_right_axis_only_the_centre_changes() -> None:
    result = pushed(zero_m=0.287)
    assert result.values == {"centre_m": 0.287}
    assert result.found[0] == "travel 0.600 m, from -0.0130 to 0.5870 m on the axis"
    assert result.found[1].startswith("the axis counts with motion capture, 1.0000 m")
    assert pushed(tracked=False, zero_m=0.287).values == {"centre_m": 0.287}


def test_values_of_the_configuration_are_not_proposed_again() -> None:
    assert pushed() == pushed()._replace(values={}, problems=())


def test_a_reversed_axis_is_detected() -> None:
    result = pushed(sense=-1, zero_m=0.287)
    assert result.values == {"centre_m": 0.287, "reversed": True}
    assert "counts AGAINST motion capture" in result.found[1]
    corrected = DryveRail.model_validate(RAIL.model_dump() | result.values)
    assert pushed(corrected, sense=-1, zero_m=0.287).values == {}
    assert pushed(corrected, zero_m=0.287).values == {"reversed": False}


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ({"reach_m": 0.02}, "the axis counted only 40 mm: push the cart slowly from end to end"),
        ({"reach_m": 0.2, "tracked": False}, "0.400 m by the axis and 0.6 m by the rail: push the cart until it stops"),
        (
            {"counts": 1.5, "tracked": False},
            "more than the length of the rail; if both ends were reached, drivers.rail.",
        ),
        ({"counts": 1.5, "tracked": False}, "units_per_m is 150000, not 100000"),
        ({"frame_m": 0.02}, "motion capture's zero is 20 mm away from the middle of the travel"),
        ({"deviation_m": 0.03}, "mm, at most 10 mm allowed: push slowly"),
    ],
)
def test_a_problem_is_reported_and_no_value_is_proposed(how: dict[str, Any], says: str) -> None:
    result = pushed(**how)
    assert says in " ".join(result.problems)
    assert result.values == {}


def test_without_both_ends_motion_capture_gives_the_middle() -> None:
    result = pushed(reach_m=0.2, zero_m=0.287)
    assert result.values == {"centre_m": 0.287}
    assert "did not reach both ends" in result.found[-1]


def test_no_samples_are_a_problem() -> None:
    assert centre([], RAIL).problems


@given(st.floats(-1, 1), st.floats(0.5, 2), st.sampled_from([-1, 1]), st.floats(-0.003, 0.003))
def test_with_the_proposed_values_axis_and_motion_capture_agree(
    zero_m: float, counts: float, sense: int, frame_m: float
) -> None:
    result = pushed(zero_m=zero_m, counts=counts, sense=sense, frame_m=frame_m)
    rail = RAIL.model_copy(update=result.values)
    for y_m in (-0.3, 0.1, 0.25):
        axis_m = (sense * y_m + zero_m) * counts * RAIL.units_per_m / rail.units_per_m
        read_m = (-1 if rail.reversed else 1) * (axis_m - rail.centre_m)
        assert read_m == pytest.approx(y_m, abs=0.01 * abs(zero_m) + 0.004 + 0.01)
