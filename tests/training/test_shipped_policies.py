"""The shipped files are what the presets train, and they fly."""

import numpy as np
import onnxruntime
import pytest

from softarm.policies.base import MODELS
from softarm.schemas.model import Model
from softarm.schemas.policy import METADATA_KEY, PolicyMetadata
from softarm.training.learn.validation import fly_actions, validation_scenarios
from softarm.training.run.recipe import PRESETS
from softarm.training.task.reach import ReachTask

pytestmark = pytest.mark.slow


def shipped(name: str) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(str(MODELS / f"{name}.onnx"))


def reached_in_range(policy: onnxruntime.InferenceSession, task: ReachTask, model: Model | None = None) -> float:
    """Share of random targets of the task's training range."""
    trials = validation_scenarios(task, 5, 48)
    h = c = np.zeros((1, 48, policy.get_inputs()[1].shape[2]), dtype=np.float32)

    def act(observation: np.ndarray, flying: np.ndarray) -> np.ndarray:
        nonlocal h, c
        action, h, c = policy.run(None, {"observation": observation, "h_in": h, "c_in": c})
        return action

    # The first two thirds lie in the range.
    return float(fly_actions(act, task, trials, model=model).reached[:32].mean())


@pytest.mark.parametrize("name", ["reach", "reach-wide", "reach-robust", "shelf"])
def test_a_shipped_policy_has_the_training_range_of_its_preset(name):
    described = PolicyMetadata.model_validate_json(shipped(name).get_modelmeta().custom_metadata_map[METADATA_KEY])
    task = PRESETS[name]
    assert described.name == name
    assert described.trained.target_y_m == task.target_y_m
    assert described.trained.target_z_m == task.target_z_m
    assert described.trained.cart_start_m == task.cart_start_m


# `reach` and `reach-wide` fly in tests/evaluation/test_evaluation.py.
@pytest.mark.parametrize(("name", "least"), [("reach-robust", 0.80), ("shelf", 0.92)])
def test_a_shipped_policy_reaches_random_targets_of_its_training_range(name, least):
    assert reached_in_range(shipped(name), PRESETS[name]) >= least


@pytest.mark.prove
def test_the_robust_policy_flies_a_late_and_weak_rail_on_which_others_fail():
    rail = {"rail.delay": {"delay": 0.09}, "rail.acceleration_limit": {"acceleration": 2.5}}
    late = Model(effects=Model().effects | rail)
    task = PRESETS["reach-wide"]
    names = ("reach-robust", "reach-wide", "reach")
    robust, wide, reach = (reached_in_range(shipped(name), task, late) for name in names)
    assert robust > max(wide, reach) + 0.2
