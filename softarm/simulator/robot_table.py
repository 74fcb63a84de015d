"""Table of the robot's own parameters: unit, physical bounds, and the source of the seed's value.

The model file's reader and `softarm model show` use it; defaults are in `softarm.schemas.model`.
Sources: [P] the CoRL 2023 paper (sections; SM: its supplement), [C] its authors' released configuration.
"""

from softarm.common.quantity import Quantity


def _row(name: str, unit: str, low: float, high: float, source: str) -> Quantity:
    return Quantity(name=name, unit=unit, low=low, high=high, source=source)


_ROWS = (
    _row("arm.link_length_m", "m", 0.005, 1.0, "[C]; [P] SM-E: 0.44 m in all"),
    _row("arm.link_mass_kg", "kg", 1e-4, 2.0, "[C], and the total of [P] SM-E: 0.12 kg"),
    _row("arm.link_inertia_kg_m2", "kg m^2", 1e-9, 0.1, "[C]: thin shells and a solid tip"),
    _row("arm.stiffness_nm_rad", "N m/rad", 0.0, 50.0, "[P] SM-B, [C]"),
    _row("arm.damping_nm_s_rad", "N m s/rad", 0.0, 5.0, "[P] SM-B, [C]"),
    _row("arm.muscle_gain_nm_kpa", "N m/kPa", -0.02, 0.02, "[P] SM-B and [C], there in N m/psi"),
    _row("arm.torque_offset_nm", "N m", -0.5, 0.5, "[C] only; [P] leaves it out"),
    _row("arm.base_height_m", "m", 0.0, 10.0, "[C]"),
    _row("arm.gravity_m_s2", "m/s^2", 0.0, 30.0, "standard gravity"),
    _row("cart.mass_kg", "kg", 0.01, 50.0, "[C]"),
    _row("cart.feedforward_mass_kg", "kg", 0.0, 50.0, "[C]; [P] section 3.3: the mass of the robot"),
    _row("cart.acceleration_gain_kg", "kg", 0.0, 50.0, "[P] SM-E, [C]"),
    _row("cart.velocity_gain_n_s_m", "N s/m", 0.0, 10000.0, "[P] SM-E, [C]"),
    _row("cart.tracking_switch_m_s", "m/s", 0.0, 10.0, "[P] section 3.3"),
    _row("cart.travel_m", "m", 0.01, 100.0, "[P] SM-E: 0.6 m in all"),
)
# Name -> parameter of arm or cart; for a list, the bounds of each entry.
ROBOT = {quantity.name: quantity for quantity in _ROWS}
