"""Tests of `softarm service install` into a folder."""

from pathlib import Path

from softarm.common.revision import PACKAGE
from tests.cli.invoke import invoke, refuse, succeed

CONFIGURATION, UNIT = Path("etc/softarm/softarm.yaml"), Path("etc/systemd/system/softarmd.service")
RULE = Path("etc/udev/rules.d/99-softarm.rules")


def install(root, *more):
    return succeed("service", "install", "--root", root, *more)


def test_a_second_install_changes_nothing(tmp_path):
    install(tmp_path)
    assert (tmp_path / CONFIGURATION).read_text() == (PACKAGE / "softarm.yaml").read_text()
    assert (tmp_path / RULE).read_text() == (PACKAGE / "systemd" / "99-softarm.rules").read_text()
    assert "softarm" in (tmp_path / UNIT).read_text().partition("ExecStart=")[2].splitlines()[0]
    assert (tmp_path / "var/lib/softarm/logs").is_dir()
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
    assert "write" not in install(tmp_path).output
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()} == before


def test_an_upgrade_keeps_logs_and_a_changed_configuration(tmp_path):
    install(tmp_path)
    (tmp_path / CONFIGURATION).write_text("drivers: {rail: {host: 10.0.0.7}}\n")
    (tmp_path / "var/lib/softarm/logs/softarm-20260101T000000Z.mcap").write_text("a log")
    (tmp_path / UNIT).write_text("[Service]\n")
    done = install(tmp_path)
    assert "change " in done.output
    assert "drivers.rail.host: '10.0.0.7', not '169.254.0.1'" in done.output
    assert (tmp_path / CONFIGURATION).read_text() == "drivers: {rail: {host: 10.0.0.7}}\n"
    assert (tmp_path / "var/lib/softarm/logs/softarm-20260101T000000Z.mcap").read_text() == "a log"
    assert "ExecStart" in (tmp_path / UNIT).read_text()
    install(tmp_path, "--uninstall")
    assert not (tmp_path / UNIT).exists()
    assert (tmp_path / CONFIGURATION).exists()


def test_a_valid_configuration_is_installed_and_an_invalid_one_refused(tmp_path):
    (tmp_path / "mine.yaml").write_text("drivers: {rail: {host: 10.0.0.7}}\n")
    (tmp_path / "wrong.yaml").write_text("drivers: {rail: {hots: 10.0.0.7}}\n")
    there = ("service", "install", "--root", tmp_path / "a")
    refuse("did you mean host?", *there, "--config", tmp_path / "wrong.yaml")
    assert not (tmp_path / "a").exists()
    install(tmp_path / "a", "--config", tmp_path / "mine.yaml")
    assert "10.0.0.7" in (tmp_path / "a" / CONFIGURATION).read_text()
    (tmp_path / "a" / CONFIGURATION).write_text("limits: {rail: {margin: 1}}\n")
    refuse("did you mean margin_m", *there)


def test_a_file_hidden_from_the_service_is_refused(tmp_path):
    (tmp_path / "mine.yaml").write_text("api: {token_file: /home/ann/token}\n")
    message = "names /home/ann/token, hidden from the service; move it into /etc/softarm"
    refuse(message, "service", "install", "--root", tmp_path / "a", "--config", tmp_path / "mine.yaml")


def test_a_dry_run_shows_every_change_and_makes_none(tmp_path):
    done = install(tmp_path, "--dry-run", "--user", "ann")
    assert f"would write {tmp_path / UNIT}" in done.output
    assert "    User=ann" in done.output
    assert "    limits:  " in done.output
    assert 'SYMLINK+="softarm-regulator"' in done.output
    assert list(tmp_path.iterdir()) == []
    here = invoke("service", "install", "--dry-run", "--user", "no-such-user")
    assert "would run useradd --system" in here.output
    assert "nothing was changed" in here.output
