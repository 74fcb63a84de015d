"""`softarm check` tells what a file holds the arm to, or all that is wrong with it."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from softarm.cli.main import main

ROOT = Path(__file__).parents[2]


@pytest.fixture
def check(tmp_path):
    def check(text: str):
        path = tmp_path / "arm.yaml"
        path.write_text(text)
        return path, CliRunner().invoke(main, ["check", str(path)])

    return check


def test_a_sound_file_prints_its_limits_and_where_they_come_from(check):
    path, result = check("limits:\n  rail: {velocity_max_m_s: 0.4}\ncontrol: {policy: hold}\n")
    assert result.exit_code == 0
    row = next(line for line in result.stdout.splitlines() if "velocity_max_m_s" in line)
    assert "0.4" in row
    assert "above 0, at most 1 m/s" in row
    assert "line 2" in row
    row = next(line for line in result.stdout.splitlines() if "pressure.max_kpa" in line)
    assert "default" in row
    assert "stopping distance at full speed" in result.stdout
    assert "127.0.0.1:8081" in next(line for line in result.stdout.splitlines() if "stop's own way" in line)
    latch = next(line for line in result.stdout.splitlines() if "stop's latch" in line)
    assert "logs/stop-169.254.0.1-502.json" in latch
    assert result.stdout.endswith(f"{path}: sound; starts with policy 'hold'\n")


def test_every_mistake_is_printed_with_its_line_and_exit_code_1(check):
    path, result = check("limits:\n  rial: {}\nfailsafe:\n  mocap_stale_s: 100\n")
    assert result.exit_code == 1
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert lines[0].startswith(f"{path}:2: limits.rial: unknown key; did you mean rail?")
    assert lines[1].startswith(f"{path}:4: failsafe.mocap_stale_s: is 100;")
    assert len(lines) == 2


def test_a_policy_that_could_not_fly_is_found(check):
    path, result = check("control:\n  policy: hodl\npolicies:\n  mine:\n    plugin: pid\n    options: {kpy: 1}\n")
    assert result.exit_code == 1
    lines = result.stderr.splitlines()
    assert lines[0].startswith(f"{path}:4: policies.mine: plugin 'pid' has no option 'kpy'; did you mean 'kp_y'?")
    assert lines[1].startswith(f"{path}:2: control.policy: no policy 'hodl'; did you mean 'hold'?")


def test_a_source_of_motion_capture_that_is_not_there_is_found(check):
    path, result = check("control: {policy: hold}\ndrivers:\n  mocap:\n    driver: zenho\n")
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert line.startswith(
        f"{path}:4: drivers.mocap.driver 'zenho': no motion capture source 'zenho'; did you mean 'zenoh'?"
    )


def test_the_policy_of_a_file_that_names_none_is_tried_too(check, monkeypatch, tmp_path):
    monkeypatch.setattr("softarm.policies.registry.MODELS", tmp_path / "empty")
    path, result = check("")
    assert result.exit_code == 1
    assert result.stderr.startswith(f"{path}: control.policy: no policy 'reach'")


def test_an_address_that_run_would_not_open_is_found(check, tmp_path):
    path, result = check("api:\n  host: 0.0.0.0\n")
    assert result.exit_code == 1
    assert result.stderr.startswith(f"{path}:2: api.host 0.0.0.0 can be reached from other machines and needs api.")
    path, result = check(f"api:\n  host: 0.0.0.0\n  token_file: {tmp_path}/none\n")
    assert result.exit_code == 1
    assert result.stderr.startswith(f"{path}:3: api.token_file {tmp_path}/none: cannot be read")


@pytest.mark.parametrize("verb", [["check"], ["run", "--simulated", "--config"], ["twin", "--config"]])
def test_what_contradicts_itself_is_refused_by_every_verb_with_the_same_words(tmp_path, verb):
    path = tmp_path / "arm.yaml"
    path.write_text("limits: {rail: {latency_s: 0}}\n")
    result = CliRunner().invoke(main, [*verb, str(path)])
    assert result.exit_code == 1
    assert result.stderr == (
        f"{path}:1: limits.rail.latency_s: is 0.0, below 0.005: no command reaches drivers.rail.driver dryve_d1 at "
        "once; measure it, or remove the line for the default\n"
    )


@pytest.mark.parametrize("name", ["softarm.yaml", "twin.yaml"])
def test_the_shipped_files_are_sound(name):
    result = CliRunner().invoke(main, ["check", str(ROOT / name)])
    assert result.exit_code == 0, result.stderr


def test_a_missing_file_is_named():
    result = CliRunner().invoke(main, ["check", "nowhere.yaml"])
    assert result.exit_code == 1
    assert result.stderr.startswith("nowhere.yaml: no such file; name an existing one")


def test_the_twin_refuses_a_bad_file_with_the_same_words(tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text("api: {port: 70000}\n")
    said = {
        CliRunner().invoke(main, arguments).stderr
        for arguments in (["check", str(path)], ["twin", "--config", str(path)])
    }
    assert said == {
        f"{path}:1: api.port: is 70000; allowed 0 to 65535, a whole number; "
        "change it, or remove the line for the default 8080\n"
    }


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A folder with a log of a robot whose rail is late and weak, as `softarm excite` records it."""
    folder = tmp_path_factory.mktemp("logs")
    config = folder / "careful.yaml"
    careful = "{latency_s: 0.09, braking_m_s2: 1, velocity_max_m_s: 0.6}"
    config.write_text(f"limits: {{rail: {careful}}}\nrecorder: {{directory: {folder}}}\n")
    model = folder / "model.yaml"
    lag = "pressure.lag: {inflate: 0.158, deflate: 0.221}"
    rail = "rail.delay: {delay: 0.06}, rail.acceleration_limit: {acceleration: 4}"
    model.write_text(f"effects: {{{lag}, {rail}}}\n")
    played = ["excite", "rail-dashes", "--simulated", "--config", str(config), "--model", str(model)]
    result = CliRunner().invoke(main, played)
    assert result.exit_code == 0, result.output
    return folder


