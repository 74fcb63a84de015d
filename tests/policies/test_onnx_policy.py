"""A learned policy flies only if its file is whole, made for this robot, and computes what it once did."""

import hashlib

import numpy as np
import onnxruntime
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from softarm.policies.base import Policy, PolicyError
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.schemas.policy import ACTION, OBSERVATION, REACH_GOAL, Golden


def fly(policy, golden):
    rows = np.array(golden.inputs, dtype=np.float32)
    return np.array([policy.step(row[:8], row[8:]) for row in rows])


def scaled(unit_actions):
    low = np.array([signal.low for signal in ACTION])
    high = np.array([signal.high for signal in ACTION])
    return low + (unit_actions + 1) / 2 * (high - low)


def test_a_step_equals_torch_and_is_scaled_to_units(golden):
    policy = OnnxPolicy("reach")
    assert isinstance(policy, Policy)
    actions = fly(policy, golden)
    np.testing.assert_allclose(actions, scaled(np.array(golden.outputs)), atol=2e-4)
    assert actions.dtype == np.float32
    assert np.ptp(actions, axis=0).min() > 0.1  # or the comparison would say nothing


def test_an_oversized_file_is_not_read(tmp_path):
    with (tmp_path / "large.onnx").open("wb") as file:
        file.truncate(10**12)
    with pytest.raises(PolicyError, match=r"large\.onnx: .* 1000000 MB; allowed are 67"):
        OnnxPolicy(str(tmp_path / "large.onnx"))


def test_describing_a_file_runs_no_network(write_model, monkeypatch):
    """Optimising a graph runs what depends on constants alone, for however long that takes."""
    levels, real = [], onnxruntime.InferenceSession

    def session(content, options, **more):
        levels.append(options.graph_optimization_level)
        return real(content, options, **more)

    monkeypatch.setattr(onnxruntime, "InferenceSession", session)
    path = str(write_model())
    OnnxPolicy.describe(path)
    assert levels == [onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL]
    OnnxPolicy(path)
    assert levels[1:] == [onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL]


def test_invalid_text_in_a_file_is_refused(write_model, capfd):
    path = write_model()
    path.write_bytes(path.read_bytes().replace(b'"unit":"m/s"', b'"unit":"m\xff\xfe"'))
    with pytest.raises(PolicyError, match="not an ONNX model that can be run"):
        OnnxPolicy(str(path))
    path.write_bytes(write_model().read_bytes().replace(b"LSTM", b"LST\xff"))
    with pytest.raises(PolicyError, match="no policy needs"):
        OnnxPolicy(str(path))
    assert capfd.readouterr() == ("", "")


def test_reset_clears_the_recurrent_state(golden):
    policy = OnnxPolicy("reach")
    first, carried_on = fly(policy, golden), fly(policy, golden)
    policy.reset()
    again = fly(policy, golden)
    assert (first == again).all()
    assert (first != carried_on).any()


def test_two_policies_from_one_file_share_no_state_and_no_actions(golden):
    one, other = OnnxPolicy("reach"), OnnxPolicy("reach")
    alone, returned = fly(OnnxPolicy("reach"), golden), []
    for row in np.array(golden.inputs, dtype=np.float32):
        other.step(row[:8] + 1, row[8:])
        returned.append(one.step(row[:8], row[8:]))
    assert (np.array(returned) == alone).all()


def test_the_spec_holds_the_metadata_of_the_file(write_model):
    path = write_model(validation_success=0.97)
    spec = OnnxPolicy(model=str(path)).spec
    assert spec == OnnxPolicy.describe(model=str(path))
    assert spec.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert spec.trained is not None
    assert spec.trained.target_z_m == (0.55, 0.7)
    assert spec.episode_steps == 100
    assert "y -0.4 .. 0" in spec.description
    assert "97%" in spec.description


def test_a_replaced_file_is_read_again(write_model):
    path = write_model()
    before = OnnxPolicy.describe(model=str(path))
    write_model(validation_success=0.5)
    after = OnnxPolicy.describe(model=str(path))
    assert "50%" in after.description
    assert before.sha256 != after.sha256


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.floats(-1e3, 1e3, width=32), min_size=10, max_size=10))
def test_actions_are_within_the_ranges_for_any_observation(tmp_path, write_model, values):
    path = tmp_path / "small.onnx"
    policy = OnnxPolicy(model=str(path if path.exists() else write_model()))
    row = np.array(values, dtype=np.float32)
    velocity, pressure = policy.step(row[:8], row[8:])
    assert -1.0 <= velocity <= 1.0
    assert -0.7 - 1e-6 <= pressure <= 20.0 + 1e-5


