"""Laws of the independent robot, from energy to the contact with a shelf."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from benchmarks import commands
from softarm.reality.parameters import Arm, Rail, RobotParameters
from softarm.reality.plant import RADIUS_M, Plant
from softarm.reality.robot import Robot
from softarm.schemas.model import Arm as ModelArm
from softarm.schemas.robot import CONTROL_PERIOD_S
from softarm.simulator.simulator import Simulator

STRAIGHT = ModelArm(torque_offset_nm=(0.0,) * 5)


def energy_j(plant: Plant) -> float:
    """Return the kinetic and potential energy, springs included."""
    before = plant.model.opt.enableflags
    plant.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    mujoco.mj_forward(plant.model, plant.data)
    plant.model.opt.enableflags = before
    return float(plant.data.energy.sum())


def test_an_arm_without_torques_hangs_straight() -> None:
    robot = Robot(RobotParameters(body=STRAIGHT))
    robot.advance(1.0)
    np.testing.assert_allclose(robot.truth.link_angles_rad, 0.0, atol=1e-9)
    tip_z_m = STRAIGHT.base_height_m - sum(STRAIGHT.link_length_m)
    np.testing.assert_allclose(robot.truth.link_ends_m[-1], (0.0, tip_z_m), atol=1e-9)


def test_a_hanging_arm_is_at_rest_from_the_start() -> None:
    robot = Robot(cart_position_m=0.1, held=True, hanging=True)
    start = robot.truth
    assert start.t_s == 0
    assert start.cart_position_m == pytest.approx(0.1, abs=1e-9)
    assert start.link_ends_m[-1][0] < 0.1 - 0.003
    robot.advance(0.3)
    np.testing.assert_allclose(robot.truth.link_ends_m, start.link_ends_m, atol=2e-5)


@pytest.mark.parametrize(
    ("arm", "held"),
    [(Arm(), True), *((arm, False) for arm in (Arm(friction_nm=0.02), Arm(air_kg_m3=5.0), Arm(payload_kg=0.1)))],
)
def test_energy_is_never_created_with_everything_off(arm: Arm, held: bool) -> None:
    """Bent, let go, with no pressure and no drive: springs, gravity and dampers alone."""
    robot = Robot(RobotParameters(body=STRAIGHT, arm=arm), held=held)
    robot.plant.data.qpos[1:] = -0.15
    energies = [energy_j(robot.plant)]
    for _ in range(2000):
        robot.plant.step(0.0, 0.0, 0.0)
        energies.append(energy_j(robot.plant))
    assert np.diff(energies).max() < 1e-5 * energies[0]
    assert energies[-1] < 0.9 * energies[0]


def test_momentum_along_a_free_rail_is_kept() -> None:
    """The bent arm is let go on a cart that nothing drives: their centre of mass stays where it was."""
    robot = Robot(RobotParameters(body=STRAIGHT))
    plant = robot.plant
    plant.data.qpos[1:] = -0.15

    def centre_m() -> float:
        energy_j(plant)  # brings MuJoCo's derived values up to date
        return float(plant.data.subtree_com[0][0])

    start = centre_m()
    for _ in range(1000):
        plant.step(0.0, 0.0, 0.0)
    assert abs(plant.cart_position_m) > 0.005
    assert centre_m() == pytest.approx(start, abs=5e-4)


def test_the_stops_hold_the_cart() -> None:
    robot = Robot()
    robot.command(0.0, 1.0, 0.0)
    farthest = 0.0
    for step in range(60):
        robot.advance(step / 60)
        farthest = max(farthest, robot.truth.cart_position_m)
    assert 0.299 < farthest < 0.305


@pytest.mark.slow
@pytest.mark.parametrize("draw", [commands.smooth, commands.bang_bang])
def test_the_nominal_robot_stays_near_the_five_link_simulator(draw: Any) -> None:
    """Two command sets of 3 s; docs/reference/reality.md gives the RMS over more."""
    tips_mm, carts_mm = [], []
    for seed in range(2):
        velocity, pressure = draw(1, seed=seed)
        simulator, robot = Simulator(physics_rate_hz=1200.0), Robot()
        for tick, (v, p) in enumerate(zip(0.3 * velocity[:, 0], pressure[:, 0], strict=True)):
            simulator.step(float(v), float(p), CONTROL_PERIOD_S)
            robot.command(tick / 30, float(v), float(p))
            robot.advance((tick + 1) / 30)
            truth = robot.truth
            tips_mm.append(1e3 * (truth.link_ends_m[-1] - simulator.tip_m()[0]))
            carts_mm.append(1e3 * (truth.cart_position_m - simulator.cart_position_m[0]))
    assert np.sqrt(np.square(tips_mm).sum(axis=1).mean()) < 8.0  # mm; measured 3.7 and 5.8
    assert np.sqrt(np.square(carts_mm).mean()) < 4.0


def test_a_step_rate_of_two_kilohertz_is_sufficient() -> None:
    """The same swing with the step halved, through MuJoCo alone: the tip agrees to half a millimetre."""

    def swing(steps: int, halved: int) -> np.ndarray:
        robot = Robot(RobotParameters(), held=True)
        robot.plant.model.opt.timestep /= halved
        for _ in range(steps * halved):
            robot.plant.step(0.0, 0.0, 10.0)
        return np.asarray(robot.truth.link_ends_m[-1])

    for steps in (400, 1000):
        assert np.linalg.norm(swing(steps, 1) - swing(steps, 4)) < 1e-3


def test_a_limp_drive_gives_way_to_the_arm() -> None:
    def wander_m(gain: float) -> float:
        robot = Robot(replace(RobotParameters(), rail=Rail(velocity_gain_n_s_m=gain)))
        robot.command(0.0, 0.0, 20.0)
        farthest = 0.0
        for step in range(60):
            robot.advance(step / 60)
            farthest = max(farthest, abs(robot.truth.cart_position_m))
        return farthest

    assert wander_m(30.0) > 3 * wander_m(300.0) > 0


PERIOD_S = 1 / 30
EDGE_M, BOARD_M = -0.25, 0.55


def swing(shelf_m, air=0.0, steps=30):
    """Tips of the independent robot and of ours, both [steps, 2], swung towards a shelf."""
    robot = Robot(RobotParameters(arm=Arm(air_kg_m3=air)), cart_position_m=0.1, shelf_m=shelf_m)
    simulator = Simulator(None, 1, 1200.0)
    simulator.reset(cart_position_m=0.1)
    if shelf_m:
        simulator.place_shelf(*shelf_m)
    tips = []
    for k in range(steps):
        velocity, pressure = -0.8 if k < 12 else 0.8 if k < 24 else -0.3, 20.0 if k > 8 else 0.0
        robot.command(k * PERIOD_S, velocity, pressure)
        robot.advance((k + 1) * PERIOD_S)
        simulator.step(velocity, pressure)
        tips.append((robot.truth.link_ends_m[-1], simulator.tip_m()[0]))
    return np.array(tips).transpose(1, 0, 2)


@pytest.fixture(scope="module")
def free():
    return swing(None)[0]


def test_a_shelf_out_of_reach_changes_nothing(free):
    assert np.array_equal(swing((-5.0, BOARD_M))[0], free)
    air = [swing(shelf, air=8.0, steps=10)[0] for shelf in (None, (-5.0, BOARD_M))]
    assert np.array_equal(*air)


def test_a_shelf_holds_the_arm_at_the_boards_edge_as_in_the_simulator(free):
    theirs, ours = swing((EDGE_M, BOARD_M))
    assert free[:, 0].min() < EDGE_M - 0.15
    assert theirs[:, 0].min() > EDGE_M - RADIUS_M / 2
    assert np.linalg.norm(theirs - ours, axis=1).max() < 0.05
