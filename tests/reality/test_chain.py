"""Refinement of the arm: ten links with the mass, stiffness and damping of five."""

import numpy as np
import pytest

from softarm.reality.parameters import Arm, RobotParameters
from softarm.reality.plant import refine
from softarm.reality.robot import Robot
from softarm.schemas.model import Arm as ModelArm
from softarm.simulator.simulator import Simulator

BODY = ModelArm()


@pytest.mark.parametrize("pieces", [1, 2, 3, 4])
def test_the_finer_chain_keeps_mass_inertia_and_compliance(pieces: int) -> None:
    chain = refine(BODY, pieces)
    assert len(chain.length_m) == 5 * pieces
    assert chain.length_m.sum() == pytest.approx(sum(BODY.link_length_m))
    assert chain.mass_kg.sum() == pytest.approx(sum(BODY.link_mass_kg))
    # About the base, hanging straight: pieces at their places against whole links at theirs.
    fine_at = np.cumsum(chain.length_m) - chain.length_m / 2
    at = np.cumsum(BODY.link_length_m) - np.array(BODY.link_length_m) / 2
    fine = (chain.inertia_kg_m2 + chain.mass_kg * fine_at**2).sum()
    assert fine == pytest.approx((np.array(BODY.link_inertia_kg_m2) + np.array(BODY.link_mass_kg) * at**2).sum())
    assert (1 / chain.stiffness_nm_rad).sum() == pytest.approx((1 / np.array(BODY.stiffness_nm_rad)).sum())


@pytest.mark.parametrize("pieces", [2, 3])
def test_under_a_pressure_alone_the_angles_and_their_centre_are_the_models(pieces: int) -> None:
    chain = refine(BODY, pieces)
    for fine, model in (
        (chain.muscle_gain_nm_kpa, BODY.muscle_gain_nm_kpa),
        (chain.torque_offset_nm, BODY.torque_offset_nm),
    ):
        bend, whole = fine / chain.stiffness_nm_rad, np.array(model) / BODY.stiffness_nm_rad
        assert bend.sum() == pytest.approx(whole.sum())
        hinge = np.cumsum(chain.length_m) - chain.length_m
        assert (bend * hinge).sum() == pytest.approx((whole * np.arange(5) * BODY.link_length_m[0]).sum())


def test_one_piece_is_the_model_itself() -> None:
    chain = refine(BODY, 1)
    for name, value in BODY:
        if name in chain.__slots__:
            np.testing.assert_allclose(getattr(chain, name), value, rtol=1e-12)
    np.testing.assert_array_equal(chain.share, 1.0)


def test_the_shares_of_fine_joints_form_a_triangle() -> None:
    """With equal springs, the shares are the triangle; the joint at the clamp shares with no other."""
    equal = BODY.model_copy(update={"stiffness_nm_rad": (1.0,) * 5})
    np.testing.assert_allclose(refine(equal, 2).share, [1, 0.25, *[0.5] * 7, 0.25])


@pytest.mark.parametrize("pressure_kpa", [0.0, 20.0])
def test_the_hanging_pose_equals_the_five_link_simulators(pressure_kpa: float) -> None:
    simulator = Simulator(physics_rate_hz=1200.0)
    simulator.step(0.0, pressure_kpa, 8.0)
    robot = Robot(RobotParameters(), held=True)
    robot.command(0.0, 0.0, pressure_kpa)
    robot.advance(8.0)
    truth = robot.truth
    theirs_m = simulator.link_ends_m()[0] - np.array([simulator.cart_position_m[0], 0.0])
    assert 1e3 * np.linalg.norm(truth.link_ends_m - theirs_m, axis=1).max() < 3.5  # measured: 2.8 mm (link 4)
    assert 1e3 * np.linalg.norm(truth.link_ends_m[-1] - theirs_m[-1]) < 2.0  # 1.5 mm
    assert np.degrees(np.abs(truth.link_angles_rad - simulator.link_angles_rad[0])).max() < 1.0  # 0.9


def test_a_joint_without_stiffness_and_pieces_without_inertia_are_refused() -> None:
    with pytest.raises(ValueError, match=r"stiffness_nm_rad is .* a beam needs every entry above 0"):
        refine(ModelArm(stiffness_nm_rad=(0.0, 1.0, 1.0, 1.0, 1.0)), 2)
    with pytest.raises(ValueError, match=r"link_inertia_kg_m2 is .* 2 pieces need more than"):
        Robot(RobotParameters(body=ModelArm(link_inertia_kg_m2=(1e-7,) * 5), arm=Arm(pieces=2)))
