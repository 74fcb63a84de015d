"""Measured limits beside configured ones: where the configuration is milder than the robot was, and the patch for it.

A patch is a piece of softarm.yaml that `softarm check` takes as it is. It never makes a limit milder.
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

EXCITATION = "rail-dashes"  # of all there are, the one that shows every limit
LATENCY_TOLERANCE_S = 0.005  # a configuration that is milder by less is not blamed
TOLERANCE = 0.05  # likewise, as a share, of braking and surge
DRAG_TOLERANCE_M_S = 0.05  # likewise: the margin covers it
SPEEDS_M_S = tuple(0.1 * tenth for tenth in range(11))  # that a cart is stopped from

_HEADER = """\
# The rail's limits as the robot showed them ({recordings}, {seconds:.0f} s); none is milder than it was configured.
# A piece of softarm.yaml: put its keys in place of those there, then ask `softarm check softarm.yaml --logs FOLDER`.\
"""


@dataclass(frozen=True, slots=True)
class _Kind:
    """What is said of a limit, and which way is safe."""

    unit: str
    step: float  # advice is rounded to it, towards the safe side
    least: bool  # the safe side is below
    events: str
    says: str  # of the bound, its unit behind


_UNTIMED = "Not looked at: without the latency nobody can tell when the cart was told to"
_KINDS = {
    "latency_s": _Kind("s", 0.001, False, "set-point steps", "act within {}"),
    "braking_m_s2": _Kind("m/s^2", 0.05, True, "brakings", "slow down by {} or more"),
    "surge_m_s2": _Kind("m/s^2", 0.1, False, "runs", "speed up by {} or less"),
    "drag_m_s": _Kind("m/s", 0.01, False, "seconds in motion", "saw the cart dragged along by {} or less"),
}

_TOLERANCES = {"latency_s": LATENCY_TOLERANCE_S, "drag_m_s": DRAG_TOLERANCE_M_S}


@dataclass(frozen=True, slots=True)
class LimitRow:
    """One of the rail's limits: as it is configured, as it was measured, as it should be."""

    key: str  # in limits.rail
    configured: float
    bound: Bound | None  # None: too few events
    advised: float | None  # as configured where that is no milder than the robot was; None: what fits is not allowed
    why: str  # what the recordings show, or what they lack

    @property
    def milder(self) -> bool:
        """Whether the configuration is milder than the robot was."""
        return self.advised != self.configured

    @property
    def measured(self) -> str:
        """The bound with its unit; a dash without one."""
        return "-" if self.bound is None else f"{self.bound.value:.3g} {_KINDS[self.key].unit}"

    @property
    def advice(self) -> str:
        """The next step where it is milder."""
        if self.advised is None:
            return "no allowed value covers it: see to the drive"
        return f"{'lower' if _KINDS[self.key].least else 'raise'} it to {self.advised:g}"

    def summary(self) -> dict[str, Any]:
        """Plain values."""
        bound = None if self.bound is None else self.bound._asdict()
        return {"configured": self.configured, "measured": bound, "advised": self.advised, "why": self.why}


@dataclass(frozen=True, slots=True)
class RailFindings:
    """What recordings show of the rail, held against a configuration."""

    config: Config
    measured: Measured
    rows: tuple[LimitRow, ...]

    @property
    def pull_m_s2(self) -> float | None:
        """By how much the arm helps or hinders the drive at worst; None where too little is known."""
        ramp, braking, surge = self.measured.ramp_m_s2, self.measured.braking, self.measured.surge
        return None if braking is None or surge is None else max(ramp - braking.value, surge.value - ramp)

    @property
    def patched(self) -> Config:
        """The configuration with all that becomes stricter; sound where the configuration was."""
        stricter = {row.key: row.advised for row in self.rows if row.milder and row.advised is not None}
        limits = self.config.limits
        rail = limits.rail.model_copy(update=stricter)
        return self.config.model_copy(update={"limits": limits.model_copy(update={"rail": rail})})

    def patch(self) -> str:
        """limits-patch.yaml: the four limits, and what of the drive they were measured with."""
        count = self.measured.recordings
        said = f"{count} recording{'s' if count != 1 else ''}"
        lines = [_HEADER.format(recordings=said, seconds=self.measured.seconds), "limits:", "  rail:"]
        for row in self.rows:
            stays = "stays" if not row.milder else "was"
            lines.append(f"    # {row.key} {stays} {row.configured:g}. {row.why}.")
            lines.append(f"    {row.key}: {row.advised!r}" if row.advised is not None else f"    # {row.advice}.")
        if self.pull_m_s2 is not None:
            ramp = self.measured.ramp_m_s2
            lines.append(
                f"    # The drive ramps by about {ramp:.2g} m/s^2, the arm pulls by up to {self.pull_m_s2:.2g}."
            )
        limits, drive, usual = self.config.limits.rail, self.config.drivers.rail, Config()
        if limits.acceleration_max_m_s2 != usual.limits.rail.acceleration_max_m_s2:
            lines.append(f"    acceleration_max_m_s2: {limits.acceleration_max_m_s2!r}")
        if drive.acceleration_m_s2 != usual.drivers.rail.acceleration_m_s2:
            lines += ["drivers:", "  rail:"]
            lines += [f"    {key}: {getattr(drive, key)!r}" for key in ("acceleration_m_s2", "quick_stop_m_s2")]
        lines += [f"# Left out: {text}." for text in self.measured.left_out]
        return "\n".join(lines) + "\n"

    def summary(self) -> dict[str, Any]:
        """Plain values, limit by limit."""
        rows = {row.key: row.summary() for row in self.rows}
        pulled = {"ramp_m_s2": self.measured.ramp_m_s2, "pull_m_s2": self.pull_m_s2}
        return {"rail": rows, **pulled, "left_out": list(self.measured.left_out)}


