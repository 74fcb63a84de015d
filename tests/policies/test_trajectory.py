"""The tracking policy adds the seed's feedback to a plan, holds its end, and refuses what it has no plan for."""

import contextlib
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from softarm.daemon.runtime.offline import Lockstep
from softarm.policies import trial
from softarm.policies.base import MODELS, Policy, PolicyError
from softarm.policies.plans import Plans
from softarm.policies.runner import InlineRunner
from softarm.policies.trajectory import Trajectory
from softarm.schemas.config import Config
from softarm.schemas.flights import CART_STARTS_M, TEST_TARGETS
from softarm.schemas.goals import Goal

GOAL = np.array([-0.2, 0.6], dtype=np.float32)
STEPS = 5


def made_up() -> Plans:
    """Two starts to one target, one to another; commands and tips that are easily reported apart."""
    command = np.zeros((3, 8, 2), dtype=np.float32)
    command[..., 0] = 0.01 * np.arange(8) + 0.1 * np.arange(3)[:, None]
    command[..., 1] = 5.0 + np.arange(8)
    tip = np.zeros((3, 9, 2), dtype=np.float32)
    tip[..., 0] = -0.01 * np.arange(9)
    tip[..., 1] = 0.52 + 0.005 * np.arange(9)
    tip[1, :, 0] += 0.1
    return Plans(
        target_m=np.array([[-0.2, 0.6], [-0.2, 0.6], [-0.3, 0.6]], dtype=np.float32),
        cart_start_m=np.array([0.0, 0.1, 0.0], dtype=np.float32),
        steps=np.array([STEPS, 7, 6]),
        miss_m=np.zeros(3, dtype=np.float32),
        command=command,
        tip_m=tip,
    )


@pytest.fixture
def file(tmp_path):
    made_up().save(tmp_path / "plans.npz")
    return tmp_path / "plans.npz"


def seen(cart=0.0, tip=(0.0, 0.52)):
    return np.array([cart, 0, *tip, 0, 0, 0, 0], dtype=np.float32)


def test_plans_to_any_targets_pass_the_trial_of_the_daemon(tmp_path):
    """The trial flies to one fixed target, for which they have no plan."""
    plans = made_up()
    replace(plans, target_m=plans.target_m + 0.1).save(tmp_path / "mine.npz")
    trial.ready(Trajectory(str(tmp_path / "mine.npz")))


def test_on_its_reference_the_plan_is_played_then_held_then_rests(file):
    policy = Trajectory(str(file), extension_steps=2)
    assert isinstance(policy, Policy)
    plans, played = made_up(), []
    for k in range(STEPS + 4):
        played.append(policy.step(seen(tip=plans.tip_m[0, min(k, STEPS)]), GOAL))
    played = np.array(played)
    np.testing.assert_allclose(played[:STEPS], plans.command[0, :STEPS], atol=1e-6)
    last = plans.command[0, STEPS - 1]
    np.testing.assert_allclose(played[STEPS : STEPS + 2], [last, last], atol=1e-6)
    np.testing.assert_allclose(played[STEPS + 2 :], [(0.0, last[1])] * 2, atol=1e-6)


def test_the_feedback_has_the_seeds_gains(file):
    """[P] (5a, 5b): 0.1 of the tip's error along y, 5 of that along z, by which the tip lags its reference."""
    off = np.array([0.01, -0.02], dtype=np.float32)
    plans = made_up()
    action = Trajectory(str(file)).step(seen(tip=plans.tip_m[0, 0] + off), GOAL)
    np.testing.assert_allclose(action - plans.command[0, 0], (-0.1 * 0.01, 5.0 * 0.02), atol=1e-6)


def test_commands_stay_within_the_actuators_ranges(file):
    policy = Trajectory(str(file), k_y=100.0, k_z=5000.0)
    np.testing.assert_allclose(policy.step(seen(tip=(0.02, 0.50)), GOAL), (-1.0, 20.0), atol=1e-6)


def test_the_plan_from_the_nearest_start_is_chosen_after_each_reset(file):
    policy = Trajectory(str(file), k_y=0.0, k_z=0.0)
    assert policy.step(seen(), GOAL)[0] == pytest.approx(0.0)
    policy.reset()
    assert policy.step(seen(0.095, (0.095, 0.52)), GOAL)[0] == pytest.approx(0.1)
    policy.reset()
    assert policy.step(seen(), np.array([-0.304, 0.6], dtype=np.float32))[0] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("goal", "observation", "said"),
    [
        ((-0.2, 0.62), seen(), r"\(-0.200, 0.620\) m: .*2 targets.*y -0.30..-0.20, z 0.60..0.60 .*2.0 cm off"),
        ((np.nan, np.nan), seen(), "no plan for the target"),
        ((-0.2, 0.6), seen(cart=0.05), r"cart at 0.00, 0.10 m; .*5.0 cm .*softarm dev plan --start"),
        ((-0.2, 0.6), seen(tip=(-0.05, 0.52)), "the tip 5.0 cm off"),
    ],
)
def test_a_target_without_a_plan_is_refused(file, goal, observation, said):
    policy = Trajectory(str(file))
    with pytest.raises(PolicyError, match=said):
        policy.step(observation, np.array(goal, dtype=np.float32))
    fault = InlineRunner(policy).step(observation, np.array(goal, dtype=np.float32)).fault
    assert fault is not None
    assert "softarm dev plan" in fault