def test_a_narrower_action_range_is_respected(write_model, golden):
    narrow = (ACTION[0].model_copy(update={"low": -0.5, "high": 0.25}), ACTION[1])
    policy = OnnxPolicy(model=str(write_model(action=narrow)))
    expected = -0.5 + (np.array(golden.outputs)[:, 0] + 1) / 2 * 0.75
    np.testing.assert_allclose(fly(policy, golden)[:, 0], expected, atol=1e-4)


def swapped(signals, i, j):
    signals = list(signals)
    signals[i], signals[j] = signals[j], signals[i]
    return tuple(signals)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"metadata": None}, "no metadata under the key 'softarm'"),
        ({"format": 2}, "its metadata has format 2, this software reads 1"),
        ({"task": "juggle"}, "task: Input should be 'reach'"),
        ({"rate_hz": 60.0}, "rate_hz is 60; the control loop runs at 30"),
        ({"observation": swapped(OBSERVATION, 2, 3)}, "observation 2 is tip_z in m, not tip_y in m"),
        ({"observation": OBSERVATION[:-1]}, "observation has 7 elements, not 8"),
        (
            {"observation": (*OBSERVATION[:7], OBSERVATION[7].model_copy(update={"unit": "psi"}))},
            "observation 7 is pressure in psi, not pressure in kPa",
        ),
        ({"goal": swapped(REACH_GOAL, 0, 1)}, "goal 0 is target_z in m, not target_y in m"),
        ({"action": swapped(ACTION, 0, 1)}, "action 0 is pressure in kPa, not cart_velocity in m/s"),
        (
            {"action": (ACTION[0].model_copy(update={"high": 2.0}), ACTION[1])},
            r"maps to -1 .. 2 m/s; allowed within -1 .. 1",
        ),
        ({"action": (ACTION[0].model_copy(update={"low": None}), ACTION[1])}, "lacks low and high"),
        ({"state_size": 5}, r"its inputs are .* they must be .*\[1, 1, 5\]"),
        ({"drop_output": "c_out"}, "its outputs are .* they must be .*c_out"),
        ({"golden": Golden(inputs=((0.0,) * 10,), outputs=())}, "golden has 1 inputs and 0 outputs"),
        ({"golden": Golden(inputs=((0.0,) * 9,), outputs=((0.0, 0.0),))}, "golden rows must be 10 inputs"),
        (
            {"golden": Golden(inputs=((0.0,) * 10,), outputs=((0.9, -0.9),))},
            r"golden run is off by .* at step 0; allowed 0.0001",
        ),
    ],
)
def test_a_file_for_another_robot_is_refused_with_the_reason(write_model, changes, message):
    path = write_model(**changes)
    with pytest.raises(PolicyError, match=message) as refusal:
        OnnxPolicy(model=str(path))
    assert str(path) in str(refusal.value)


def test_all_problems_of_the_metadata_are_reported_together(write_model):
    with pytest.raises(PolicyError, match=r"goal 0 .*goal 1 .*rate_hz"):
        OnnxPolicy(model=str(write_model(goal=swapped(REACH_GOAL, 0, 1), rate_hz=60.0)))


@pytest.mark.parametrize("content", [b"", b"not a model", b"\x08\x09" * 50])
def test_a_file_without_a_model_is_refused(tmp_path, content):
    path = tmp_path / "broken.onnx"
    path.write_bytes(content)
    with pytest.raises(PolicyError, match=r"broken\.onnx: not an ONNX model that can be run"):
        OnnxPolicy(model=str(path))


@pytest.mark.parametrize("name", ["nowhere.onnx", "no-such-name", "x" * 300 + ".onnx"])
def test_a_missing_file_is_named_with_a_remedy(name):
    """No file system holds the longest name."""
    with pytest.raises(
        PolicyError, match=rf"no file .*{name}.*; give a path that ends in \.onnx or the name of a shipped"
    ):
        OnnxPolicy(model=name)


def test_a_reaching_policy_ignores_the_depth():
    plain, deep = OnnxPolicy("reach"), OnnxPolicy("reach")
    deep.target_depth_m = 0.3
    observation, goal = np.zeros(8, np.float32), np.array((-0.2, 0.6), np.float32)
    assert (plain.step(observation, goal) == deep.step(observation, goal)).all()
