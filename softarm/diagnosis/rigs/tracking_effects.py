"""Effects of an actuator that follows a command: a servo, a regulator, an axis in velocity mode."""

import math
from collections.abc import Iterator

from softarm.diagnosis.rigs.effects import backlash, latency, like, of_stage
from softarm.diagnosis.rigs.scales import LATEST, SIGMAS, SURE, TrackingScales
from softarm.simulator.effect_table import Effect, Parameter, shape, strength

# Pairs that are easily mistaken for each other, and the motion that separates them.
_RIVALS: tuple[tuple[str, str, str], ...] = (
    ("dead_time", "lag", "a step: a dead time starts flat, a lag at its steepest slope; a multisine over a decade"),
    ("dead_time", "deadband", "ramps of several slopes: the wait stays for a dead time"),
    (
        "dead_time",
        "latency",
        "the same motion with a second sensor: its stamps separate the two, one shows only their sum",
    ),
    ("ceiling", "gain deadband", "an amplitude sweep: a ceiling leaves low commands alone"),
    ("gain", "sensor_bias", "a second sensor, or a known zero: a wrong reading stays when the motion itself is right"),
    ("deadband", "backlash", "reversals under load: play shuts, a friction's dead zone stays"),
    ("deadband", "lag", "a slow ramp: a lag's error shrinks with its slope, a dead zone's stays"),
    ("lag", "sensor_bias", "long holds at several levels: a lag's error fades, a wrong zero stays"),
    ("rate_limit", "lag", "steps of several sizes: the time grows with the step only for a limit"),
    ("rate_limit", "acceleration_limit", "fast sines of two sizes: a rate limit makes triangles, the other turns late"),
    ("acceleration_limit", "lag", "sines of two sizes: only a limit answers the larger one less"),
    ("second_order", "lag", "a step: a second-order system starts flat and may overshoot, a lag starts steepest"),
    ("second_order", "dead_time", "a multisine over a decade: a resonance changes amplitudes, a dead time does not"),
    ("second_order", "acceleration_limit", "steps of several sizes: only a limit takes longer for larger ones"),
    ("hysteresis", "backlash", "small reversals: play hides them whole, a loop lets a part through"),
    ("hysteresis", "deadband", "small reversals: a dead zone hides them whole, a loop lets a part through"),
    ("hysteresis", "lag", "the same loop at three rates: its area stays for hysteresis"),
    ("coulomb_friction", "gain", "a sweep of commands: a gain's error grows, dry friction's not"),
    ("coulomb_friction", "deadband", "slowing down without a stop: friction helps, a dead zone stays above"),
    ("coulomb_friction", "backlash", "reversals under load: play shuts, friction stays"),
)


def tracking_effects(stage: str, unit: str, scales: TrackingScales, velocity: bool = False) -> tuple[Effect, ...]:
    """Return every effect that an actuator can show in its recordings, in the order in which a command meets it.

    unit is that of the measured channel; velocity: whether this channel is a velocity.
    """
    effects = [*_drive(unit, scales), *_limits(unit, scales), *_mechanics(unit, scales), *_readings(unit, scales)]
    if not velocity:  # dry friction against a position loop is a dead zone
        effects = [effect for effect in effects if effect.name != "coulomb_friction"]
    return of_stage(stage, effects, _RIVALS)


def _drive(unit: str, s: TrackingScales) -> Iterator[Effect]:
    yield like(
        "pressure.dead_time",
        "it starts to react late",
        "{stage} reacts {delay} late",
        _delay("from the command to the first reaction", s),
    )
    yield like(
        "pressure.gain",
        "it ends at the nominal end x (1 + scale) + offset: a proportional loop droops under a load",
        "the gain of {stage} is off by {scale} and its zero by {offset}",
        strength("scale", "-", 0.0, -1.0, 2.0, 0.1, "relative error of the gain"),
        strength("offset", unit, 0.0, -s.reach, s.reach, s.share, "error of the zero"),
    )
    beyond = s.commanded - s.top
    if beyond > max(s.share, 0.0):  # a ceiling shows only if some commands were out of reach
        none = s.commanded + 0.1 * s.reach
        low = s.top - max(SIGMAS * s.noise, 0.02 * s.reach)
        yield like(
            "pressure.ceiling",
            "it ends at no more than this: the drive saturates",
            "{stage} reaches at most {limit}",
            strength("limit", unit, none, low, none, s.commanded - 0.5 * beyond, "highest value that is reached"),
        )
    yield like(
        "pressure.deadband",
        "an error up to the width, either way, moves nothing: dry friction against a proportional loop",
        "{stage} ignores errors below {width}",
        _width("width", unit, s, "an error this small moves nothing"),
    )
    yield like(
        "pressure.lag",
        "it nears the command exponentially, with an own time constant upwards and downwards",
        "{stage} follows slowly, with time constants of {rise} up and {fall} down",
        _delay("time constant upwards", s, "rise"),
        _delay("time constant downwards", s, "fall"),
    )


