"""Plan of an installation: only the necessary steps for the computer's present state."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from softarm.daemon.config import configuration
from softarm.daemon.install import here, plan
from softarm.daemon.install.plan import System, Wanted
from softarm.daemon.install.steps import StepError, folder, run, write
from softarm.schemas.config import Api, Config, Drivers, Policy, Recorder, SerialRegulator

COMMAND = ("/opt/softarm/.venv/bin/softarm",)
PACKAGED = Wanted(configuration.EXAMPLE.read_text(encoding="utf-8"), Config(), asked_for=False)
OTHER = Config(recorder=Recorder(queue_max=500))


def system(files=None, **changes):
    """Return a computer with systemd and these files."""
    files = files or {}
    bare = System(
        Path("/"),
        files.get,
        lambda folder: any(path.is_relative_to(folder) for path in files),
        frozenset(),
        frozenset(),
        frozenset({"dialout"}),
        True,
    )
    return replace(bare, **changes)


def installed(user="softarm", text=PACKAGED.text):
    """Return the files of a finished installation."""
    return {
        plan.CONFIGURATION: text,
        plan.UNIT_PATH: plan.unit_text(COMMAND, user, Config()),
        plan.RULE_PATH: plan.RULE.read_text(),
        plan.STATE / "logs" / "softarm-20260101T000000Z.mcap": "a log",
    }


def steps(computer, wanted=PACKAGED, user="softarm"):
    return list(plan.install(computer, COMMAND, user, wanted))


def of(kind, done):
    """Return the texts of a plan's steps of one kind, without their verb."""
    return [step.text.removeprefix(f"{kind} ") for step in done if step.kind == kind]


def commands(done):
    return of("run", done)


def test_on_a_new_computer_everything_is_installed():
    done = steps(system(groups=frozenset()))
    assert of("write", done) == list(map(str, (plan.CONFIGURATION, plan.UNIT_PATH, plan.RULE_PATH)))
    assert of("folder", done) == [f"make the folder {plan.STATE}{part} for softarm" for part in ("", "/logs")]
    assert [line.split()[0] for line in commands(done)] == [
        "groupadd", "useradd", "udevadm", "udevadm", "systemctl", "systemctl",
    ]  # fmt: skip
    assert commands(done)[-1] == "systemctl enable softarmd"
    assert not any("start" in line for line in commands(done))  # an arm may be flying


def test_a_second_installation_writes_nothing():
    there = system(installed(), users=frozenset({"softarm"}), members=frozenset({"softarm"}))
    done = steps(there, replace(PACKAGED, installed=Config()))
    assert {step.kind for step in done} == {"keep", "run"}
    assert commands(done) == ["systemctl enable softarmd"]


def test_an_existing_user_joins_the_group():
    assert commands(steps(system(users=frozenset({"softarm"}))))[0] == "usermod --append --groups dialout softarm"


def test_a_given_configuration_is_stored_next_to_the_existing_one():
    asked = Wanted("recorder: {queue_max: 600}\n", Config(recorder=Recorder(queue_max=600)), True, OTHER)
    done = steps(system(installed()), asked)
    (new,) = [step for step in done if step.kind == "write"]
    assert (new.text, new.shown) == ("write /etc/softarm/softarm.yaml.new", asked.text.splitlines())
    assert any(f"{plan.CONFIGURATION}: " in kept and "queue_max: 500, not 600" in kept for kept in of("keep", done))
    same = steps(system(installed()), replace(asked, installed=asked.config))
    assert of("write", same) == []


def test_another_root_folder_leaves_this_computer_unchanged(tmp_path):
    done = steps(system(root=tmp_path))
    assert commands(done) == []
    assert all(str(tmp_path) in step.text and " for " not in step.text for step in done)


def test_without_systemd_its_commands_are_omitted():
    assert not [line for line in commands(steps(system(booted=False))) if "systemctl" in line]


def test_uninstalling_removes_unit_and_rule_and_no_user_files():
    done = list(plan.uninstall(system(installed(), users=frozenset({"softarm"})), "softarm"))
    assert of("remove", done) == [str(plan.UNIT_PATH), str(plan.RULE_PATH)]
    assert commands(done) == ["systemctl disable --now softarmd", "systemctl daemon-reload", "udevadm control --reload"]
    assert {kept.partition(":")[0] for kept in of("keep", done)} == {"/etc/softarm", str(plan.STATE)}
    nothing = list(plan.uninstall(system(), "softarm"))
    assert {step.kind for step in nothing} == {"keep"}


