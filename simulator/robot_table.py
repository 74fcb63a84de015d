"""The robot's own parameters: unit, what a robot of this kind could have at the very worst, and the seed's source.

Read by the model file's reader and by `softarm model show`; defaults are in `softarm.schemas.model`.
Sources: [P] the CoRL 2023 paper (sections; SM: its supplement), [C] its authors' released configuration.
"""

from dataclasses import dataclass

from softarm.simulator.quantities import Range


@dataclass(frozen=True)
class Quantity:
    """A parameter of arm or cart; of a list, each entry's range."""

    range: Range
    source: str


ROBOT: dict[str, Quantity] = {
    "arm.link_length_m": Quantity(Range("m", 0.005, 1.0), "[C]; [P] SM-E: 0.44 m in all"),
    "arm.link_mass_kg": Quantity(Range("kg", 1e-4, 2.0), "[C], and the total of [P] SM-E: 0.12 kg"),
    "arm.link_inertia_kg_m2": Quantity(Range("kg m^2", 1e-9, 0.1), "[C]: thin shells and a solid tip"),
    "arm.stiffness_nm_rad": Quantity(Range("N m/rad", 0.0, 50.0), "[P] SM-B, [C]"),
    "arm.damping_nm_s_rad": Quantity(Range("N m s/rad", 0.0, 5.0), "[P] SM-B, [C]"),
    "arm.muscle_gain_nm_kpa": Quantity(Range("N m/kPa", -0.02, 0.02), "[P] SM-B and [C], there in N m/psi"),
    "arm.torque_offset_nm": Quantity(Range("N m", -0.5, 0.5), "[C] only; [P] leaves it out"),
    "arm.base_height_m": Quantity(Range("m", 0.0, 10.0), "[C]"),
    "arm.gravity_m_s2": Quantity(Range("m/s^2", 0.0, 30.0), "standard gravity"),
    "cart.mass_kg": Quantity(Range("kg", 0.01, 50.0), "[C]"),
    "cart.feedforward_mass_kg": Quantity(Range("kg", 0.0, 50.0), "[C]; [P] section 3.3: the mass of the robot"),
    "cart.acceleration_gain_kg": Quantity(Range("kg", 0.0, 50.0), "[P] SM-E, [C]"),
    "cart.velocity_gain_n_s_m": Quantity(Range("N s/m", 0.0, 10000.0), "[P] SM-E, [C]"),
    "cart.tracking_switch_m_s": Quantity(Range("m/s", 0.0, 10.0), "[P] section 3.3"),
    "cart.travel_m": Quantity(Range("m", 0.01, 100.0), "[P] SM-E: 0.6 m in all"),
}
