"""The MJCF export: MuJoCo loads it with the model's masses and springs, and it moves alike."""

import mujoco
import numpy as np
import pytest

from softarm.schemas.model import Arm, Model
from softarm.simulator import effects
from softarm.simulator.effects import REGISTRY
from softarm.simulator.mjcf import export
from softarm.simulator.simulator import Simulator

STRONG = effects.exemplars()


def loaded(model: Model):  # type: ignore[no-untyped-def]
    physics = mujoco.MjModel.from_xml_string(export(model).xml)
    return physics, mujoco.MjData(physics)


@pytest.mark.parametrize("links", [1, 5, 12])
def test_masses_inertias_springs_and_the_hanging_tip(links: int) -> None:
    share = np.linspace(1.4, 0.6, links)
    share /= share.sum()
    arm = Arm(
        link_length_m=tuple(0.44 * share),
        link_mass_kg=tuple(0.12 * share),
        link_inertia_kg_m2=tuple(2e-5 * share),
        stiffness_nm_rad=tuple(2.0 * share),
        damping_nm_s_rad=tuple(0.1 * share),
        muscle_gain_nm_kpa=tuple(0.01 * share),
        torque_offset_nm=(0.0,) * links,
    )
    physics, data = loaded(Model(arm=arm, effects={}))
    mujoco.mj_forward(physics, data)
    assert physics.nq == links + 1
    assert physics.body_mass.sum() == pytest.approx(0.4 + 0.12)
    np.testing.assert_allclose(physics.body_mass[2:], arm.link_mass_kg)
    np.testing.assert_allclose(physics.body_inertia[2:, 1], arm.link_inertia_kg_m2)
    np.testing.assert_allclose(physics.jnt_stiffness[1:], arm.stiffness_nm_rad)
    np.testing.assert_allclose(physics.dof_damping[1:], arm.damping_nm_s_rad)
    np.testing.assert_allclose(data.site("tip").xpos, [0.0, 0.0, 0.965 - 0.44], atol=1e-12)


@pytest.mark.parametrize(
    "chosen",
    [
        {},
        {name: STRONG[name] for name in ("arm.payload", "arm.tilt")},
        {name: STRONG[name] for name in ("arm.stiffness", "arm.muscle_gain", "arm.torque_offset", "pressure.gain")},
        {name: STRONG[name] for name in ("pressure.ceiling", "arm.damping", "pressure.lag")},
    ],
    ids=lambda chosen: " ".join(chosen) or "none",
)
def test_resting_shape_balances_the_joints(chosen: dict[str, dict[str, float]]) -> None:
    """Spring, muscle, offset and weight cancel in every joint: statics, written out link by link."""
    model = Model(effects=chosen)
    arm, command = model.arm, 15.0
    physics, data = loaded(model)
    data.ctrl[1] = command
    physics.opt.timestep = 0.005
    physics.dof_damping[:] *= 5.0  # sooner at rest
    physics.jnt_limited[0] = False
    physics.dof_armature[0] = 1e6  # a tilted rail lets the cart go; here it stays
    mujoco.mj_step(physics, data, 4000)
    assert np.abs(data.qvel[1:]).max() < 1e-4

    def given(path: str) -> float:
        name, _, parameter = path.rpartition(".")
        return effects.value(model, name, parameter)

    joints = data.qpos[1:]
    pressure = min(
        command * (1 + given("pressure.gain.scale")) + given("pressure.gain.offset"), given("pressure.ceiling.limit")
    )
    held = -(1 + given("arm.stiffness.scale")) * np.array(arm.stiffness_nm_rad) * joints
    held -= (1 + given("arm.muscle_gain.scale")) * np.array(arm.muscle_gain_nm_kpa) * pressure
    held -= (1 + given("arm.torque_offset.scale")) * np.array(arm.torque_offset_nm)
    angle, length = np.cumsum(joints), np.array(arm.link_length_m)
    mass = np.array(arm.link_mass_kg)
    beyond = np.cumsum(mass[::-1])[::-1] - mass + given("arm.payload.mass")
    lever = length * (mass / 2 + beyond) * arm.gravity_m_s2
    weight = np.cumsum((lever * np.sin(angle + given("arm.tilt.angle")))[::-1])[::-1]
    np.testing.assert_allclose(held, weight, atol=2e-5)
    assert np.abs(joints).max() > 0.05


@pytest.mark.parametrize("motor", [{}, {"rail.force_limit": {"force": 1.2}}], ids=["any force", "1.2 N"])
def test_flies_as_the_simulator_does(motor: dict[str, dict[str, float]]) -> None:
    """Two seconds of what both have in full: tip within 2 mm, on a swing of more than 15 cm."""
    chosen = {"pressure.lag": {"inflate": 0.2, "deflate": 0.2}, "arm.tilt": {"angle": 0.02}, "rail.lag": {"time": 0.04}}
    chosen |= motor | {name: STRONG[name] for name in ("arm.payload", "rail.gain", "pressure.gain")}
    model = Model(effects=chosen)
    assert not export(model).left_out
    physics, data = loaded(model)
    simulator = Simulator(model, physics_rate_hz=1200.0)
    # Not the same to the last digit: MuJoCo's muscle starts at the regulator's offset, the simulator's at zero.
    tips = []
    for velocity, pressure in ((0.3, 12.0), (-0.4, 4.0), (0.2, 18.0), (0.0, 0.0)):
        data.ctrl[:] = velocity, pressure
        mujoco.mj_step(physics, data, 600)
        mujoco.mj_kinematics(physics, data)
        simulator.step(velocity, pressure, 0.5)
        y, _, z = data.site("tip").xpos
        tips.append((y, z))
        np.testing.assert_allclose(simulator.tip_m()[0], (y, z), atol=2e-3)
    assert np.ptp(np.array(tips)[:, 0]) > 0.15


def test_everything_at_once_loads_and_moves() -> None:
    physics, data = loaded(Model(effects=STRONG))
    data.ctrl[:] = 0.5, 15.0
    mujoco.mj_step(physics, data, 600)
    assert np.isfinite(data.qpos).all()
    assert data.qpos[0] > 0.02


def test_every_omitted_effect_is_listed_and_commented() -> None:
    """Every effect of the registry changes the file or is listed as omitted."""
    plain = export(Model(effects={}))
    assert not plain.left_out
    for name in REGISTRY:
        exported = export(Model(effects={name: STRONG[name]}))
        listed = [sentence for sentence in exported.left_out if sentence.startswith(f"{name}: ")]
        body = exported.xml.splitlines()
        changed = [line for line in body if "<!--" not in line] != plain.xml.splitlines()
        assert changed or listed, name
        assert all(f"<!-- Left out: {sentence} -->" in exported.xml for sentence in listed)
    assert export(Model(effects={"pressure.lag": {"inflate": 0.2, "deflate": 0.2}})).left_out == ()


def test_an_offset_without_a_spring_is_omitted_and_listed() -> None:
    exported = export(Model(arm=Arm(stiffness_nm_rad=(0.0, 1.0, 1.0, 1.0, 1.0)), effects={}))
    assert exported.left_out == ("arm.torque_offset_nm[0]: it is the rest angle of a spring, and this joint has none",)


def test_unknown_effects_are_rejected() -> None:
    with pytest.raises(effects.EffectError, match=r"did you mean arm.tilt\?"):
        export(Model(effects={"arm.tlt": {}}))
