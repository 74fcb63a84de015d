"""The script of examples/gymnasium trains on the environments, and its policy flies."""

import sys
from pathlib import Path

import pytest

from softarm.daemon.runtime.offline import Lockstep
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.training.record import foreign

STEPS = 32 * 4096
FEW_STEPS = 4096  # one iteration
TARGETS = [Goal("reach", y, z) for y, z in ((-0.35, 0.6), (-0.25, 0.62), (-0.15, 0.58), (-0.2, 0.65))]

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _scripts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "examples" / "gymnasium"))
    for name in ("speed", "train_sb3"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(foreign, "VALIDATION_TRIALS", 12)


def reached(file: Path) -> int:
    """Count the targets that a policy reaches in the real control loop."""
    flown = Lockstep(Config(), OnnxPolicy(str(file)))
    return sum(flown.fly(target, cart_start_m=0.1).reached for target in TARGETS)


def test_the_script_trains_and_exports_for_a_few_steps(tmp_path: Path) -> None:
    import train_sb3

    model, envs, _, _ = train_sb3.train(FEW_STEPS)
    train_sb3.export(model, envs, tmp_path / "mine.onnx")
    assert OnnxPolicy(str(tmp_path / "mine.onnx")).metadata.task == "reach"


@pytest.mark.prove
def test_the_script_learns_to_reach_and_its_network_flies(tmp_path: Path) -> None:
    import train_sb3

    file = tmp_path / "mine.onnx"
    model, envs, before, after = train_sb3.train(STEPS)
    assert before.reached < 0.1
    assert after.reached > 0.5
    assert after.mean_return > before.mean_return + 4.0
    assert train_sb3.export(model, envs, file) > 0.3
    assert reached(file) >= 1


def test_the_speed_script_counts_steps() -> None:
    import speed

    assert speed.steps_per_s("vector_entry_point", 4, 0.05) > 0
    assert speed.steps_per_s("sync", 4, 0.05) > 0
