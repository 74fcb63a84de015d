"""Checks of stamps and units before a fit; every warning contains its remedy."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from softarm.common.quantity import UNITS
from softarm.diagnosis.data.trials import Array, Series, TrialError
from softarm.schemas.robot import PRESSURE_MAX_KPA, PRESSURE_MIN_KPA

# A gap is longer than this many usual steps and this time.
GAP_FACTOR, GAP_MIN_S = 5.0, 0.05
# Error of a quaternion's length up to which the four columns are one.
LENGTH_ERROR = 0.05
# A longer step is a jump of the clock, not a pause.
SPLIT_S = 60.0
# Ratios of two columns that should agree, within 15 %, and the unit that each suggests.
_PRESSURE_RATIOS = tuple((1 / UNITS["kPa"][unit], unit) for unit in ("psi", "bar", "Pa"))
_LENGTH_RATIOS = tuple((1 / UNITS["m"][unit], unit) for unit in ("millimetres", "centimetres", "inches"))
LINK_LENGTH_M = 0.0885
_DEGREES = 1 / UNITS["rad"]["degrees"]
_ANGLE_RATIOS = (
    (_DEGREES, "degrees"),
    (-1.0, "radians of the opposite sign"),
    (-_DEGREES, "negative degrees"),
)


def tidy_stamps(series: Series, where: str, *, gaps: bool = True) -> tuple[Series, tuple[str, ...]]:
    """Sort rows by their stamps and remove repeated stamps, keeping the first row of each.

    Returns the series with strictly increasing stamps, and warnings about changed order, repeated stamps, gaps and
    jumps. `gaps` is False for rows that are written on change.
    """
    t, warnings = series.t_s, []
    steps = np.diff(t)
    if (backwards := np.flatnonzero(steps < 0)).size:
        row = int(backwards[0]) + 1
        warnings.append(
            f"{where}: time runs backwards at {len(backwards)} rows, first at row {row + 1} "
            f"({t[row - 1]:.6f} s, then {t[row]:.6f} s); rows were sorted by their stamps: "
            "if the clock was set there, split the recording in two"
        )
    order = np.argsort(t, kind="stable")
    keep = order[np.concatenate(([True], np.diff(t[order]) > 0))]
    if len(keep) < len(t):
        warnings.append(
            f"{where}: {len(t) - len(keep)} rows repeat a stamp and were left out; "
            "write every row once, with its own stamp"
        )
    if len(keep) < len(t) or backwards.size:
        series = Series(t[keep], {name: values[keep] for name, values in series.columns.items()})
    return series, (*warnings, *(_gaps(series.t_s, where) if gaps else ()))


def unit_quaternions(series: Series, columns: Sequence[str], where: str) -> Array:
    """Return the quaternions of four columns, [T, 4]; raise TrialError if their length is not one."""
    found = np.stack([series[name] for name in columns], axis=1)
    lengths = np.linalg.norm(found, axis=1)
    row = int(np.abs(lengths - 1).argmax())
    if (worst := float(np.abs(lengths[row] - 1))) > LENGTH_ERROR:
        raise TrialError(
            f"{where}: {', '.join(columns)} have a length of {lengths[row]:.3g} at {series.t_s[row]:.3f} s "
            f"(error {worst:.2g}; allowed: {LENGTH_ERROR}); name the four parts of a unit quaternion, or mark "
            "rows without one by `missing`"
        )
    return found


def _gaps(t: Array, where: str) -> Iterator[str]:
    steps = np.diff(t)
    if not len(steps):
        return
    usual = float(np.median(steps))
    if usual > 10.0:
        yield f"{where}: rows are {usual:.3g} s apart; stamps are seconds: divide ms by 1e3, ns by 1e9"
        return
    long = np.flatnonzero(steps > max(GAP_FACTOR * usual, GAP_MIN_S))
    jumps = long[steps[long] > SPLIT_S]
    if len(jumps):
        at = t[jumps[0]]
        yield f"{where}: the clock jumps by {steps[jumps[0]]:.0f} s at {at:.3f} s; split the recording there"
    elif len(long):
        worst = long[np.argmax(steps[long])]
        yield (
            f"{where}: {len(long)} gaps, {steps[long].sum():.2f} s in all, the longest {steps[worst]:.3f} s at "
            f"{t[worst]:.3f} s (usual step {usual * 1e3:.1f} ms); data in gaps are not compared: "
            "record again if they are long"
        )


def unit_warnings(channels: Mapping[str, Series], where: str) -> tuple[str, ...]:
    """Return warnings about units of a robot's recording that look wrong, from ranges and columns that must agree."""
    return (
        *_pressure_units(channels, where),
        *_length_units(channels, where),
        *_angle_units(channels, where),
    )


