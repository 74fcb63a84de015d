"""`softarm twin --reality`: what it says when it cannot be."""

import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from softarm.cli.main import main

CONFIG = str(Path(__file__).parents[2] / "twin.yaml")


def test_without_mujoco_it_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("softarm.drivers.bodies.independent", "softarm.reality.robot", "softarm.reality.plant"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    answer = CliRunner().invoke(main, ["twin", "--config", CONFIG, "--reality"])
    assert answer.exit_code == 1
    assert "pip install 'softarm[mujoco]'" in answer.output


def test_a_model_of_other_links_is_refused(tmp_path: Path) -> None:
    lists = ("link_length_m", "link_mass_kg", "link_inertia_kg_m2", "stiffness_nm_rad", "damping_nm_s_rad")
    short = "".join(f"  {name}: [0.01, 0.01]\n" for name in (*lists, "muscle_gain_nm_kpa", "torque_offset_nm"))
    model = tmp_path / "short.yaml"
    model.write_text("arm:\n" + short)
    answer = CliRunner().invoke(main, ["twin", "--config", CONFIG, "--model", str(model), "--reality"])
    assert answer.exit_code == 1
    assert "has 2 links; the daemon flies an arm of 5" in answer.output


@pytest.mark.parametrize(
    ("arguments", "says", "code"),
    [
        (("--fault", "rail.delay_s=0.09"), "--fault is for the independent robot: add --reality", 2),
        (("--reality", "--fault", "rail.delay=0.09"), "allowed here: acceleration_m_s2", 1),
    ],
)
def test_a_fault_is_the_independent_robots_and_one_that_there_is(
    arguments: tuple[str, ...], says: str, code: int
) -> None:
    answer = CliRunner().invoke(main, ["twin", "--config", CONFIG, *arguments])
    assert answer.exit_code == code
    assert says in " ".join(answer.output.split())
