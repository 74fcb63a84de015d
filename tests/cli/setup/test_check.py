"""Tests of `softarm check`."""

import json
from pathlib import Path

import pytest

from softarm.policies import registry, trial
from tests.cli.invoke import invoke, refuse, succeed
from tests.diagnosis.rigs.recordings import SERVO

ROOT = Path(__file__).parents[3]


@pytest.fixture
def trial_here(monkeypatch):
    """Try policies in this process; test_trial proves the separate one, and the shipped files are tried there."""
    monkeypatch.setattr(trial, "try_out", lambda name, configured, _: trial.ready(registry.load(name, configured)))


@pytest.fixture
def check(tmp_path, trial_here):
    def check(text: str, *options: str):
        path = tmp_path / "arm.yaml"
        path.write_text(text)
        return path, invoke("check", path, *options)

    return check


def test_a_valid_file_prints_only_the_values_that_differ_from_the_default(check):
    text = "limits:\n  rail: {velocity_max_m_s: 0.4, margin_m: 0.01}\npolicies: {mine: {plugin: pid}}\n"
    path, result = check(text)
    assert result.exit_code == 0
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in result.stdout.splitlines() if "│" in line]
    assert rows == [
        ["limits.rail.velocity_max_m_s", "0.4", "m/s", "1", "line 2"],
        ["policies", "mine", "", "none", "line 3"],
    ]
    assert result.stdout.endswith(f"{path}: valid; starts with policy 'reach'\n")
    path, result = check("")
    assert result.stdout == f"{path}: valid; starts with policy 'reach'; all values are the defaults\n"


def test_all_limits_and_their_sources_are_printed_on_request(check):
    path, result = check("limits:\n  rail: {velocity_max_m_s: 0.4}\ncontrol: {policy: hold}\n", "--all")
    assert result.exit_code == 0
    row = [line for line in result.stdout.splitlines() if "velocity_max_m_s" in line][-1]
    assert "0.4" in row
    assert "line 2" in row
    assert "above 0, at most 1 m/s" in row
    assert "127.0.0.1:8081" in next(line for line in result.stdout.splitlines() if "stop port" in line)
    latch = next(line for line in result.stdout.splitlines() if "latch of the emergency stop" in line)
    assert "logs/stop-169.254.0.1-502.json" in latch
    assert result.stdout.endswith(f"{path}: valid; starts with policy 'hold'\n")


def test_every_mistake_is_printed_with_its_line(check):
    path, result = check("control:\n  policy: hodl\npolicies:\n  mine:\n    plugin: pid\n    options: {kpy: 1}\n")
    assert (result.exit_code, result.stdout) == (1, "")
    option, policy = result.stderr.splitlines()
    assert option.startswith(f"{path}:4: policies.mine: plugin 'pid' has no option 'kpy'; did you mean 'kp_y'?")
    assert policy.startswith(f"{path}:2: control.policy: no policy 'hodl'; did you mean 'hold'?")


