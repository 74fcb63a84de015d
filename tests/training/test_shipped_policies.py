"""The shipped files are what the presets train, and they fly."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

import policies
from schemas.policy import METADATA_KEY, PolicyMetadata
from training.evaluation import validation_trials
from training.recipe import PRESETS
from training.shelf import environment_of

MODELS = Path(policies.__file__).parent / "models"


@pytest.mark.parametrize(("name", "least"), [("reach", 0.95), ("reach-wide", 0.80), ("shelf", 0.92)])
def test_a_shipped_policy_reaches_random_targets_of_its_training_range(name, least):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    policy = onnxruntime.InferenceSession(str(MODELS / f"{name}.onnx"), options)
    described = PolicyMetadata.model_validate_json(policy.get_modelmeta().custom_metadata_map[METADATA_KEY])
    task = replace(PRESETS[name], action_noise=0.0)
    assert described.name == name
    assert described.trained.target_y_m == task.target_y_m
    assert described.trained.target_z_m == task.target_z_m
    assert described.trained.cart_start_m == task.cart_start_m

    trials, count = validation_trials(task, 5, 384), 256  # the first two thirds lie in the range
    environment = environment_of(task, 384, 0)
    observation = trials.begin(environment)
    h = c = np.zeros((1, 384, described.state_size), dtype=np.float32)
    reached, alive = np.zeros(384, dtype=np.bool_), np.ones(384, dtype=np.bool_)
    for _ in range(task.episode_steps):
        action, h, c = policy.run(None, {"observation": observation, "h_in": h, "c_in": c})
        step = environment.step(action)
        reached |= alive & step.success
        alive &= ~(step.terminated | step.truncated)
        observation = step.observation
    assert reached[:count].mean() >= least
