"""Parameters of the independent robot. The defaults are the nominal robot, without any imperfection.

Nominal values come from `softarm.schemas.model`, which names their sources. Sensor noise has the usual size for such
sensors. Every group is frozen and checks its values; `dataclasses.replace` makes a robot with an imperfection.
"""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any

import softarm.schemas.model as seed
from softarm.common.quantity import Quantity


def quantity(default: float, unit: str, low: float, high: float, meaning: str) -> Any:
    """Declare a quantity; both bounds are allowed values, and a whole default allows whole numbers only."""
    facts = Quantity(unit=unit, low=low, high=high, whole=isinstance(default, int), default=default, meaning=meaning)
    return dataclasses.field(default=default, metadata={"quantity": facts})


def of(group: type) -> dict[str, Quantity]:
    """Return the quantities of a group by name, in order of declaration."""
    return {field.name: field.metadata["quantity"] for field in dataclasses.fields(group)}


class Checked:
    """Base of every group of quantities; rejects values outside their bounds."""

    def __post_init__(self) -> None:
        """Raise ValueError with the quantity's name, the allowed range and what to do."""
        for name, allowed in of(type(self)).items():
            if not allowed.takes(value := getattr(self, name)):
                raise ValueError(f"{type(self).__name__}.{name} {allowed.complaint(value)}; choose another")


def table(*groups: type[Checked]) -> str:
    """Return the quantities as a Markdown table, one row each, in order of declaration."""
    rows = ["| parameter | default | range | unit | meaning |", "|---|---|---|---|---|"]
    for group in groups:
        for name, it in of(group).items():
            limits = f"{it.low:g} .. {it.high:g}"
            rows.append(f"| `{group.__name__}.{name}` | {it.default:.4g} | {limits} | {it.unit} | {it.meaning} |")
    return "\n".join(rows) + "\n"


INF = math.inf


_SEED = seed.Model()
_LAG, _RAMP = _SEED.effects["pressure.lag"], _SEED.effects["rail.acceleration_limit"]
_DELAY, _CART = _SEED.effects["rail.delay"], _SEED.cart


@dataclass(frozen=True, slots=True, kw_only=True)
class Regulator(Checked):
    """The pressure regulator: a valve and a tube (two poles); filling and venting have different time constants."""

    inflate_s: float = quantity(_LAG["inflate"], "s", 0, 2, "time constant of filling, tube included")
    deflate_s: float = quantity(_LAG["deflate"], "s", 0, 2, "time constant of venting, tube included")
    tube_s: float = quantity(0.005, "s", 0, 0.2, "time constant of the tube between valve and muscle")
    dead_time_s: float = quantity(0.0, "s", 0, 0.3, "delay until a command arrives")
    dead_time_jitter_s: float = quantity(0.0, "s", 0, 0.1, "mean of the random delay (exponential, in order)")
    flow_limit_kpa_s: float = quantity(INF, "kPa/s", 5, INF, "choked flow through the valve")
    deadband_kpa: float = quantity(0.0, "kPa", 0, 5, "commands closer than this to the one in force are ignored")
    gain: float = quantity(0.0, "-", -0.5, 0.5, "reached = command x (1 + gain) + offset")
    offset_kpa: float = quantity(0.0, "kPa", -5, 5, "see gain")
    ceiling_kpa: float = quantity(INF, "kPa", 1, INF, "highest pressure of the supply")
    leak_1_s: float = quantity(0.0, "1/s", 0, 3, "share of the pressure that the muscle loses in a second")
    stick_kpa: float = quantity(0.0, "kPa", 0, 10, "error below which the valve sticks")
    stick_below_kpa: float = quantity(0.0, "kPa", 0, 20, "highest pressure at which the valve sticks")