@pytest.mark.usefixtures("trial_here")
@pytest.mark.parametrize("verb", [["check"], ["run", "--simulated", "--config"], ["twin", "--config"]])
def test_every_verb_reports_a_contradiction_with_the_same_text(tmp_path, verb):
    path = tmp_path / "arm.yaml"
    path.write_text("limits: {rail: {latency_s: 0}}\n")
    result = invoke(*verb, path)
    assert result.exit_code == 1
    assert result.stderr == (
        f"{path}:1: limits.rail.latency_s: is 0.0, below 0.005: no command reaches drivers.rail.driver dryve_d1 "
        "faster; measure the latency, or remove the line for the default\n"
    )


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Return a folder with a log of a robot whose rail is late and weak."""
    folder = tmp_path_factory.mktemp("logs")
    config = folder / "careful.yaml"
    careful = "{latency_s: 0.09, braking_m_s2: 1, velocity_max_m_s: 0.6}"
    config.write_text(f"limits: {{rail: {careful}}}\nrecorder: {{directory: {folder}}}\n")
    model = folder / "model.yaml"
    lag = "pressure.lag: {inflate: 0.158, deflate: 0.221}"
    rail = "rail.delay: {delay: 0.06}, rail.acceleration_limit: {acceleration: 4}"
    model.write_text(f"effects: {{{lag}, {rail}}}\n")
    succeed("excite", "rail-dashes", "--simulated", "--config", config, "--model", model)
    return folder


@pytest.mark.slow
@pytest.mark.usefixtures("trial_here")
def test_limits_laxer_than_the_logs_show_are_reported(logs, tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text("limits:\n  rail:\n    latency_s: 0.02\n    braking_m_s2: 3\n    surge_m_s2: 9\n")
    result = invoke("check", path, "--logs", logs)
    assert result.exit_code == 1
    latency, braking = result.stderr.splitlines()
    assert latency.startswith(f"{path}:3: limits.rail.latency_s: is 0.02, laxer than the robot in {logs}: 9")
    assert "% of set-point steps act within 0.06" in latency
    assert "; raise it to 0.06" in latency
    assert braking.startswith(f"{path}:4: limits.rail.braking_m_s2: is 3, laxer than the robot in {logs}: 9")
    assert "; lower it to " in braking
    assert "the rail" in result.stdout
    path.write_text("limits:\n  rail: {latency_s: 0.075, braking_m_s2: 1}\n")
    succeed("check", path, "--logs", logs)


@pytest.mark.usefixtures("trial_here")
def test_a_folder_without_logs_is_refused_but_short_logs_are_accepted(tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text("")
    refuse(f"{tmp_path}: contains no log; name the recorder.directory", "check", path, "--logs", tmp_path)
    assert "59 required" in succeed("check", path, "--logs", ROOT / "tests" / "data").stdout


@pytest.fixture
def rig(tmp_path):
    rows = "".join(f"{0.01 * i:.2f},{500 * (i // 50 % 3)},{500 * (i // 50 % 3) + i % 7}\n" for i in range(400))
    for name in ("one", "two"):
        (tmp_path / f"{name}.csv").write_text("t,u,y\n" + rows)
    path = tmp_path / "stage.yaml"
    path.write_text(f"name: servo\n{SERVO}")
    return path


def test_check_reads_every_trial_of_a_stage_file_in_its_units(rig):
    result = succeed("check", rig)
    row = next(line for line in result.stdout.splitlines() if "two" in line and "position" in line)
    assert [cell for cell in row.split() if cell[0].isalnum()][-3:] == ["0", "1006", "deg"]
    assert result.stdout.endswith(f"{rig}: valid; 2 trials of servo (tracking)\n")


def test_an_option_for_a_configuration_is_refused_for_a_stage_file(rig, tmp_path):
    for option in (["--all"], ["--json"], ["--simulated"], ["--logs", tmp_path]):
        refuse("are for a configuration; omit them here", "check", rig, *option, code=2)


def test_every_invalid_trial_of_a_stage_file_is_reported(rig, tmp_path):
    (tmp_path / "one.csv").write_text("t,u,y\n0,0,0\n")
    (tmp_path / "two.csv").write_text("t,u\n0,0\n")
    result = invoke("check", rig)
    assert result.exit_code == 1
    one, *more = result.stderr.splitlines()
    assert one.startswith(f"{tmp_path}/one.csv: column t: 1 rows over 0 s; the command channel needs 2 rows")
    assert more[-1] == f"{tmp_path}/two.csv: no column y; it has t, u; correct the stage.yaml"
    refuse(one, "diagnose", rig)


def test_check_prints_limits_and_mistakes_as_json(check, tmp_path):
    path, _ = check("")
    answer = json.loads(invoke("check", path, "--json").stdout)
    assert (answer["sound"], answer["problems"]) == (True, [])
    assert any(row["key"] == "limits.rail.velocity_max_m_s" for row in answer["limits"])
    path.write_text("control: {rate_hz: 60, policy: raech}\n")
    result = invoke("check", path, "--json")
    answer = json.loads(result.stdout)
    assert (result.exit_code, answer["sound"], len(answer["problems"])) == (1, False, 2)
    path.write_text("")
    result = invoke("check", path, "--json", "--logs", ROOT / "tests" / "data")
    assert json.loads(result.stdout)["sound"] is True