def _pressure_units(channels: Mapping[str, Series], where: str) -> Iterator[str]:
    tops = {}
    for name in ("command", "pressure"):
        if name not in channels:
            continue
        tops[name] = top = float(np.nanmax(np.abs(channels[name]["pressure"]), initial=0.0))
        column = f"{where}/{name}: column pressure"
        if top > 40.0:
            unit = "Pa" if top > 4000 else "mbar or hPa"
            allowed = f"{PRESSURE_MIN_KPA:g} .. {PRESSURE_MAX_KPA:g} kPa"
            yield f"{column} goes up to {top:.4g}; the range is {allowed}: is it in {unit}? convert to kPa"
        elif tops.get("command", top) <= 0.02:
            continue  # the muscle was at rest, so its sensor shows only noise
        elif 0.02 < top <= 0.3:
            yield f"{column} stays below {top:.3g}; is it in bar? multiply by 100 to get kPa (20 kPa is 0.2 bar)"
        elif 0.3 < top <= 3.1:
            yield f"{column} stays below {top:.3g}; is it in psi? multiply by 6.895 to get kPa (20 kPa is 2.9 psi)"
    if len(tops) == 2 and min(tops.values()) > 0:
        for name, other in (("pressure", "command"), ("command", "pressure")):
            if likely := _named(tops[name] / tops[other], _PRESSURE_RATIOS):
                yield (
                    f"{where}: the largest pressure is {tops[name]:.3g} in {name} and {tops[other]:.3g} in {other}; "
                    f"one of them looks like {likely}: convert both to kPa"
                )


def _length_units(channels: Mapping[str, Series], where: str) -> Iterator[str]:
    if (mocap := channels.get("mocap")) is not None and "link1_y" in mocap.columns:
        length = _median(np.hypot(mocap["link1_y"] - mocap["cart_y"], mocap["link1_z"] - mocap["cart_z"]))
        if unit := _named(length / LINK_LENGTH_M, _LENGTH_RATIOS):
            yield (
                f"{where}/mocap: cart and link1 are {length:.3g} apart where the link is {LINK_LENGTH_M} m long; "
                f"positions look like {unit}: convert them to metres"
            )
        elif abs(length / LINK_LENGTH_M - 1) > 0.1:
            yield (
                f"{where}/mocap: cart and link1 are {length:.4f} m apart, the link is {LINK_LENGTH_M} m long; check "
                "where the rigid bodies' pivots are (cart: at the first hinge; linkN: at the far end of link N)"
            )
    if (rail := channels.get("rail")) is None or len(rail) < 3:
        return
    if (far := float(np.nanmax(np.abs(rail["position"])))) > 0.4:
        unit = "millimetres" if far > 4 else "metres from the axis's end instead of the middle"
        yield f"{where}/rail: position goes to {far:.4g}; the travel is +-0.30 m: is it in {unit}? convert it"
    speed = np.gradient(rail["position"], rail.t_s)
    ratio = _ratio(rail["velocity"], speed) if np.std(speed) > 0.005 else 1.0
    if unit := _named(ratio, _LENGTH_RATIOS) or _named(1 / ratio if ratio else 0.0, _LENGTH_RATIOS):
        yield f"{where}/rail: velocity is {ratio:.3g} times the slope of position; is one in {unit}? use m, m/s"


def _angle_units(channels: Mapping[str, Series], where: str) -> Iterator[str]:
    mocap = channels.get("mocap")
    if mocap is None:
        return
    bodies = ["cart"]
    while f"link{len(bodies)}_y" in mocap.columns:
        bodies.append(f"link{len(bodies)}")
    for before, body in pairwise(bodies):
        true = np.arctan2(mocap[f"{body}_y"] - mocap[f"{before}_y"], mocap[f"{before}_z"] - mocap[f"{body}_z"])
        if np.nanstd(true) < 0.02:  # what stands still says nothing of its unit
            continue
        if unit := _named(_ratio(mocap[f"{body}_angle"], true), _ANGLE_RATIOS):
            yield (
                f"{where}/mocap: {body}_angle does not agree with the positions; it looks like {unit}: "
                "convert to radians, absolute, 0 hanging straight down, positive towards +y"
            )


def _ratio(values: Array, reference: Array) -> float:
    """Slope of values over a reference, both about their means."""
    good = np.isfinite(values) & np.isfinite(reference)
    x, y = reference[good] - reference[good].mean(), values[good] - values[good].mean()
    return float(x @ y / (x @ x)) if len(x) and x @ x > 0 else 1.0


def _median(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(np.median(good)) if len(good) else float("nan")


def _named(ratio: float, table: tuple[tuple[float, str], ...]) -> str | None:
    return next((name for value, name in table if abs(ratio / value - 1) < 0.15), None)
