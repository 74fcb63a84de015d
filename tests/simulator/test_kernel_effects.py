"""Every effect: no change when neutral, a change of its own stage only, and identifiable by a fit.

Each is measured where it belongs: its stage alone, driven by inputs that all robots share.
"""

from typing import Literal

import numpy as np
import pytest

from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY
from softarm.simulator.sensors import Clock, Sensors
from softarm.simulator.simulator import Simulator
from tests.simulator import stages

NUMERIC = [effect for effect in REGISTRY.values() if effect.parameters]
BY_CHANCE = ("mocap.noise", "mocap.dropout", "clock.jitter", "clock.missed_ticks")
STEPS, PERIOD_S = 75, 1 / 30
STAMPS = np.arange(STEPS) * PERIOD_S
RNG = np.random.default_rng(12)
# Steps of many sizes, each held for a fifth of a second.
VELOCITY = RNG.uniform(-0.8, 0.8, STEPS // 5).repeat(5) * np.where(np.arange(STEPS) % 10 < 5, 1.0, -1.0)
PRESSURE = RNG.uniform(0.0, 20.0, STEPS // 5).repeat(5) + RNG.uniform(-0.4, 0.4, STEPS)
# A cart that swings the arm, as if measured.
CART = 0.15 * np.sin(6.0 * STAMPS)
CART_VELOCITY = 0.9 * np.cos(6.0 * STAMPS)


def values_of(effect_name: str, kind: Literal["neutral", "exemplar"]) -> dict[str, float]:
    return {f"{effect_name}.{p.name}": getattr(p, kind) for p in REGISTRY[effect_name].parameters}


def base(effect_name: str) -> Model:
    """The seed's model without the effect in question."""
    model = Model()
    return Model(effects={name: given for name, given in model.effects.items() if name != effect_name})


def pressure_stage(model: Model, robots: int, values: stages.Overrides) -> np.ndarray:
    return stages.pressure_alone(model, STAMPS, PRESSURE, STAMPS, robots=robots, overrides=values)


def rail_stage(model: Model, robots: int, values: stages.Overrides) -> np.ndarray:
    return stages.rail_alone(model, STAMPS, VELOCITY, STAMPS, robots=robots, overrides=values, physics_rate_hz=240.0)


def arm_stage(model: Model, robots: int, values: stages.Overrides) -> np.ndarray:
    measured = CART, CART_VELOCITY, PRESSURE
    return stages.arm_alone(model, measured, PERIOD_S, robots=robots, overrides=values).reshape(-1, robots)


def contact_stage(model: Model, robots: int, values: stages.Overrides) -> np.ndarray:
    """The arm laid onto a board: the cart drives towards it, the muscle bends it in."""
    simulator = Simulator(model, robots, overrides=values)
    simulator.place_shelf(-0.1, 0.57)
    simulator.reset(joint_angles_rad=[-0.1, -0.3, -0.3, -0.4, -0.4])
    looks = []
    for _ in range(45):
        simulator.step(-0.1, 4.0)
        looks.append(simulator.tip_m().T)
    return np.concatenate(looks)


def mocap_stage(model: Model, robots: int, values: stages.Overrides) -> np.ndarray:
    simulator = Simulator(model, robots, overrides=values)
    sensors = Sensors(simulator, np.random.default_rng(1))
    looks = []
    for v, p in zip(VELOCITY[:40], PRESSURE[:40], strict=True):
        simulator.step(v, p)
        looks.append(sensors.look().positions_m.transpose(1, 2, 0).reshape(-1, robots))
    return np.concatenate(looks)


def clock_stage(model: Model, robots: int, values: stages.Overrides) -> np.ndarray:
    simulator = Simulator(model, robots, overrides=values)
    clock = Clock(simulator, np.random.default_rng(2))
    ticks = [clock.tick() for _ in range(400)]
    sensors, stamps = Sensors(simulator, np.random.default_rng(2)), []
    for _ in range(40):
        simulator.step(0.0, 0.0)
        stamps.append(sensors.look().stamps_s)
    return np.concatenate([*(np.stack(each) for each in zip(*ticks, strict=True)), np.stack(stamps)])


STAGE = {
    "pressure": pressure_stage,
    "rail": rail_stage,
    "arm": arm_stage,
    "contact": contact_stage,
    "mocap": mocap_stage,
    "clock": clock_stage,
}
# What a stage stands on, and what must not feel it.
UPSTREAM = {"rail": ("pressure",), "arm": ("pressure", "rail"), "contact": ("pressure", "rail"), "mocap": ("arm",)}


@pytest.mark.parametrize("effect", NUMERIC, ids=lambda effect: effect.name)
def test_a_neutral_effect_equals_no_effect_bit_for_bit(effect) -> None:  # type: ignore[no-untyped-def]
    """Alone, and beside neighbours in the same SIMD register that have it in full."""
    run, model = STAGE[effect.stage], base(effect.name)
    without = run(model, 1, {})
    np.testing.assert_array_equal(run(model, 1, values_of(effect.name, "neutral")), without)
    if effect.name == "contact.stiffness" or effect.stage in ("mocap", "clock"):
        return  # a shape, and draws of chance that depend on how many robots there are
    strong, idle = values_of(effect.name, "exemplar"), values_of(effect.name, "neutral")
    mixed = run(model, 3, {path: np.array([strong[path], idle[path], strong[path]]) for path in strong})
    np.testing.assert_array_equal(mixed[:, 1:2], without)


@pytest.mark.parametrize("effect", NUMERIC, ids=lambda effect: effect.name)
def test_a_strong_effect_changes_its_stage_and_none_upstream(effect) -> None:  # type: ignore[no-untyped-def]
    model, strong = base(effect.name), values_of(effect.name, "exemplar")
    without, changed = (STAGE[effect.stage](model, 1, values) for values in ({}, strong))
    assert np.isfinite(changed).all()
    assert np.abs(changed - without).max() > 1e-3
    for upstream in UPSTREAM.get(effect.stage, ()):
        run = STAGE[upstream]
        np.testing.assert_array_equal(run(model, 1, {}), run(model, 1, strong))


@pytest.mark.parametrize("effect", [e for e in NUMERIC if e.name not in BY_CHANCE], ids=lambda effect: effect.name)
def test_a_fit_of_its_own_simulation_finds_its_size(effect) -> None:  # type: ignore[no-untyped-def]
    """A coarse scan, then Gauss-Newton; each Jacobian is one batch, a column a parameter."""
    run, model, parameters = STAGE[effect.stage], base(effect.name), effect.parameters
    names = [f"{effect.name}.{p.name}" for p in parameters]
    truth = np.array([p.exemplar for p in parameters])

    def outputs(columns: np.ndarray) -> np.ndarray:  # [parameter, column] -> [sample, column]
        return run(model, columns.shape[1], dict(zip(names, columns, strict=True))).astype(np.float64)

    measured = outputs(truth[:, None])
    shares = np.linspace(0.52, 1.52, 21)  # none of them is the truth
    errors = ((outputs(truth[:, None] * shares) - measured) ** 2).sum(axis=0)
    found = truth * shares[errors.argmin()]
    if effect.name == "pressure.deadband":  # its command is acted on or not: no slope to follow
        assert abs(shares[errors.argmin()] - 1.0) < 0.06
        return
    for _ in range(6):
        steps = 0.01 * np.abs(truth)
        columns = np.column_stack((found, found[:, None] + np.diag(steps), found[:, None] - np.diag(steps)))
        out = outputs(columns)
        slope = (out[:, 1 : 1 + len(steps)] - out[:, 1 + len(steps) :]) / (2 * steps)
        move = np.linalg.lstsq(slope, measured[:, 0] - out[:, 0], rcond=None)[0]
        found = np.clip(found + move, found - 0.3 * np.abs(truth), found + 0.3 * np.abs(truth))
        if (np.abs(move) < 1e-3 * np.abs(truth)).all():
            break
    np.testing.assert_allclose(found, truth, rtol=0.02)


def test_random_effects_have_their_declared_probabilities() -> None:
    robots, looks = 400, 40
    simulator = Simulator(
        None,
        robots,
        overrides={
            "mocap.noise.sigma": 0.002,
            "mocap.dropout.share": 0.1,
            "clock.jitter.sigma": 0.003,
            "clock.missed_ticks.share": 0.05,
        },
    )
    sensors, clock = Sensors(simulator, np.random.default_rng(3)), Clock(simulator, np.random.default_rng(4))
    sensors.look()
    frames, ticks = [sensors.look() for _ in range(looks)], [clock.tick() for _ in range(looks)]
    fresh = np.array([frame.fresh for frame in frames])
    cart = np.array([frame.positions_m[:, 0, 0] for frame in frames])
    assert cart[fresh].std() == pytest.approx(0.002, rel=0.03)
    assert 1.0 - fresh.mean() == pytest.approx(0.1, rel=0.05)
    late, ticked = (np.array(each) for each in zip(*ticks, strict=True))
    assert np.sqrt((late**2).mean()) == pytest.approx(0.003, rel=0.03)
    assert 1.0 - ticked.mean() == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize("rate", [-0.01, 0.004])
def test_a_drifting_clock_stretches_stamps_and_velocities(rate: float) -> None:
    """A second of the loop is 1 + rate of the cameras'; poses are where they are, and rates are per their second."""
    simulator = Simulator(Model(), 2, overrides={"clock.drift.rate": np.array([rate, 0.0])})
    sensors = Sensors(simulator, np.random.default_rng(1))
    for v, p in zip(VELOCITY[:30], PRESSURE[:30], strict=True):
        simulator.step(v, p)
        seen = sensors.look()
        np.testing.assert_allclose(seen.stamps_s, simulator.time_s * np.array([1 + rate, 1.0]), rtol=1e-12)
        np.testing.assert_array_equal(*seen.positions_m)
    drifting, steady = seen.velocities_m_s
    assert np.abs(steady).max() > 0.1
    np.testing.assert_allclose(drifting * (1 + rate), steady, rtol=1e-9)
