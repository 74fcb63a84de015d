"""Tests of `softarm twin` and its faults."""

import json
import signal
import sys
from pathlib import Path
from typing import Any

import pytest
import zenoh

from softarm.drivers.mocap.zenoh_session import listener
from softarm.drivers.twin.faults import described
from softarm.evaluation.robots import with_effects
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY, exemplars
from tests.cli.invoke import invoke, refuse, succeed
from tests.processes import WAIT_S, free_port, running, said

CONFIG = str(Path(__file__).parents[3] / "twin.yaml")


def test_a_missing_mujoco_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("softarm.drivers.bodies.independent", "softarm.reality.robot", "softarm.reality.plant"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    refuse("pip install 'softarm[mujoco]'", "twin", "--config", CONFIG, "--reality")


def test_the_fault_list_shows_ranges_without_a_configuration() -> None:
    output = succeed("twin", "--fault", "list").output
    for name, *_ in described():
        assert f" {name} " in output
    assert all(f" {name} " in output for name in REGISTRY)
    assert "0 to 0.1 s; 0.05 without" in output
    assert " rail.delay_s " in succeed("twin", "--reality", "--fault", "list").output


def test_a_fault_changes_the_effects_of_the_model() -> None:
    model = with_effects(Model(), ["rail.delay=0.09", "arm.payload", "pressure.lag.inflate=0.3"])
    seed = Model().effects
    assert model.effects["rail.delay"] == {"delay": 0.09}
    assert model.effects["arm.payload"] == exemplars()["arm.payload"]
    assert model.effects["pressure.lag"] == {**seed["pressure.lag"], "inflate": 0.3}
    assert Model().effects == seed


def test_a_fault_without_a_daemon_is_refused(tmp_path: Path) -> None:
    config = tmp_path / "twin.yaml"
    config.write_text(f"drivers: {{mocap: {{endpoint: tcp/127.0.0.1:{free_port()}}}}}\n")
    refuse("no daemon listens there; start `softarm run`", "twin", "fault", "mocap_freeze", "--config", config)


# Over 3 s: `twin fault` waits 2 s for a twin that has ended.
@pytest.mark.slow
@pytest.mark.timeout(170)
def test_faults_change_at_run_time_and_ctrl_c_reports_the_state(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = tmp_path / "twin.yaml"
    config.write_text(
        f"drivers: {{mocap: {{endpoint: {endpoint}}}, regulator: {{port: {tmp_path}/teensy}}, "
        f"rail: {{host: 127.0.0.1, port: {free_port()}}}}}\n"
    )
    begun = ("twin", "--config", config, "--fault", "serial_silence", "--fault", "arm.payload=0.05")

    def fault(*arguments: str) -> Any:
        return invoke("twin", "fault", *arguments, "--config", config)

    with zenoh.open(listener(endpoint)), running(*begun) as twin:
        assert "regulator at" in said(twin, "softarm twin:(.*)")
        assert fault("mocap_drop_body=link3").stdout == "active faults: serial_silence, mocap_drop_body\n"
        assert json.loads(fault("clear", "--json").stdout)["faults"] == []
        twin.send_signal(signal.SIGINT)
        output = twin.communicate(timeout=WAIT_S)[0]
    assert twin.returncode == 130
    assert output.endswith("interrupted: the simulated robot has ended; a connected daemon stops and reports it\n")
    with zenoh.open(listener(endpoint)):
        assert "no twin has published its state for 2 s" in fault("rail_fault").stderr