@pytest.mark.parametrize("name", ["k_y", "k_z", "extension_steps"])
def test_an_invalid_gain_is_refused(file, name):
    for bad in (-1.0, np.inf):
        with pytest.raises(PolicyError, match=name):
            Trajectory(str(file), **{name: bad})


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"tip_m": None}, "lacks tip_m"),
        ({"format": 2}, "format 2 at 30 Hz"),
        ({"rate_hz": 60}, "at 60 Hz"),
        ({"steps": np.array([5, 9, 6])}, r"steps lie in 5 .. 9; allowed 1 .. 8"),
        ({"steps": np.array([5, 6])}, "does not fit 2 plans"),
        ({"command": np.full((3, 8, 2), np.nan)}, "command holds NaN or infinity"),
        ({"command": np.zeros((3, 9, 2))}, "do not belong together"),
        ({"steps": np.float64(5)}, "does not fit 1 plans"),
        ({"format": np.array([1, 1])}, "has format"),
        ({"miss_m": np.array(["a", "b", "c"])}, "miss_m holds NaN or infinity"),
    ],
)
def test_an_invalid_file_of_plans_is_refused(file, changed, said):
    with np.load(file) as opened:
        content = {name: opened[name] for name in opened.files}
    np.savez(file, **{name: value for name, value in (content | changed).items() if value is not None})
    with pytest.raises(PolicyError, match=said) as refused:
        Trajectory(str(file))
    assert "softarm dev plan" in str(refused.value)


@pytest.mark.parametrize(("name", "content"), [("steps.npy", b"no array"), ("more.npy", bytes(200_000))])
def test_a_file_with_an_invalid_or_oversized_member_is_refused(file, name, content, monkeypatch):
    monkeypatch.setattr("softarm.policies.plans.SIZE_MAX", 100_000)
    with zipfile.ZipFile(file) as archive:
        members = {each: archive.read(each) for each in archive.namelist()}
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, data in (members | {name: content}).items():
            archive.writestr(each, data)
    with pytest.raises(PolicyError, match="softarm dev plan"):
        Trajectory(str(file))


def test_a_file_with_one_changed_byte_is_refused_or_flown(file):
    data = file.read_bytes()
    for at in range(0, len(data), len(data) // 100 + 1):
        file.write_bytes(data[:at] + bytes([data[at] ^ 0x90]) + data[at + 1 :])
        with contextlib.suppress(PolicyError):
            Trajectory(str(file))


def test_a_missing_file_is_refused(tmp_path):
    (tmp_path / "empty.npz").write_bytes(b"PK no")
    for name, said in (("none.npz", "no file"), ("empty.npz", "not a file of plans")):
        with pytest.raises(PolicyError, match=said):
            Trajectory(str(tmp_path / name))


def test_saved_plans_are_loaded_unchanged(file):
    loaded, saved = Plans.load(file), made_up()
    for name in ("target_m", "cart_start_m", "steps", "command", "tip_m"):
        np.testing.assert_allclose(getattr(loaded, name), getattr(saved, name), atol=1e-5)


def test_the_spec_is_read_from_the_file(file):
    spec = Trajectory.describe(str(file))
    assert spec == Trajectory(str(file)).spec
    assert spec.episode_steps == 7 + 3
    assert spec.trained.target_y_m == pytest.approx((-0.3, -0.2))
    assert "3 planned trajectories" in spec.description


def test_the_shipped_plans_cover_the_papers_targets_and_reach_them_through_the_daemon():
    """Every target from every start is planned; a few are flown, among them the swings that are hardest."""
    plans = Plans.load(MODELS / "trajectories.npz")
    pairs = zip(plans.target_m.tolist(), plans.cart_start_m.tolist(), strict=True)
    planned = {tuple(round(number, 2) for number in (*target, start)) for target, start in pairs}
    assert planned == {(goal.y_m, goal.z_m, start) for goal in TEST_TARGETS for start in CART_STARTS_M}
    assert (plans.miss_m < 0.04).sum() >= 8 / 9 * len(plans.steps)
    daemon = Lockstep(Config(), Trajectory())
    for y, z, start in ((-0.4, 0.8, 0.0), (-0.15, 0.75, 0.2), (-0.25, 0.7, 0.1), (-0.1, 0.55, 0.0)):
        flight = daemon.fly(Goal("reach", y, z), start)
        assert flight.status.state == "reached", (y, z, flight.status.reason)
        assert flight.max_cart_m <= 0.25
