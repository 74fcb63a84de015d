"""Where on the axis the middle of the rail is, and whether the axis counts as it should: by the ends of travel that a
person pushed the cart to, and by motion capture where it saw that. Pure.
"""

import statistics
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from softarm.schemas.config import DryveRail
from softarm.schemas.robot import RAIL_TRAVEL_M

TRAVEL_M = 2 * RAIL_TRAVEL_M
ENDS_M = 0.01  # the travel that was found may differ from the rail's by so much
MOVED_M = 0.05  # less is no push
TELLING_M = 0.2  # of travel that motion capture saw, for its slope to be told
SAMPLES = 10
SLOPE = 0.01  # off 1 by more, as a share, units_per_m is wrong
STRAY_M = 0.01  # of axis and motion capture from one line
ZEROS_M = 0.005  # the middle by the ends, and by motion capture


class Sample(NamedTuple):
    """The cart at one moment."""

    axis_m: float  # from the drive's zero, the way that it counts, by `drivers.rail.units_per_m`
    mocap_m: float | None = None  # the same as motion capture shows it; None: it was not seen


class Line(NamedTuple):
    """Motion capture over the axis."""

    slope: float  # metres seen for a metre counted; negative: the axis counts against y
    zero_m: float  # where on the axis motion capture's zero is
    stray_m: float  # the farthest sample from it


class Centre(NamedTuple):
    """What a push over the rail tells."""

    found: tuple[str, ...]  # sentences
    wrong: tuple[str, ...]  # what has to be seen to; with any of these nothing is proposed
    values: dict[str, float | bool]  # for `drivers.rail`, by its keys: what differs from the configuration

    @property
    def proposes(self) -> bool:
        """Is there a centre to be written?"""
        return not self.wrong


def centre(samples: Sequence[Sample], rail: DryveRail) -> Centre:
    """Judge a push by the configuration under which its samples were taken."""
    axis = [each.axis_m for each in samples]
    low_m, high_m = (min(axis), max(axis)) if axis else (0.0, 0.0)
    if high_m - low_m < MOVED_M:
        moved = f"the cart was moved {1e3 * (high_m - low_m):.0f} mm by the axis: push it slowly from end to end"
        return Centre((), (f"{moved}; if you did, the axis does not count: is its encoder connected?",), {})
    line = _line(samples)
    scale = 1.0 if line is None else _scale(abs(line.slope))
    travel_m = (high_m - low_m) * scale
    ends = abs(travel_m - TRAVEL_M) <= ENDS_M
    found = (f"travel {travel_m:.3f} m, from {low_m * scale:.4f} to {high_m * scale:.4f} m on the axis", *_told(line))
    wrong = tuple(_wrong(line, travel_m, ends, low_m * scale, high_m * scale, rail))
    if wrong:
        return Centre(found, wrong, {})
    middle_m = 0.5 * (low_m + high_m) * scale
    if not ends:
        assert line is not None
        middle_m = line.zero_m * scale
        found = (*found, "the middle is motion capture's zero: the ends were not both reached")
    values: dict[str, float | bool] = {"centre_m": round(middle_m, 4)}
    if scale != 1.0:
        values["units_per_m"] = float(round(rail.units_per_m / scale))
    if line is not None and (line.slope < 0) != rail.reversed:
        values["reversed"] = line.slope < 0
    return Centre(found, (), {key: value for key, value in values.items() if getattr(rail, key) != value})


def _line(samples: Sequence[Sample]) -> Line | None:
    """None where motion capture saw too little."""
    seen = [(each.axis_m, each.mocap_m) for each in samples if each.mocap_m is not None]
    axis, mocap = [one for one, _ in seen], [other for _, other in seen]
    if len(seen) < SAMPLES or max(axis) - min(axis) < MOVED_M or max(mocap) - min(mocap) < TELLING_M:
        return None
    slope, intercept = statistics.linear_regression(axis, mocap)
    if slope == 0.0:
        return None
    stray_m = max(abs(slope * one + intercept - other) for one, other in seen)
    return Line(slope, -intercept / slope, stray_m)


def _scale(slope: float) -> float:
    """By what the axis's metres are to be multiplied; a slope that is 1 but for the cameras' scale is 1."""
    return 1.0 if abs(slope - 1.0) <= SLOPE else slope


def _told(line: Line | None) -> Iterator[str]:
    if line is None:
        yield "motion capture did not see it: whether the axis counts metres, and which way, is not told"
        return
    way = "with" if line.slope > 0 else "AGAINST"
    yield f"the axis counts {way} motion capture, {abs(line.slope):.4f} m seen for a metre counted"


def _wrong(
    line: Line | None, travel_m: float, ends: bool, low_m: float, high_m: float, rail: DryveRail
) -> Iterator[str]:
    if line is not None and line.stray_m > STRAY_M:
        yield (
            f"axis and motion capture stray by {1e3 * line.stray_m:.0f} mm from one line: push slowly; if you did, the "
            "belt slips, or the frame's y axis does not lie along the rail"
        )
    elif not ends and travel_m > TRAVEL_M:
        yield _units_or_travel(travel_m, rail, "the axis went farther than the rail is long")
    elif not ends and line is None:
        yield _units_or_travel(travel_m, rail, "push the cart until it stops, at both ends")
    elif ends and line is not None:
        off_m = 0.5 * (low_m + high_m) - line.zero_m * _scale(abs(line.slope))
        if abs(off_m) > ZEROS_M:
            yield (
                f"motion capture's zero lies {1e3 * abs(off_m):.0f} mm beside the middle of the travel: move its "
                "frame's zero there (docs/wires.md), then push again; limits.rail counts from the middle"
            )


def _units_or_travel(travel_m: float, rail: DryveRail, first: str) -> str:
    units = rail.units_per_m * travel_m / TRAVEL_M
    return (
        f"the travel is {travel_m:.3f} m by the axis and {TRAVEL_M:g} m by the rail: {first}; if both ends were "
        f"reached, drivers.rail.units_per_m is {units:.0f}, not {rail.units_per_m:g}"
    )