@pytest.mark.slow
def test_logs_say_where_a_configuration_is_milder_than_the_robot_was(logs, tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text("limits:\n  rail:\n    latency_s: 0.02\n    braking_m_s2: 3\n    surge_m_s2: 9\n")
    result = CliRunner().invoke(main, ["check", str(path), "--logs", str(logs)])
    assert result.exit_code == 1
    latency, braking = result.stderr.splitlines()
    assert latency.startswith(f"{path}:3: limits.rail.latency_s: is 0.02, milder than the robot in {logs}: 9")
    assert "% of set-point steps act within 0.06" in latency
    assert "; raise it to 0.06" in latency
    assert braking.startswith(f"{path}:4: limits.rail.braking_m_s2: is 3, milder than the robot in {logs}: 9")
    assert "; lower it to " in braking
    assert "the rail" in result.stdout
    path.write_text("limits:\n  rail: {latency_s: 0.075, braking_m_s2: 1}\n")
    assert CliRunner().invoke(main, ["check", str(path), "--logs", str(logs)]).exit_code == 0


def test_a_folder_without_logs_is_refused_and_one_with_too_few_is_no_mistake(tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text("")
    result = CliRunner().invoke(main, ["check", str(path), "--logs", str(tmp_path)])
    assert result.exit_code == 1
    assert result.stderr.startswith(f"{tmp_path}: holds no log; name the folder of recorder.directory")
    flown = ROOT / "tests" / "data"
    result = CliRunner().invoke(main, ["check", str(path), "--logs", str(flown)])
    assert result.exit_code == 0
    assert "it takes 59" in result.stdout


STAGE = """
name: chamber
kind: tracking
channels:
  command: {time: {source: t, unit: s}, columns: {command: {source: u, unit: V}}}
  measured: {time: {source: t, unit: s}, columns: {pressure: {source: p, unit: mbar}}}
model: {gain: 500}
trials:
  - {name: one, kind: steps, files: one.csv}
  - {name: two, kind: steps, files: two.csv}
"""


@pytest.fixture
def rig(tmp_path):
    rows = "".join(f"{0.01 * i:.2f},{i // 50 % 3},{500 * (i // 50 % 3) + i % 7}\n" for i in range(400))
    for name in ("one", "two"):
        (tmp_path / f"{name}.csv").write_text("t,u,p\n" + rows)
    path = tmp_path / "stage.yaml"
    path.write_text(STAGE)
    return path


def test_a_rigs_stage_file_is_read_whole_in_its_owners_units(rig):
    result = CliRunner().invoke(main, ["check", str(rig)])
    assert result.exit_code == 0, result.output
    row = next(line for line in result.stdout.splitlines() if "two" in line and "pressure" in line)
    assert [cell for cell in row.split() if cell[0].isalnum()][-3:] == ["0", "1006", "mbar"]
    assert result.stdout.endswith(f"{rig}: sound; 2 trials of chamber (tracking)\n")


def test_every_trial_of_a_rig_that_diagnose_would_refuse_is_told(rig, tmp_path):
    (tmp_path / "one.csv").write_text("t,u,p\n0,0,0\n")
    (tmp_path / "two.csv").write_text("t,u\n0,0\n")
    result = CliRunner().invoke(main, ["check", str(rig)])
    assert result.exit_code == 1
    one, *more = result.stderr.splitlines()
    assert one.startswith(f"{tmp_path}/one.csv: column t: 1 rows over 0 s; the command channel needs 2 rows")
    assert more[-1] == f"{tmp_path}/two.csv: no column p; it has t, u; correct the stage.yaml"
    result = CliRunner().invoke(main, ["diagnose", str(rig)])
    assert result.exit_code == 1
    assert one in result.stderr


def test_a_rigs_stage_file_with_a_mistake_in_it_is_still_one(rig):
    rig.write_text(rig.read_text().replace("gain", "gian"))
    result = CliRunner().invoke(main, ["check", str(rig)])
    assert result.exit_code == 1
    assert f"{rig}:7: model.gian: unknown key; did you mean gain?" in result.stderr


def test_the_folder_of_a_rigs_data_is_for_a_rig(check, tmp_path):
    path, _ = check("")
    result = CliRunner().invoke(main, ["check", str(path), "--data", str(tmp_path)])
    assert result.exit_code == 2
    assert "--data is where the files of a stage.yaml lie" in result.stderr


def test_a_script_reads_limits_and_mistakes(check, tmp_path):
    path, _ = check("")
    told = json.loads(CliRunner().invoke(main, ["check", str(path), "--json"]).stdout)
    assert (told["sound"], told["problems"]) == (True, [])
    assert any(row["key"] == "limits.rail.velocity_max_m_s" for row in told["limits"])
    path.write_text("control: {rate_hz: 60, policy: raech}\n")
    result = CliRunner().invoke(main, ["check", str(path), "--json"])
    told = json.loads(result.stdout)
    assert (result.exit_code, told["sound"], len(told["problems"])) == (1, False, 2)
    path.write_text("")
    result = CliRunner().invoke(main, ["check", str(path), "--json", "--logs", str(ROOT / "tests" / "data")])
    assert json.loads(result.stdout)["sound"] is True
