"""Middle of the rail on the axis, and scale and sign of the axis, from a push of the cart from end to end.

The ends of travel give the middle; motion capture, if it tracked the push, gives scale and sign. Pure.
"""

import statistics
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from softarm.schemas.config import DryveRail
from softarm.schemas.robot import RAIL_TRAVEL_M

TRAVEL_M = 2 * RAIL_TRAVEL_M
# Allowed difference between the measured travel and the rail's.
ENDS_M = 0.01
# A shorter movement is not a push.
MOVED_M = 0.05
# Tracked travel and samples that a slope needs.
TRACKED_MIN_M, SAMPLES_MIN = 0.2, 10
# If the slope differs from 1 by more, units_per_m is wrong.
SLOPE_TOLERANCE = 0.01
# Allowed distance of a sample from the fitted line.
DEVIATION_MAX_M = 0.01
# Allowed difference between the middle of the ends and motion capture's zero.
ZEROS_M = 0.005


class Sample(NamedTuple):
    """Position of the cart at one moment.

    `axis_m` is the distance from the drive's zero in its counting direction, by `drivers.rail.units_per_m`. `mocap_m`
    is the position by motion capture, or None without tracking.
    """

    axis_m: float
    mocap_m: float | None = None


class Line(NamedTuple):
    """Line of motion capture over axis positions.

    The slope is negative if the axis counts against y. `zero_m` is motion capture's zero on the axis, `deviation_m` the
    largest distance of a sample from the line.
    """

    slope: float
    zero_m: float
    deviation_m: float


class Centre(NamedTuple):
    """Result of a push: findings and problems as sentences, and values of `drivers.rail` that need a change.

    With any problem there are no values.
    """

    found: tuple[str, ...]
    problems: tuple[str, ...]
    values: dict[str, float | bool]


def centre(samples: Sequence[Sample], rail: DryveRail) -> Centre:
    """Return the middle of the rail from the samples of a push, taken under the configuration `rail`."""
    axis = [each.axis_m for each in samples]
    low_m, high_m = (min(axis), max(axis)) if axis else (0.0, 0.0)
    if high_m - low_m < MOVED_M:
        moved = f"the axis counted only {1e3 * (high_m - low_m):.0f} mm: push the cart slowly from end to end"
        return Centre((), (f"{moved}; if you did, check the plug of the encoder",), {})
    line = _line(samples)
    scale = 1.0 if line is None else _scale(abs(line.slope))
    travel_m = (high_m - low_m) * scale
    ends = abs(travel_m - TRAVEL_M) <= ENDS_M
    found = (
        f"travel {travel_m:.3f} m, from {low_m * scale:.4f} to {high_m * scale:.4f} m on the axis",
        *_describe(line),
    )
    problems = tuple(_problems(line, travel_m, ends, low_m * scale, high_m * scale, rail))
    if problems:
        return Centre(found, problems, {})
    middle_m = 0.5 * (low_m + high_m) * scale
    if not ends:
        assert line is not None
        middle_m = line.zero_m * scale
        found = (*found, "the cart did not reach both ends, so the middle is motion capture's zero")
    values: dict[str, float | bool] = {"centre_m": round(middle_m, 4)}
    if scale != 1.0:
        values["units_per_m"] = float(round(rail.units_per_m / scale))
    if line is not None and (line.slope < 0) != rail.reversed:
        values["reversed"] = line.slope < 0
    return Centre(found, (), {key: value for key, value in values.items() if getattr(rail, key) != value})


def _line(samples: Sequence[Sample]) -> Line | None:
    """Fit motion capture over axis positions; None if too little was tracked."""
    tracked = [(each.axis_m, each.mocap_m) for each in samples if each.mocap_m is not None]
    axis, mocap = [one for one, _ in tracked], [other for _, other in tracked]
    if len(tracked) < SAMPLES_MIN or max(axis) - min(axis) < MOVED_M or max(mocap) - min(mocap) < TRACKED_MIN_M:
        return None
    slope, intercept = statistics.linear_regression(axis, mocap)
    if slope == 0.0:
        return None
    deviation_m = max(abs(slope * one + intercept - other) for one, other in tracked)
    return Line(slope, -intercept / slope, deviation_m)


def _scale(slope: float) -> float:
    """Return the correction factor of the axis; 1 if the slope is within the cameras' scale error."""
    return 1.0 if abs(slope - 1.0) <= SLOPE_TOLERANCE else slope


def _describe(line: Line | None) -> Iterator[str]:
    if line is None:
        yield "motion capture did not track the push: scale and direction of the axis are not checked"
        return
    way = "with" if line.slope > 0 else "AGAINST"
    yield f"the axis counts {way} motion capture, {abs(line.slope):.4f} m by motion capture for each metre by the axis"


def _problems(
    line: Line | None, travel_m: float, ends: bool, low_m: float, high_m: float, rail: DryveRail
) -> Iterator[str]:
    if line is not None and line.deviation_m > DEVIATION_MAX_M:
        yield (
            f"axis and motion capture differ by {1e3 * line.deviation_m:.0f} mm, "
            f"at most {1e3 * DEVIATION_MAX_M:.0f} mm allowed: push slowly; if you did, the belt slips, "
            "or the frame's y axis is not parallel to the rail"
        )
    elif not ends and travel_m > TRAVEL_M:
        yield _units_or_travel(travel_m, rail, "the axis counted more than the length of the rail")
    elif not ends and line is None:
        yield _units_or_travel(travel_m, rail, "push the cart until it stops, at both ends")
    elif ends and line is not None:
        off_m = 0.5 * (low_m + high_m) - line.zero_m * _scale(abs(line.slope))
        if abs(off_m) > ZEROS_M:
            yield (
                f"motion capture's zero is {1e3 * abs(off_m):.0f} mm away from the middle of the travel: move "
                "the frame's zero there (docs/reference/wires.md), then push again; limits.rail counts from the middle"
            )


def _units_or_travel(travel_m: float, rail: DryveRail, first: str) -> str:
    units = rail.units_per_m * travel_m / TRAVEL_M
    return (
        f"the travel is {travel_m:.3f} m by the axis and {TRAVEL_M:g} m by the rail: {first}; if both ends were "
        f"reached, drivers.rail.units_per_m is {units:.0f}, not {rail.units_per_m:g}"
    )
