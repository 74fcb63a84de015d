"""Events of the failsafe table raised by the devices' readings. Pure."""

import math
from collections.abc import Iterator

from softarm.daemon.control.failsafe import Event
from softarm.daemon.control.observer import Observer
from softarm.daemon.control.records import Inputs
from softarm.schemas.config import Config
from softarm.schemas.messages import BODY_NAMES, RailReading
from softarm.schemas.robot import RAIL_EXCURSION_M

LATE_S = 0.03  # a control step
DISAGREEING_TICKS = 5  # a single pair of readings may straddle a reversal
OUTSIDE_M = 0.02  # past the rail limit: the safety filter acts up to here, the failsafe beyond


def device_events(inputs: Inputs, observer: Observer, config: Config, engaged: bool) -> Iterator[Event]:
    """Yield the events of all devices. `engaged`: the actuators should be on."""
    yield from _mocap(inputs, observer, config)
    yield from _pressure(inputs, config, engaged)
    yield from _rail(inputs, config, engaged)
    yield from _rail_against_mocap(observer, config, engaged)


def _rail_against_mocap(observer: Observer, config: Config, engaged: bool) -> Iterator[Event]:
    """Compare axis and motion capture. While nothing moves, one tick is enough: the axis may have lost its zero."""
    apart_m, most_m = observer.apart_m or 0.0, config.failsafe.rail_mocap_disagreement_m
    late_s = observer.mocap_late_ns() * 1e-9
    if late_s > config.failsafe.mocap_late_max_s:
        yield Event("mocap_too_late", f"{late_s * 1e3:.0f} ms, allowed {config.failsafe.mocap_late_max_s * 1e3:.0f} ms")
    elif late_s > LATE_S:
        yield Event("mocap_late", f"{late_s * 1e3:.0f} ms")
    if observer.alignment.mirrored:
        yield Event("mocap_mirrored", "the cart moves opposite to the axis")
    elif observer.rail is not None and _is_unreferenced(observer.rail, engaged):
        pass
    elif observer.disagreeing_ticks >= DISAGREEING_TICKS or (not engaged and apart_m > most_m):
        yield Event("rail_disagrees", f"{apart_m * 1e3:.0f} mm apart")


def _appended(problem: str | None) -> str:
    return f"; {problem}" if problem else ""


def _old(age_s: float, limit_s: float, problem: str) -> str:
    return f"{age_s * 1e3:.0f} ms old, allowed {limit_s * 1e3:.0f} ms{problem}"


def _mocap(inputs: Inputs, observer: Observer, config: Config) -> Iterator[Event]:
    problem = _appended(inputs.problems.mocap)
    age_ns = observer.mocap_age_ns(inputs.t_ns)
    if any(not math.isfinite(v) for f in inputs.mocap for b in f.bodies if b.tracked for v in b[:3]):
        yield Event("not_finite", "motion capture pose")
    lost = (
        []
        if observer.newest is None
        else [name for name, body in zip(BODY_NAMES, observer.newest.bodies, strict=True) if not body.tracked]
    )
    if lost:
        yield Event("mocap_body_lost", ", ".join(lost))
    yield from observer.plausibility.events()
    if age_ns is None:
        yield Event("mocap_missing", f"none since the start{problem}")
    elif not observer.bridged_ns and age_ns > config.failsafe.mocap_stale_s * 1e9:
        yield Event("mocap_stale", _old(age_ns * 1e-9, config.failsafe.mocap_stale_s, problem))
    elif observer.frames_in_a_row < config.failsafe.arming_frames:
        yield Event("mocap_settling", f"{observer.frames_in_a_row} of {config.failsafe.arming_frames} frames")
    if observer.bridged_ns and not observer.seen:
        deviation_m = observer.tip_deviation_m
        yield Event(
            "mocap_bridged", f"for {observer.bridged_ns / 1e6:.0f} ms, tip known to {deviation_m * 1e3:.0f} mm{problem}"
        )


