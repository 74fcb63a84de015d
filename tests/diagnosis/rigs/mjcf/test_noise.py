"""Noise of joints that motion capture measures: averages over samples, and noise that several angles share."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softarm.diagnosis.data import tables
from softarm.diagnosis.rigs.diagnose import diagnose_table
from softarm.diagnosis.rigs.mjcf.noise import averaged, correlations, drawn, samples_averaged
from softarm.simulator import mjcf, model_file
from tests.diagnosis.rigs.recordings import described, described_model, rms, simulate, view_of_joint

LINKS = ("link2", "link3", "link4", "link5")


@pytest.mark.parametrize(
    ("noise_share", "period_s", "samples"),
    [(0.0, 2.0, 1), (0.004, 2.0, 1), (0.02, 2.0, 4), (0.03, 2.0, 9), (0.5, 2.0, 10), (0.5, 0.1, 1)],
)
def test_noisy_motion_is_averaged_up_to_a_twentieth_of_its_period(noise_share, period_s, samples):
    assert samples_averaged(noise_share, period_s, step_s=0.01) == samples


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 12), st.lists(st.integers(0, 39), max_size=30), st.floats(-5.0, 5.0))
def test_an_average_keeps_constants_gaps_and_trials_apart(samples, gaps, level):
    values = np.concatenate((np.full(20, level), np.full(20, level + 1.0)))[None]
    values[0, gaps] = np.nan
    expected = values.copy()
    found = averaged(values, [slice(0, 20), slice(20, 40)], samples)
    assert np.allclose(found, expected, equal_nan=True)


def test_an_average_of_nine_samples_has_a_third_of_their_noise():
    values = np.random.default_rng(1).normal(size=(2, 9000))
    assert averaged(values, [slice(0, 9000)], 9).std() == pytest.approx(1 / 3, rel=0.1)


def test_noise_that_readings_share_is_drawn_together():
    """Two angles between three links: the middle link's noise is in both, with opposite signs."""
    random = np.random.default_rng(5)
    links = 0.01 * random.normal(size=(3, 4000))
    smooth = np.sin(0.01 * np.arange(4000))
    other, own = smooth + links[1] - links[0], smooth + links[2] - links[1]
    ((noise,), shared) = drawn([other, own], correlations([[other, own]]), random)
    assert noise.std() == pytest.approx(0.01 * np.sqrt(2), rel=0.1)
    assert shared.std() == pytest.approx(0.5 * 0.01 * np.sqrt(2), rel=0.15)
    assert np.corrcoef(noise, shared)[0, 1] == pytest.approx(-1.0)


def test_independent_readings_share_no_noise():
    random = np.random.default_rng(5)
    readings = 0.01 * random.normal(size=(2, 4000))
    (_, shared) = drawn(readings, correlations([readings]), random)
    assert not shared.any()


def test_chance_in_short_stretches_is_no_correlation():
    """Every second set of six readings with 150 samples has a correlation above 0.3 by chance."""
    random = np.random.default_rng(5)
    for _ in range(40):
        assert np.array_equal(correlations([random.normal(size=(6, 150))]), np.eye(6))


def test_motion_that_is_fast_beside_the_samples_is_no_noise():
    """Both joints swing at 3 Hz with fine encoders and 20 samples a second."""
    random, t = np.random.default_rng(5), np.arange(2000) / 20
    readings = np.sin(6 * np.pi * t + 0.3 * np.sin(t)) + 1e-6 * random.normal(size=(2, 2000))
    assert np.array_equal(correlations([readings]), np.eye(2))


def tracked_arm(folder, noise_m, gain=1.0, trials=2, seconds=10.0):
    """Record the exported soft arm with another gain of its muscle, as points on its links, and describe it."""
    text = mjcf.export(model_file.load("seed")).xml
    (folder / "arm.xml").write_text(text)
    robot = mujoco.MjModel.from_xml_string(text)
    robot.actuator("pressure").gainprm[0] *= gain
    per_tick = round(0.01 / robot.opt.timestep)
    bodies = ["cart", *LINKS]
    names = [f"{point}_{axis}" for point in (*bodies, "tip") for axis in "xz"]
    for number in range(trials):
        data, random, rows = mujoco.MjData(robot), np.random.default_rng(number), []
        turns, hertz = random.uniform(0, 6, (2, 5)), np.geomspace(0.15, 1.6, 5)
        for k in range(int(100 * seconds) + 200):
            t = 0.01 * k
            cart, pressure = np.sin(2 * np.pi * hertz * t + turns).sum(axis=1)
            data.ctrl[:] = 0.12 * cart, np.clip(9 + 3.5 * pressure, 0.0, 20.0)
            if k >= 200:
                mujoco.mj_kinematics(robot, data)
                points = [*(data.body(body).xpos for body in bodies), data.site("tip").xpos]
                seen = [x for point in points for x in (point + noise_m * random.normal(size=3))[[0, 2]]]
                rows.append((t, *data.ctrl, *seen))
            mujoco.mj_step(robot, data, nstep=per_tick)
        header = ",".join(("t", "cart_velocity", "pressure", *names))
        np.savetxt(folder / f"run-{number}.csv", rows, "%.6f", ",", header=header, comments="")
    commands = {"cart_velocity": "m/s", "pressure": "1"}
    return described(folder, "arm.xml", mocap=dict.fromkeys(names, "m"), command=commands)


@pytest.mark.parametrize("noise_m", [pytest.param(2e-5, marks=pytest.mark.prove), 1e-4])
def test_the_floor_of_a_tracked_joint_holds_the_noise_that_its_angle_shares(tmp_path, noise_m):
    """With 0.1 mm, independent noise of six angles would be twice as large."""
    view = view_of_joint(tracked_arm(tmp_path, noise_m, trials=1, seconds=6.0), "joint3")
    assert 0.75 * rms(view) < view.floor[0] < 1.3 * rms(view)


PENDULUM = """<mujoco><option timestep="0.001"/><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.05"/>
<inertial pos="0 0 -0.2" mass="1" diaginertia="0.002 0.002 0.002"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""


def test_averages_do_not_remove_the_rounding_of_a_coarse_encoder(tmp_path):
    """The step is a tenth of the motion, and many samples rest on it."""
    step, k = 0.02, np.arange(800)
    torques = 0.3 * np.sin(0.02 * k) + 0.2 * np.sin(0.035 * k)
    simulate(PENDULUM, tmp_path / "run-0.csv", torques, read=lambda positions: step * np.round(positions / step))
    view = view_of_joint(described_model(tmp_path, PENDULUM, "N m"), "hinge")
    assert view.floor[0] > 0.9 * step / np.sqrt(12)


@pytest.mark.prove
def test_a_weak_muscle_shows_through_a_tenth_of_a_millimetre_of_noise(tmp_path):
    verdict = diagnose_table(tables.read(tracked_arm(tmp_path, 1e-4, gain=0.85))).verdict
    assert verdict.verdict == "named"
    assert {effect.name.partition(".")[2] for effect in verdict.effects} == {"gain"}
    for effect in verdict.effects:
        assert effect.parameters["scale"].low <= -0.15 <= effect.parameters["scale"].high


@pytest.mark.prove
def test_a_healthy_arm_has_no_gap_beside_that_noise(tmp_path):
    assert diagnose_table(tables.read(tracked_arm(tmp_path, 1e-4))).verdict.verdict == "none"