def test_the_unit_runs_the_environment_it_is_installed_from_as_the_user():
    text = plan.unit_text(("/opt/my arm/bin/softarm",), "ann", Config())
    assert 'ExecStart="/opt/my arm/bin/softarm" run --config /etc/softarm/softarm.yaml' in text.splitlines()
    assert {"User=ann", "Group=ann"} <= set(text.splitlines())
    assert "ReadWritePaths" not in text
    page = re.search(r"Documentation=file://(\S+)", text)
    assert page is not None
    assert Path(page[1]).is_file()
    assert "%%n" in plan.unit_text(("/opt/%n/softarm",), "ann", Config())


def test_the_service_may_write_to_other_folders_for_logs_and_reports():
    config = Config(recorder=Recorder(directory=Path("/data/logs")), api=Api(reports=Path("/data/reports")))
    lines = plan.unit_text(COMMAND, "softarm", config).splitlines()
    done = steps(system(), replace(PACKAGED, config=config))
    for written in ("/data/logs", "/data/reports"):
        assert f"ReadWritePaths={written}" in lines
        assert f"make the folder {written} for softarm" in of("folder", done)


def test_the_program_is_the_interpreters_script_or_the_module(tmp_path):
    assert plan.program(tmp_path / "python") == (str(tmp_path / "python"), "-m", "softarm.cli.main")
    (tmp_path / "softarm").write_text("")
    assert plan.program(tmp_path / "python") == (str(tmp_path / "softarm"),)


def test_paths_hidden_from_the_service_are_reported():
    assert plan.hidden(("/opt/softarm/.venv", "/usr/bin/python3")) == []
    assert plan.hidden(("/opt/x", "/root/.pyenv/bin/python3", "/home/ann/.venv")) == [
        "/root/.pyenv/bin/python3",
        "/home/ann/.venv",
    ]
    assert plan.hidden(("/homes/ann",)) == []
    assert plan.hidden(()) == []


def test_files_that_a_configuration_names_are_found():
    tokens = Api(token_file=Path("/home/ann/token"), view_token_file=Path("/etc/softarm/view"))
    mine = Policy(plugin="onnx", options={"model": "/home/ann/mine.onnx", "gain": 2.0, "name": "reach"})
    named = plan.named_files(Config(api=tokens, policies={"mine": mine}))
    assert named == ("/home/ann/token", "/etc/softarm/view", "/home/ann/mine.onnx")
    assert plan.named_files(Config()) == ()


@pytest.mark.parametrize(("port", "opened"), [("/dev/ttyUSB0", True), ("/dev/ttyACM0", False)])
def test_the_unit_opens_an_adapters_port_where_one_is_configured(port, opened):
    config = Config(drivers=Drivers(regulator=SerialRegulator(port=port)))
    assert ("DeviceAllow=char-ttyUSB rw" in plan.unit_text(COMMAND, "softarm", config).splitlines()) is opened


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not on this machine")
def test_systemd_accepts_the_rendered_unit_and_reports_a_wrong_one():
    config = Config(recorder=Recorder(directory=Path("/var/log/soft arm")))
    unit = plan.unit_text(("/bin/true",), "root", config)
    assert here.verify(unit) is None
    said = here.verify(unit.replace("NoNewPrivileges", "NoNewPrivilege"))
    assert said is not None
    assert said.startswith("softarmd.service")


def test_a_failed_step_reports_cause_and_next_step(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StepError, match="cannot be written"):
        write(tmp_path / "file" / "below", "text").carry_out()
    with pytest.raises(StepError, match="cannot be made"):
        folder(tmp_path / "file" / "below", None).carry_out()
    with pytest.raises(StepError, match="false: exit code 1; correct it"):
        run("false").carry_out()
    with pytest.raises(StepError, match="correct it"):
        run("no-such-program-of-softarm").carry_out()


def test_the_plan_reads_this_computer(tmp_path):
    found = here.look(tmp_path)
    assert "root" in found.users
    assert not found.is_this
    (tmp_path / "unit").write_text("text")
    assert (here.read(tmp_path / "unit"), here.read(tmp_path / "none")) == ("text", None)
    (tmp_path / "unit").write_bytes(b"\xff")
    with pytest.raises(StepError, match="cannot be read"):
        here.read(tmp_path / "unit")
