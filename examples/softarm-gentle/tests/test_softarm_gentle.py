"""The task `gentle`: its reward, and a short training whose policy the daemon flies."""

from pathlib import Path

import numpy as np
from softarm.daemon.runtime.offline import Lockstep
from softarm.policies import registry
from softarm.schemas.config import Config, Policy
from softarm.schemas.goals import Goal
from softarm.training.learn.inference import workers
from softarm.training.run.recipe import begin, named, preset
from softarm.training.task.reach import Moment


def reward(apart_m: float, speed_m_s: float, off_rail: bool = False) -> float:
    task = preset("gentle")
    target, tip = np.array([[-0.2, 0.6]], np.float32), np.array([[-0.2 + apart_m, 0.6]], np.float32)
    success = np.array([apart_m < task.success_radius_m and not off_rail])
    speed, cart = np.array([speed_m_s], np.float32), np.zeros(1, np.float32)
    return float(task.reward(Moment(tip, speed, target, cart, success, np.array([off_rail])))[0])


def test_the_reward_is_higher_when_slow_and_near_the_target() -> None:
    assert reward(0.0, 0.0) > reward(0.0, 0.5) > reward(0.0, 2.0) > reward(0.05, 2.0)
    assert reward(0.05, 1.0) < reward(0.3, 1.0) < reward(0.3, 0.0) == 0.0
    assert reward(0.3, 0.0, off_rail=True) < reward(0.05, 2.0)


def test_a_short_training_leaves_a_policy_that_flies(tmp_path: Path) -> None:
    recipe = named("gentle").changed(None, {"run.robots": 16, "run.validation_trials": 12})
    with workers(1) as pool:
        file = begin(recipe, 1, tmp_path, pool, resume=False).run(frames=1024, minutes=None)
    policy = registry.load("trained", {"trained": Policy(plugin="onnx", options={"model": str(file)})})
    flight = Lockstep(Config(), policy).fly(Goal("reach", -0.1, 0.58), cart_start_m=0.1)
    assert flight.stop is None
    assert flight.status.state in ("reached", "failed")