@dataclass(frozen=True, slots=True, kw_only=True)
class Rail(Checked):
    """The rail: a velocity ramp, a proportional velocity loop with feed-forward, and the mechanism."""

    acceleration_m_s2: float = quantity(_RAMP["acceleration"], "m/s^2", 0.5, 40, "slope of the velocity ramp")
    velocity_gain_n_s_m: float = quantity(_CART.velocity_gain_n_s_m, "N s/m", 1, 300, "force for velocity error")
    feedforward_kg: float = quantity(_CART.feedforward_mass_kg, "kg", 0, 2, "force for the ramp's acceleration")
    force_limit_n: float = quantity(INF, "N", 1, INF, "highest force of the motor")
    delay_s: float = quantity(_DELAY["delay"], "s", 0, 0.3, "delay until a command arrives")
    delay_jitter_s: float = quantity(0.0, "s", 0, 0.1, "mean of the random delay (exponential, in order)")
    lag_s: float = quantity(0.0, "s", 0, 0.5, "first-order lag of the reference behind the ramp")
    feed_error: float = quantity(0.0, "-", -0.3, 0.3, "true motion = motion that the drive assumes x (1 + error)")
    coulomb_n: float = quantity(0.0, "N", 0, 10, "dry friction while sliding")
    stiction_n: float = quantity(0.0, "N", 0, 10, "additional dry friction at rest")
    stribeck_m_s: float = quantity(0.02, "m/s", 0.001, 0.5, "speed at which stiction fades")
    viscous_n_s_m: float = quantity(0.0, "N s/m", 0, 30, "viscous friction")
    backlash_m: float = quantity(0.0, "m", 0, 0.03, "play between motor and cart; the encoder sits on the motor")
    cable_n_m: float = quantity(0.0, "N/m", 0, 200, "stiffness of a cable that pulls the cart back at the +y end")
    cable_taut_m: float = quantity(0.1, "m", -0.3, 0.3, "cart position from which the cable pulls")
    ripple_n: float = quantity(0.0, "N", 0, 20, "force ripple of the gear")
    ripple_period_m: float = quantity(0.04, "m", 0.002, 0.5, "travel for one period of the ripple")


@dataclass(frozen=True, slots=True, kw_only=True)
class Arm(Checked):
    """The arm: its number of links, and its differences from the `schemas.model.Arm` that it is made from."""

    pieces: int = quantity(2, "-", 1, 4, "links for one link of the model")
    stiffness: float = quantity(0.0, "-", -0.7, 2, "K x (1 + this)")
    damping: float = quantity(0.0, "-", -0.8, 4, "D x (1 + this)")
    muscle_gain: float = quantity(0.0, "-", -0.7, 2, "b x (1 + this)")
    torque_offset: float = quantity(0.0, "-", -2, 4, "constant torque x (1 + this)")
    friction_nm: float = quantity(0.0, "N m", 0, 0.2, "dry friction in every joint")
    stiffening_1_rad2: float = quantity(0.0, "1/rad^2", -0.5, 10, "K theta (1 + this theta^2), theta of the model")
    hysteresis: float = quantity(0.0, "-", 0, 0.9, "share of the muscle's torque that follows through play")
    hysteresis_kpa: float = quantity(4.0, "kPa", 0.1, 20, "width of the widest of three plays")
    saturation_kpa: float = quantity(INF, "kPa", 2, INF, "torque levels off: p / (1 + (p/s)^3)^(1/3)")
    payload_kg: float = quantity(0.0, "kg", 0, 0.5, "point mass at the tip")
    tilt_rad: float = quantity(0.0, "rad", -0.2, 0.2, "gravity leans towards +y")
    air_kg_m3: float = quantity(0.0, "kg/m^3", 0, 20, "density of MuJoCo's fluid around ellipsoid links")
    creep: float = quantity(0.0, "-", 0, 2, "slow bending, as a share of the elastic one")
    creep_s: float = quantity(5.0, "s", 0.1, 300, "time constant of creep")
    softening: float = quantity(0.0, "-", -0.7, 0.7, "K x (1 - this x (1 - exp(-t/softening_s))): warming up")
    softening_s: float = quantity(30.0, "s", 1, 3600, "time constant of softening")
    fatigue: float = quantity(0.0, "-", -0.7, 0.7, "muscle's torque x (1 - this x (1 - exp(-t/fatigue_s)))")
    fatigue_s: float = quantity(30.0, "s", 1, 3600, "time constant of fatigue")


@dataclass(frozen=True, slots=True, kw_only=True)
class Mocap(Checked):
    """The cameras. The angle of a marker set is the angle of the chord of its link."""

    rate_hz: float = quantity(120.0, "Hz", 10, 500, "exposures, each at the next physics step")
    noise_m: float = quantity(0.0003, "m", 0, 0.02, "standard deviation of every coordinate")
    angle_noise_rad: float = quantity(0.002, "rad", 0, 0.2, "standard deviation of every angle")
    latency_s: float = quantity(0.0, "s", 0, 0.3, "age of a pose at its capture stamp")
    transport_s: float = quantity(0.0, "s", 0, 0.3, "time from capture stamp to reception")
    transport_jitter_s: float = quantity(0.0, "s", 0, 0.1, "mean of the random delay (exponential, in order)")
    dropout: float = quantity(0.0, "-", 0, 0.9, "share of frames that never arrive")
    rotation_rad: float = quantity(0.0, "rad", -0.2, 0.2, "rotation of the calibration about the middle of the rail")
    scale: float = quantity(0.0, "-", -0.1, 0.1, "scale error of the calibration: distances x (1 + scale)")
    offset_y_m: float = quantity(0.0, "m", -0.1, 0.1, "offset of the calibration along the rail")
    offset_z_m: float = quantity(0.0, "m", -0.1, 0.1, "vertical offset of the calibration")
    loose_link: int = quantity(0, "-", 0, 5, "link with a loose marker set; 0: no link")
    loose_hz: float = quantity(6.0, "Hz", 1, 50, "natural frequency of the loose marker set")
    loose_damping: float = quantity(0.1, "-", 0.01, 2, "damping ratio of the loose marker set")


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureSensor(Checked):
    """Pressure sensor inside the regulator."""

    rate_hz: float = quantity(120.0, "Hz", 10, 500, "rate of the readings")
    noise_kpa: float = quantity(0.03, "kPa", 0, 2, "standard deviation")
    quantum_kpa: float = quantity(0.01, "kPa", 0, 2, "step of the converter")
    bias_kpa: float = quantity(0.0, "kPa", -3, 3, "constant error of the readings")


