"""Comparison of measured and configured limits, and a patch where the configuration is less strict than the robot.

The patch is a part of softarm.yaml that `softarm check` accepts. It never relaxes a limit.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from softarm.common.keys import find
from softarm.daemon.config.contradictions import arms_pull_m_s2
from softarm.daemon.limits.measured import COUNT_MIN, SURE, Bound, Measured, measure
from softarm.recordings.rail_motion import RailMotion
from softarm.schemas.config import Config

EXCITATION = "rail-dashes"  # the excitation that shows every limit
LATENCY_TOLERANCE_S = 0.005  # a smaller difference is accepted
TOLERANCE = 0.05  # the same for braking and surge, as a share
DRAG_TOLERANCE_M_S = 0.05  # the same: the margin covers it
SPEEDS_M_S = tuple(0.1 * tenth for tenth in range(11))  # initial speeds of a stop

_HEADER = """\
# Measured limits of the rail ({recordings}, {seconds:.0f} s); no limit is less strict than configured before.
# Part of softarm.yaml: replace the keys there, then run `softarm check softarm.yaml --logs FOLDER`.\
"""


@dataclass(frozen=True, slots=True)
class _Kind:
    """Wording of a limit and its safe side."""

    unit: str
    step: float  # advice is rounded to it, towards the safe side
    least: bool  # lower is safer
    events: str
    says: str  # statement about the bound


_UNTIMED = "Not measured: without the latency the time of a set-point's effect is unknown"
_KINDS = {
    "latency_s": _Kind("s", 0.001, False, "set-point steps", "act within {}"),
    "braking_m_s2": _Kind("m/s^2", 0.05, True, "brakings", "slow down by {} or more"),
    "surge_m_s2": _Kind("m/s^2", 0.1, False, "runs", "speed up by {} or less"),
    "drag_m_s": _Kind("m/s", 0.01, False, "seconds in motion", "show a drag of {} or less"),
}

_TOLERANCES = {"latency_s": LATENCY_TOLERANCE_S, "drag_m_s": DRAG_TOLERANCE_M_S}


@dataclass(frozen=True, slots=True)
class MeasuredLimit:
    """One limit of the rail: configured, measured and advised."""

    key: str  # in limits.rail
    configured: float
    bound: Bound | None  # None: too few events
    advised: float | None  # as configured if strict enough; None if the necessary value is not allowed
    why: str  # evidence in the recordings, or the lack of it

    @property
    def is_too_lax(self) -> bool:
        """Return whether the configured limit is less strict than the robot requires."""
        return self.advised != self.configured

    @property
    def measured(self) -> str:
        """Return the bound with its unit, or a dash."""
        return "-" if self.bound is None else f"{self.bound.value:.3g} {_KINDS[self.key].unit}"

    @property
    def advice(self) -> str:
        """Return the next step for a limit that is too lax."""
        if self.advised is None:
            return "no allowed value covers it: check the drive"
        return f"{'lower' if _KINDS[self.key].least else 'raise'} it to {self.advised:g}"

    def summary(self) -> dict[str, Any]:
        """Return the row as plain values."""
        bound = None if self.bound is None else self.bound._asdict()
        return {"configured": self.configured, "measured": bound, "advised": self.advised, "why": self.why}


@dataclass(frozen=True, slots=True)
class RailFindings:
    """Measured limits of the rail compared with a configuration."""

    config: Config
    measured: Measured
    rows: tuple[MeasuredLimit, ...]

    @property
    def pull_m_s2(self) -> float | None:
        """Return the largest acceleration by which the arm helps or hinders the drive, or None if unknown."""
        ramp, braking, surge = self.measured.ramp_m_s2, self.measured.braking, self.measured.surge
        return None if braking is None or surge is None else max(ramp - braking.value, surge.value - ramp)

    @property
    def patched(self) -> Config:
        """Return the configuration with the stricter limits; valid if the configuration was."""
        stricter = {row.key: row.advised for row in self.rows if row.is_too_lax and row.advised is not None}
        limits = self.config.limits
        rail = limits.rail.model_copy(update=stricter)
        return self.config.model_copy(update={"limits": limits.model_copy(update={"rail": rail})})

    def patch(self) -> str:
        """Return limits-patch.yaml: the four limits and the drive settings they were measured with."""
        count = self.measured.recordings
        recordings = f"{count} recording{'s' if count != 1 else ''}"
        lines = [_HEADER.format(recordings=recordings, seconds=self.measured.seconds), "limits:", "  rail:"]
        for row in self.rows:
            stays = "stays" if not row.is_too_lax else "was"
            lines.append(f"    # {row.key} {stays} {row.configured:g}. {row.why}.")
            lines.append(f"    {row.key}: {row.advised!r}" if row.advised is not None else f"    # {row.advice}.")
        if self.pull_m_s2 is not None:
            ramp = self.measured.ramp_m_s2
            lines.append(f"    # Ramp of the drive about {ramp:.2g} m/s^2, pull of the arm up to {self.pull_m_s2:.2g}.")
        limits, drive, usual = self.config.limits.rail, self.config.drivers.rail, Config()
        if limits.acceleration_max_m_s2 != usual.limits.rail.acceleration_max_m_s2:
            lines.append(f"    acceleration_max_m_s2: {limits.acceleration_max_m_s2!r}")
        if drive.acceleration_m_s2 != usual.drivers.rail.acceleration_m_s2:
            lines += ["drivers:", "  rail:"]
            lines += [f"    {key}: {getattr(drive, key)!r}" for key in ("acceleration_m_s2", "quick_stop_m_s2")]
        lines += [f"# Left out: {text}." for text in self.measured.left_out]
        return "\n".join(lines) + "\n"

    def summary(self) -> dict[str, Any]:
        """Return the findings as plain values by limit."""
        rows = {row.key: row.summary() for row in self.rows}
        pulled = {"ramp_m_s2": self.measured.ramp_m_s2, "pull_m_s2": self.pull_m_s2}
        return {"rail": rows, **pulled, "left_out": list(self.measured.left_out)}


def findings(motions: Iterable[RailMotion], config: Config | None = None) -> RailFindings:
    """Compare recordings with a configuration, by default the one of the last recording that has one."""
    motions = tuple(motions)
    if config is None:
        config = next((motion.config for motion in reversed(motions) if motion.config is not None), Config())
    measured = measure(motions, config.drivers.rail.acceleration_m_s2)
    return RailFindings(config, measured, compared(measured, config))


def compared(measured: Measured, config: Config) -> tuple[MeasuredLimit, ...]:
    """Return a row for each limit, in the order of the file."""
    latency = _row(config, "latency_s", measured.latency, measured.surely, measured.steps)
    braking = _row(config, "braking_m_s2", measured.braking, measured.braking, measured.brakings)
    surge = _row(config, "surge_m_s2", measured.surge, measured.surge, measured.runs)
    drag = _row(config, "drag_m_s", measured.drag, measured.drag, measured.moving)
    slows_by = braking.configured if braking.advised is None else braking.advised
    if drag.is_too_lax and _stops_anyway(config, measured, slows_by):
        why = f"{drag.why}; with braking_m_s2 {slows_by:g} the cart still stops in time"
        drag = replace(drag, advised=drag.configured, why=why)
    if measured.latency is None:
        braking, surge, drag = (replace(row, why=_UNTIMED) for row in (braking, surge, drag))
    # Lowered as well if `softarm check` would refuse it together with the new surge.
    ramp, counted_on = config.drivers.rail.acceleration_m_s2, surge.advised or surge.configured
    most = _rounded("braking_m_s2", ramp - arms_pull_m_s2(ramp, counted_on))
    if surge.is_too_lax and braking.advised is not None and braking.advised > most:
        why = f"{braking.why}; with surge_m_s2 {counted_on:g} at most {most:g} is consistent"
        braking = replace(braking, advised=most, why=why)
    return latency, braking, surge, drag


def _stops_anyway(config: Config, measured: Measured, counted_on_m_s2: float) -> bool:
    """Return whether a dragged cart stops from any speed with measured braking as soon as computed without drag.

    Half of the margin may be used as well.
    """
    if measured.drag is None or measured.braking is None or measured.braking.value <= 0.0:
        return False
    limits, drag_m_s = config.limits.rail, measured.drag.value
    return all(
        (speed + drag_m_s) ** 2 / (2.0 * measured.braking.value) + drag_m_s * limits.latency_s
        <= speed**2 / (2.0 * counted_on_m_s2) + limits.margin_m / 2
        for speed in SPEEDS_M_S
    )


def _row(config: Config, key: str, bound: Bound | None, surely: Bound | None, count: int) -> MeasuredLimit:
    """Compare one limit; `surely` is a bound that favours the configuration and decides alone."""
    configured, kind = float(getattr(config.limits.rail, key)), _KINDS[key]
    if bound is None or surely is None:
        why = (
            f"only {count} {kind.events} recorded, {COUNT_MIN} required: record more with `softarm excite {EXCITATION}`"
        )
        return MeasuredLimit(key, configured, None, configured, why)
    worst = kind.says.format(f"{bound.value:.3g} {kind.unit}")
    why = (
        f"{math.floor(100 * bound.share + 1e-9)}% of {kind.events} {worst}, {SURE:.0%} sure "
        f"({bound.events} in {bound.seconds:.0f} s, median {bound.median:.3g})"
    )
    tolerance = _TOLERANCES.get(key, TOLERANCE * configured)
    beyond = configured - surely.value if kind.least else surely.value - configured
    if beyond <= tolerance:
        return MeasuredLimit(key, configured, bound, configured, why)
    advised, allowed = _rounded(key, bound.value), find(Config, ("limits", "rail", key))
    assert allowed is not None
    assert allowed.quantity is not None
    return MeasuredLimit(key, configured, bound, advised if allowed.quantity.takes(advised) else None, why)


def _rounded(key: str, value: float) -> float:
    """Round towards the safe side."""
    kind = _KINDS[key]
    steps = value / kind.step
    return round((math.floor(steps + 1e-9) if kind.least else math.ceil(steps - 1e-9)) * kind.step, 6)