def _limits(unit: str, s: TrackingScales) -> Iterator[Effect]:
    highest = s.reach / s.step_s
    yield like(
        "pressure.rate_limit",
        "it moves no faster than this, upwards and downwards",
        "{stage} moves by at most {rate} up and {fall} down",
        _limit("rate", _rate(unit, 1), s.rise, highest, "largest slope upwards"),
        _limit("fall", _rate(unit, 1), s.fall, highest, "largest slope downwards"),
    )
    highest = s.reach / s.step_s**2
    yield like(
        "rail.acceleration_limit",
        "its velocity changes no faster than this: a motor's torque is limited",
        "{stage} accelerates at most with {acceleration}",
        _limit("acceleration", _rate(unit, 2), s.acceleration, highest, "slope of the velocity"),
    )


def _mechanics(unit: str, s: TrackingScales) -> Iterator[Effect]:
    # From a sine that a trial holds three times to one that is sampled four times.
    slowest, fastest = 3 / s.longest_s, max(0.25 / s.step_s, 4 / s.longest_s)
    usual = min(max(1 / (2 * math.pi * s.late_s), 4 / s.longest_s), 0.2 / s.step_s)
    yield Effect(
        "second_order",
        (
            strength("frequency", "Hz", math.inf, slowest, fastest, usual, "undamped natural frequency"),
            shape("damping", "-", 0.5, 0.02, 0.9, 0.5, "damping ratio; from 1 on it would be lags"),
            # Wider than 0 .. 1, so that neither end is a bound of the fit.
            shape("coupling", "-", 0.0, -0.25, 1.25, 0.5, "share of the damping between the drive and the sensor"),
        ),
        "it follows as a second-order system: a mass on a spring, a loop with an integrator",
        "standard second-order system, w^2 / (s^2 + 2 z w s + w^2); "
        "Franklin, Powell and Emami-Naeini, Feedback Control",
        plain="{stage} swings at {frequency} when it follows",
    )
    yield backlash(_width("gap", unit, s, "free travel between the flanks"))
    yield like(
        "arm.hysteresis",
        "a loop between command and end, as wide at any speed (Bouc-Wen): soft material, no free travel",
        "{stage} moves differently on the way up and down (hysteresis)",
        strength("strength", "-", 0.0, 0.0, 0.5, 0.3, "half height of the loop over its width"),
        shape("width", unit, 0.15 * s.reach, 0.01 * s.reach, s.reach, 0.15 * s.reach, "travel of a reversal"),
    )
    yield like(
        "rail.coulomb_friction",
        "dry friction against a velocity loop: it stays behind by this, either way, and stands still below",
        "dry friction holds {stage} back by {loss}",
        _width("loss", unit, s, "dry friction"),
    )


def _readings(unit: str, s: TrackingScales) -> Iterator[Effect]:
    yield like(
        "pressure.sensor_bias",
        "the sensor reads high",
        "the sensor of {stage} reads {bias} off",
        strength("bias", unit, 0.0, -s.reach, s.reach, s.share, "reading minus true value"),
    )
    yield latency(_delay("age of a reading beyond its stamp", s))


def _delay(meaning: str, s: TrackingScales, name: str = "delay") -> Parameter:
    latest = LATEST * s.longest_s
    return strength(name, "s", 0.0, 0.0, latest, min(s.late_s, 0.5 * latest), meaning)


def _width(name: str, unit: str, s: TrackingScales, meaning: str) -> Parameter:
    return strength(name, unit, 0.0, 0.0, 0.5 * s.reach, s.share, meaning)


def _limit(name: str, unit: str, seen: float, unseen: float, meaning: str) -> Parameter:
    """Limit of a rate: not below the largest one seen; beyond `unseen` no sample shows it."""
    low = max(SURE * seen, 1e-6 * unseen)
    return strength(name, unit, math.inf, low, max(unseen, 10 * low), 1.5 * low, meaning)


def _rate(unit: str, order: int) -> str:
    """Return the unit of the order-th derivative: ('m/s', 1) -> 'm/s^2'."""
    base, slash, power = unit.partition("/s")
    order += int(power.lstrip("^") or 1) if slash else 0
    return base + ("/s" if order == 1 else f"/s^{order}")