@dataclass(frozen=True, slots=True, kw_only=True)
class RailSensor(Checked):
    """Encoder read-back of the rail's axis."""

    rate_hz: float = quantity(120.0, "Hz", 10, 500, "rate of the readings")
    position_quantum_m: float = quantity(1e-5, "m", 0, 0.01, "step of the encoder")
    velocity_quantum_m_s: float = quantity(1e-3, "m/s", 0, 0.1, "step of the velocity that the drive computes")


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock(Checked):
    """Timing errors: of the recording controller's ticks, and of the cameras' clock against the controller's."""

    tick_jitter_s: float = quantity(0.0, "s", 0, 0.015, "standard deviation of a tick's lateness (folded)")
    missed_ticks: float = quantity(0.0, "-", 0, 0.5, "share of ticks without a command")
    camera_drift: float = quantity(0.0, "-", -0.01, 0.01, "seconds that the capture stamps gain per second")


MOTOR_KG = 0.1  # the part of the cart's mass in front of the backlash
GROUPS = (Regulator, Rail, Arm, Mocap, PressureSensor, RailSensor, Clock)


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotParameters:
    """Parameters of one robot: the five-link arm (`body`), the cart's mass and travel (`cart`), and each device."""

    body: seed.Arm = field(default_factory=seed.Arm)
    cart: seed.Cart = field(default_factory=seed.Cart)
    regulator: Regulator = field(default_factory=Regulator)
    rail: Rail = field(default_factory=Rail)
    arm: Arm = field(default_factory=Arm)
    mocap: Mocap = field(default_factory=Mocap)
    pressure_sensor: PressureSensor = field(default_factory=PressureSensor)
    rail_sensor: RailSensor = field(default_factory=RailSensor)
    clock: Clock = field(default_factory=Clock)

    def __post_init__(self) -> None:
        """Reject an arm without the five links of a motion-capture frame, and a cart lighter than its motor."""
        if self.body.links != 5:
            raise ValueError(f"body has {self.body.links} links; a mocap frame carries 5: give a model with 5")
        if self.rail.backlash_m and self.cart.mass_kg <= MOTOR_KG:
            mass = f"cart.mass_kg is {self.cart.mass_kg:g}"
            raise ValueError(f"{mass}; with backlash the motor is {MOTOR_KG:g} kg of it: give more, or no backlash")


ACTUATORS = "pressure.lag", "rail.acceleration_limit", "rail.delay"  # effects of a model that a robot has


def of_model(model: seed.Model) -> RobotParameters:
    """Return the nominal robot of a model file: its arm, its cart and the time constants of its actuators.

    Raises ValueError for effects that are no part of the nominal robot.
    """
    if others := [name for name in model.effects if name not in (*ACTUATORS, "observation.finite_difference")]:
        raise ValueError(
            f"the independent robot does not take the model's {', '.join(others)}; allowed are {', '.join(ACTUATORS)}: "
            "remove the others, and give its own parameters, e.g. --fault arm.payload_kg=0.1"
        )
    lag = model.effects.get("pressure.lag", {})
    regulator = Regulator(inflate_s=lag.get("inflate", 0.0), deflate_s=lag.get("deflate", 0.0))
    rail = Rail(
        acceleration_m_s2=min(model.effects.get("rail.acceleration_limit", {}).get("acceleration", 40.0), 40.0),
        delay_s=model.effects.get("rail.delay", {}).get("delay", 0.0),
        velocity_gain_n_s_m=model.cart.velocity_gain_n_s_m,
        feedforward_kg=model.cart.feedforward_mass_kg,
    )
    return RobotParameters(body=model.arm, cart=model.cart, regulator=regulator, rail=rail)
