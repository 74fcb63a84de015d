"""`softarm model`: what is in force, what differs, what is wrong, and the robot as MJCF."""

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from softarm.cli.main import main
from softarm.simulator.effects import REGISTRY


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["model", *map(str, arguments)], prog_name="softarm")


def row(text: str, key: str) -> list[str]:
    line = next(line for line in text.splitlines() if f" {key} " in line)
    return [cell.strip() for cell in line.strip("│ ").split("│")]


def test_show_resolves_defaults_and_names_units_and_sources(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("cart: {mass_kg: 0.6}\neffects:\n  arm.creep: {strength: 0.2}\n  arm.tilt: {angle: 0.0}\n")
    result = run("show", path)
    assert result.exit_code == 0
    assert row(result.stdout, "cart.mass_kg")[:3] == ["cart.mass_kg", "0.6", "kg"]
    creep = {p.name: p for p in REGISTRY["arm.creep"].parameters}
    _, value, unit, allowed, source = row(result.stdout, "arm.creep.time")
    assert (float(value), unit) == (creep["time"].default, "s")
    assert allowed == str(creep["time"])
    assert source == REGISTRY["arm.creep"].source
    assert "rail.delay" not in result.stdout
    assert result.stdout.endswith("arm.tilt is at its neutral value: it changes nothing\n")


def test_show_takes_shipped_names() -> None:
    assert "rail.delay" not in run("show", "no-delay").stdout
    assert row(run("show", "seed").stdout, "rail.delay.delay")[1:3] == ["0.0333333", "s"]
    assert row(run("show", "seed").stdout, "observation.finite_difference")[1] == "on"


def test_diff_shows_what_differs_and_nothing_else(tmp_path: Path) -> None:
    result = run("diff", "seed", "no-delay")
    assert row(result.stdout, "rail.delay.delay") == ["rail.delay.delay", "s", "0.0333333", "absent"]
    assert result.stdout.count("│\n") == 1
    assert run("diff", "seed", "seed").stdout == "no difference\n"
    path = tmp_path / "mine.yaml"
    path.write_text("cart: {mass_kg: 0.40000000001}\n")
    result = run("diff", "seed", path)
    assert row(result.stdout, "cart.mass_kg") == ["cart.mass_kg", "kg", "0.4", "0.40000000001"]


def test_check_passes_the_sound_and_tells_all_that_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("effects:\n  rail.dely: {delay: 0.1}\n  arm.tilt: {angle: 2}\n")
    result = run("check", path)
    assert result.exit_code == 1
    assert result.stdout == ""
    first, second = result.stderr.splitlines()
    assert (
        first == f"{path}:2: effects.rail.dely: unknown effect; did you mean rail.delay? docs/effects.md lists them all"
    )
    assert second.startswith(f"{path}:3: effects.arm.tilt.angle: is 2; allowed -0.2 to 0.2 rad; if you meant 2 degrees")
    result = run("check", "no-pressure-lag")
    assert result.exit_code == 0
    assert result.stdout.startswith("no-pressure-lag: sound; 5 links; effects: rail.acceleration_limit, rail.delay")


def test_unknown_name_is_told_with_the_nearest() -> None:
    result = run("show", "no-dellay")
    assert result.exit_code == 1
    assert result.stderr.startswith("no-dellay: no such file or model; did you mean no-delay?")


def test_export_writes_what_mujoco_loads_and_tells_what_it_lacks(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    out = tmp_path / "arm.xml"
    result = run("export", "--mjcf", out, "seed")
    assert result.exit_code == 0
    assert result.stdout == f"wrote {out}\n"
    assert "left out: rail.delay: " in result.stderr
    assert mujoco.MjModel.from_xml_path(str(out)).nq == 6
    result = run("export", "--mjcf", tmp_path / "no" / "arm.xml", "seed")
    assert result.exit_code == 1
    assert "name a file in an existing folder" in result.stderr


@pytest.mark.parametrize("arguments", [["twin", "--config", "x"], ["evaluate"]])
def test_verbs_that_simulate_take_shipped_names(arguments: list[str], tmp_path: Path) -> None:
    """A wrong name is refused with the list of the right ones, so a right one is looked up."""
    config = tmp_path / "x.yaml"
    config.write_text("control: {policy: hold}\n")
    words = [str(config) if word == "x" else word for word in arguments]
    result = CliRunner().invoke(main, [*words, "--model", "no-dely"])
    assert result.exit_code == 1
    assert "did you mean no-delay?" in result.stderr