def _pressure(inputs: Inputs, config: Config, engaged: bool) -> Iterator[Event]:
    reading, problem = inputs.pressure, _appended(inputs.problems.regulator)
    if reading is None:
        yield Event("pressure_missing", f"none since the start{problem}")
        return
    age_s = (inputs.t_ns - reading.t_receive_ns) * 1e-9
    if age_s > config.failsafe.pressure_stale_s:
        yield Event("pressure_stale", _old(age_s, config.failsafe.pressure_stale_s, problem))
        return
    limits, kpa = config.limits.pressure, reading.pressure_kpa
    low, high = limits.min_kpa - limits.sensor_tolerance_kpa, limits.max_kpa + limits.sensor_tolerance_kpa
    if not math.isfinite(kpa):
        yield Event("not_finite", "pressure")
    elif not low <= kpa <= high:
        yield Event("pressure_outside", f"{kpa:.1f} kPa, allowed {low:.1f} to {high:.1f} kPa")
    if reading.faults:
        yield Event("regulator_fault", ", ".join(reading.faults))
    if engaged and not reading.armed:
        yield Event("regulator_vented", f"last accepted command: number {reading.sequence}")


def _rail(inputs: Inputs, config: Config, engaged: bool) -> Iterator[Event]:
    reading, problem = inputs.rail, _appended(inputs.problems.rail)
    if reading is None:
        yield Event("rail_missing", f"none since the start{problem}")
        return
    if not reading.linked:
        yield Event("rail_link_lost", problem.removeprefix("; "))
        return
    age_s = (inputs.t_ns - reading.t_receive_ns) * 1e-9
    if age_s > config.failsafe.rail_stale_s:
        yield Event("rail_stale", _old(age_s, config.failsafe.rail_stale_s, problem))
        return
    limits, position = config.limits.rail, reading.position_m
    if reading.homed is False:
        yield Event("rail_not_homed")
    if not (math.isfinite(position) and math.isfinite(reading.velocity_m_s)):
        yield Event("not_finite", "rail position or velocity")
    elif _is_unreferenced(reading, engaged):
        pass
    elif not limits.position_min_m - OUTSIDE_M <= position <= limits.position_max_m + OUTSIDE_M:
        allowed = f"{limits.position_min_m:.3f} to {limits.position_max_m:.3f} m"
        yield Event("rail_outside", f"at {position:.3f} m, allowed {allowed}")
    elif (beyond_m := max(position - limits.position_max_m, limits.position_min_m - position)) > RAIL_EXCURSION_M:
        yield Event("rail_overrun", f"{beyond_m * 1e3:.0f} mm beyond it, allowed {RAIL_EXCURSION_M * 1e3:.0f} mm")
    if not reading.remote:
        yield Event("remote_off")
    if reading.faults:
        yield Event("rail_fault", ", ".join(reading.faults))
    if engaged and not reading.enabled:
        yield Event("rail_disabled", f"operation is not enabled{problem}")
    yield from _rail_cycle(reading, config)


def _is_unreferenced(reading: RailReading, engaged: bool) -> bool:
    """Return whether the axis is off and not homed: a person must not push the cart by its position."""
    return reading.homed is False and not engaged


def _rail_cycle(reading: RailReading, config: Config) -> Iterator[Event]:
    """Compare the cycle time with the braking law's latency: a set-point waits for the cycle in progress."""
    period_s = 1 / config.control.rate_hz
    counted_s = max(period_s, config.limits.rail.latency_s)
    p50_s, max_s = reading.cycle_p50_ns * 1e-9, reading.cycle_max_ns * 1e-9
    cycle = f"median {p50_s * 1e3:.0f} ms, longest {max_s * 1e3:.0f} ms in the last second"
    if p50_s > counted_s:
        yield Event("rail_too_slow", f"{cycle}; allowed {counted_s * 1e3:.0f} ms")
    elif max_s > period_s:
        yield Event("rail_slow", cycle)
