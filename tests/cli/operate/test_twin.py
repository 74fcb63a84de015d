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
from tests.cli.invoke import invoke
from tests.processes import free_port, running, said

CONFIG = str(Path(__file__).parents[3] / "twin.yaml")


def test_a_missing_mujoco_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("softarm.drivers.bodies.independent", "softarm.reality.robot", "softarm.reality.plant"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    answer = invoke("twin", "--config", CONFIG, "--reality")
    assert answer.exit_code == 1
    assert "pip install 'softarm[mujoco]'" in answer.output


def test_a_model_with_another_number_of_links_is_refused(tmp_path: Path) -> None:
    lists = ("link_length_m", "link_mass_kg", "link_inertia_kg_m2", "stiffness_nm_rad", "damping_nm_s_rad")
    short = "".join(f"  {name}: [0.01, 0.01]\n" for name in (*lists, "muscle_gain_nm_kpa", "torque_offset_nm"))
    model = tmp_path / "short.yaml"
    model.write_text("arm:\n" + short)
    answer = invoke("twin", "--config", CONFIG, "--model", model, "--reality")
    assert answer.exit_code == 1
    assert "has 2 links; the daemon flies an arm of 5" in answer.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--reality", "--fault", "rail.delay=0.09"), "did you mean delay_s? write group.quantity=value"),
        (("--reality", "--fault", "rail.delay_s=3"), "Rail.delay_s is 3; allowed 0 to 0.3 s"),
        (("--fault", "rail.delya=0.09"), "no such fault; did you mean rail.delay? `softarm twin --fault list` shows"),
        (("--fault", "rail.delay=9"), "rail.delay.delay: is 9; allowed 0 to 0.1 s"),
        (("--fault", "pressure.lag=0.3"), "write pressure.lag.inflate=VALUE or pressure.lag.deflate=VALUE"),
        (("--fault", "arm.payload=heavy"), "'heavy' is not a number"),
        (("--fault", "mocap_freez"), "did you mean mocap_freeze? allowed:"),
        (("--fault", "rail_fault=3"), "takes no value"),
        (("--fault", "mocap_drop_body=link9"), "allowed: cart, link1"),
        (("--fault", "rail_silence=-1"), "seconds is -1.0; use a positive number"),
    ],
)
def test_an_invalid_fault_is_refused_with_the_allowed_values(arguments: tuple[str, ...], message: str) -> None:
    answer = invoke("twin", "--config", CONFIG, *arguments)
    assert answer.exit_code == 1
    assert message in " ".join(answer.output.split())


def test_the_fault_list_shows_ranges_without_a_configuration() -> None:
    output = invoke("twin", "--fault", "list").output
    for name, *_ in described():
        assert f" {name} " in output
    assert all(f" {name} " in output for name in REGISTRY)
    assert "0 to 0.1 s; 0.05 without" in output
    assert " rail.delay_s " in invoke("twin", "--reality", "--fault", "list").output


def test_a_fault_changes_the_effects_of_the_model() -> None:
    model = with_effects(Model(), ["rail.delay=0.09", "arm.payload", "pressure.lag.inflate=0.3"])
    seed = Model().effects
    assert model.effects["rail.delay"] == {"delay": 0.09}
    assert model.effects["arm.payload"] == exemplars()["arm.payload"]
    assert model.effects["pressure.lag"] == {**seed["pressure.lag"], "inflate": 0.3}
    assert Model().effects == seed


def test_a_twin_without_its_file_is_refused() -> None:
    answer = invoke("twin")
    assert (answer.exit_code, "no ports given: use --config FILE" in answer.output) == (2, True)


def test_a_fault_without_a_daemon_is_refused(tmp_path: Path) -> None:
    config = tmp_path / "twin.yaml"
    config.write_text(f"drivers: {{mocap: {{endpoint: tcp/127.0.0.1:{free_port()}}}}}\n")
    answer = invoke("twin", "fault", "mocap_freeze", "--config", config)
    assert answer.exit_code == 1
    assert "no daemon listens there; start `softarm run`" in answer.output


# Over 3 s: `twin fault` waits 2 s for a twin that has ended.
@pytest.mark.realtime
@pytest.mark.timeout(120)
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
        output = twin.communicate(timeout=10)[0]
    assert twin.returncode == 130
    assert output.endswith("interrupted: the simulated robot has ended; a connected daemon stops and reports it\n")
    with zenoh.open(listener(endpoint)):
        assert "no twin has published its state for 2 s" in fault("rail_fault").stderr
