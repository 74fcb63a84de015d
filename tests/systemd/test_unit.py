"""The service file, checked by systemd, and the udev rule of the Teensy."""

import configparser
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from softarm.daemon.runtime.service import DESCRIPTORS
from softarm.drivers.rail import drive, master

SYSTEMD = Path(__file__).parents[2] / "systemd"
ANALYZE = shutil.which("systemd-analyze")
needs_systemd = pytest.mark.skipif(ANALYZE is None, reason="systemd-analyze is not on this machine")


@pytest.fixture
def service() -> configparser.SectionProxy:
    """Return the section Service of the unit."""
    parser = configparser.ConfigParser(interpolation=None)
    parser.optionxform = str
    parser.read(SYSTEMD / "softarmd.service")
    return parser["Service"]


@pytest.fixture
def installed(tmp_path) -> Path:
    """Return the unit with an existing program in ExecStart."""
    text = (SYSTEMD / "softarmd.service").read_text()
    text, replaced = re.subn(r"(?m)^ExecStart=\S+", "ExecStart=/bin/true", text)
    assert replaced == 1
    path = tmp_path / "softarmd.service"
    path.write_text(text)
    return path


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(ANALYZE), *arguments], capture_output=True, text=True, timeout=60)


@needs_systemd
def test_systemd_accepts_every_key_and_value(installed):
    verdict = analyze("verify", "--man=no", "--recursive-errors=no", str(installed))
    assert verdict.returncode == 0, verdict.stderr
    assert installed.name not in verdict.stderr


@needs_systemd
def test_the_exposure_is_at_most_two(installed):
    verdict = analyze("security", "--offline=yes", "--threshold=20", "--no-pager", str(installed))
    assert verdict.returncode == 0, verdict.stdout[-2000:] + verdict.stderr


def test_the_watchdog_is_slower_than_a_few_ticks_and_systemd_waits_for_the_log(service):
    assert service["Type"] == "notify"
    assert service["WatchdogSec"] == "1s"
    assert service["TimeoutStopSec"] == "10s"
    assert service["ExecStart"] == "/opt/softarm/.venv/bin/softarm run --config /etc/softarm/softarm.yaml"


def test_the_limit_of_open_files_is_the_daemons(service):
    assert int(service["LimitNOFILE"]) == DESCRIPTORS


def test_the_serial_port_and_real_time_stay_available(service):
    assert service["SupplementaryGroups"] == "dialout"
    assert service["DeviceAllow"] == "char-ttyACM rw"
    assert not {"PrivateDevices", "RestrictRealtime", "PrivateNetwork"} & set(service)
    assert "CPUSchedulingPolicy" not in service


def test_the_daemon_can_read_the_processor_and_the_open_ports(service):
    assert "ProcSubset" not in service  # hides /proc/cpuinfo and /proc/net/tcp


def test_the_rule_gives_the_daemon_access_and_excludes_modemmanager():
    text = (SYSTEMD / "99-softarm.rules").read_text().replace("\\\n", " ")
    rules = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    assert len(rules) == 1
    terms = dict(re.findall(r'([\w{}]+)\s*(?:==|\+=|=)\s*"([^"]*)"', rules[0]))
    assert (terms["ATTRS{idVendor}"], terms["ATTRS{idProduct}"]) == ("16c0", "0483")
    assert terms["GROUP"] == "dialout"
    assert terms["ENV{ID_MM_DEVICE_IGNORE}"] == "1"
    assert terms["SYMLINK"] == "softarm-regulator"


def test_the_rails_process_has_time_to_stop_the_drive(service):
    assert service["KillMode"] == "control-group"
    assert float(service["TimeoutStopSec"].removesuffix("s")) > master.SHUT_DOWN_S + drive.BRAKE_MAX_S
