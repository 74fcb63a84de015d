"""Tests of `softarm model`."""

from pathlib import Path

import pytest
from click.testing import Result

from softarm.simulator.effects import REGISTRY
from tests.cli.invoke import invoke, succeed


def run(*arguments: object) -> Result:
    return succeed("model", *arguments)


def row(text: str, key: str) -> list[str]:
    line = next(line for line in text.splitlines() if f" {key} " in line)
    return [cell.strip() for cell in line.strip("│ ").split("│")]


def test_show_resolves_defaults_and_prints_units_and_sources(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("cart: {mass_kg: 0.6}\neffects:\n  arm.creep: {strength: 0.2}\n  arm.tilt: {angle: 0.0}\n")
    result = run("show", path)
    assert row(result.stdout, "cart.mass_kg")[:3] == ["cart.mass_kg", "0.6", "kg"]
    creep = {p.name: p for p in REGISTRY["arm.creep"].parameters}
    _, value, unit, allowed, source = row(result.stdout, "arm.creep.time")
    assert (float(value), unit) == (creep["time"].default, "s")
    assert allowed == str(creep["time"])
    assert source == REGISTRY["arm.creep"].source
    assert "rail.delay" not in result.stdout
    assert result.stdout.endswith("arm.tilt has its neutral value and no effect\n")


def test_diff_shows_only_the_differences(tmp_path: Path) -> None:
    result = run("diff", "seed", "no-delay")
    assert row(result.stdout, "rail.delay.delay") == ["rail.delay.delay", "s", "0.0333333", "absent"]
    assert result.stdout.count("│\n") == 1
    assert run("diff", "seed", "seed").stdout == "no difference\n"
    path = tmp_path / "mine.yaml"
    path.write_text("cart: {mass_kg: 0.40000000001}\n")
    result = run("diff", "seed", path)
    assert row(result.stdout, "cart.mass_kg") == ["cart.mass_kg", "kg", "0.4", "0.40000000001"]


def test_check_accepts_a_valid_model_and_reports_every_mistake(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("effects:\n  rail.dely: {delay: 0.1}\n  arm.tilt: {angle: 2}\n")
    result = invoke("model", "check", path)
    assert (result.exit_code, result.stdout) == (1, "")
    first, second = result.stderr.splitlines()
    assert first.startswith(f"{path}:2: effects.rail.dely: unknown effect; did you mean rail.delay?")
    assert second.startswith(f"{path}:3: effects.arm.tilt.angle: is 2; allowed -0.2 to 0.2 rad")
    result = run("check", "no-pressure-lag")
    assert result.stdout.startswith("no-pressure-lag: valid; 5 links; effects: rail.acceleration_limit, rail.delay")


def test_export_writes_a_file_for_mujoco_and_lists_missing_effects(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    out = tmp_path / "arm.xml"
    result = run("export", "--mjcf", out, "seed")
    assert result.stdout == f"wrote {out}\n"
    assert "left out: rail.delay: " in result.stderr
    assert mujoco.MjModel.from_xml_path(str(out)).nq == 6