def findings(motions: Iterable[RailMotion], config: Config | None = None) -> RailFindings:
    """Hold recordings against a configuration; without one, against the last that they say they were made under."""
    motions = tuple(motions)
    if config is None:
        config = next((motion.config for motion in reversed(motions) if motion.config is not None), Config())
    measured = measure(motions, config.drivers.rail.acceleration_m_s2)
    return RailFindings(config, measured, compared(measured, config))


def compared(measured: Measured, config: Config) -> tuple[LimitRow, ...]:
    """A row a limit, in the order of the file."""
    latency = _row(config, "latency_s", measured.latency, measured.surely, measured.steps)
    braking = _row(config, "braking_m_s2", measured.braking, measured.braking, measured.brakings)
    surge = _row(config, "surge_m_s2", measured.surge, measured.surge, measured.runs)
    drag = _row(config, "drag_m_s", measured.drag, measured.drag, measured.moving)
    slows_by = braking.configured if braking.advised is None else braking.advised
    if drag.milder and _stops_anyway(config, measured, slows_by):
        why = f"{drag.why}; with braking_m_s2 {slows_by:g} the cart stops in time all the same"
        drag = replace(drag, advised=drag.configured, why=why)
    if measured.latency is None:
        braking, surge, drag = (replace(row, why=_UNTIMED) for row in (braking, surge, drag))
    # What `softarm check` would refuse beside the new surge is lowered with it.
    ramp, counted_on = config.drivers.rail.acceleration_m_s2, surge.advised or surge.configured
    most = _rounded("braking_m_s2", ramp - arms_pull_m_s2(ramp, counted_on))
    if surge.milder and braking.advised is not None and braking.advised > most:
        why = f"{braking.why}; with surge_m_s2 {counted_on:g} no more than {most:g} agrees"
        braking = replace(braking, advised=most, why=why)
    return latency, braking, surge, drag


def _stops_anyway(config: Config, measured: Measured, counted_on_m_s2: float) -> bool:
    """Whether a cart that is dragged along stops, with the robot's own braking, where it does on paper without drag.

    Or half of the margin behind: from any speed.
    """
    if measured.drag is None or measured.braking is None or measured.braking.value <= 0.0:
        return False
    limits, drag_m_s = config.limits.rail, measured.drag.value
    return all(
        (speed + drag_m_s) ** 2 / (2.0 * measured.braking.value) + drag_m_s * limits.latency_s
        <= speed**2 / (2.0 * counted_on_m_s2) + limits.margin_m / 2
        for speed in SPEEDS_M_S
    )


def _row(config: Config, key: str, bound: Bound | None, surely: Bound | None, count: int) -> LimitRow:
    """surely: a bound that errs towards a robot that keeps the limit; only by it is a configuration blamed."""
    configured, kind = float(getattr(config.limits.rail, key)), _KINDS[key]
    if bound is None or surely is None:
        why = f"only {count} {kind.events} were seen, it takes {COUNT_MIN}: fly `softarm excite {EXCITATION}` for more"
        return LimitRow(key, configured, None, configured, why)
    worst = kind.says.format(f"{bound.value:.3g} {kind.unit}")
    why = (
        f"{math.floor(100 * bound.share + 1e-9)}% of {kind.events} {worst}, {SURE:.0%} sure "
        f"({bound.events} seen in {bound.seconds:.0f} s, median {bound.median:.3g})"
    )
    tolerance = _TOLERANCES.get(key, TOLERANCE * configured)
    beyond = configured - surely.value if kind.least else surely.value - configured
    if beyond <= tolerance:
        return LimitRow(key, configured, bound, configured, why)
    advised, allowed = _rounded(key, bound.value), find(Config, ("limits", "rail", key))
    assert allowed is not None
    assert allowed.quantity is not None
    return LimitRow(key, configured, bound, advised if allowed.quantity.takes(advised) else None, why)


def _rounded(key: str, value: float) -> float:
    """Towards the safe side."""
    kind = _KINDS[key]
    steps = value / kind.step
    return round((math.floor(steps + 1e-9) if kind.least else math.ceil(steps - 1e-9)) * kind.step, 6)
