"""Checks a recorded run against its limits, from the log alone and not from the safety filter's own report."""

from collections.abc import Iterable

from softarm.daemon.control.records import Inputs, Outputs
from softarm.schemas.config import Limits


def exceeded(ticks: Iterable[tuple[Inputs, Outputs]], limits: Limits) -> list[str]:
    """Return a sentence per exceeded limit, for the read-back of the axis and the sent commands."""
    carts_m, velocities_m_s, pressures_kpa = [], [], []
    for inputs, outputs in ticks:
        if inputs.rail is not None:
            carts_m.append(inputs.rail.position_m)
        velocities_m_s.append(abs(outputs.sent.cart_velocity_m_s))
        pressures_kpa.append(outputs.sent.pressure_kpa)
    rail, pressure = limits.rail, limits.pressure
    problems = []
    if carts_m and not rail.position_min_m <= min(carts_m) <= max(carts_m) <= rail.position_max_m:
        problems.append(f"the cart left its limits: {min(carts_m):.3f} to {max(carts_m):.3f} m")
    if any(velocity > rail.velocity_max_m_s for velocity in velocities_m_s):
        problems.append("a velocity above its limit was sent")
    if not all(pressure.min_kpa <= kpa <= pressure.max_kpa for kpa in pressures_kpa):
        problems.append("a pressure outside its limits was sent")
    return problems
