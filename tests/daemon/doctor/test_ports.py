"""Findings of the doctor on serial device, axis and ports, made without blocking them."""

import os
import pty
import socket
from dataclasses import replace

import pytest

from softarm.common.finding import State
from softarm.daemon.doctor import ports
from softarm.daemon.doctor.ports import Axis, Serial
from softarm.schemas.config import Api, Config, Drivers, Mocap, Ros

THERE = Serial("/dev/ttyACM0", True, True, True, "dialout", "ann")


def only(findings):
    (finding,) = findings
    return finding


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"there": False}, "plug the Teensy in"),
        ({"there": False, "others": ("/dev/ttyACM1",)}, "/dev/ttyACM1"),
        ({"there": False, "path": "/tmp/regulator"}, "softarm twin"),
        ({"there": False, "path": "COM3"}, "or name a device under /dev"),
        ({"is_device": False}, "is no serial device"),
        ({"permitted": False}, "usermod -aG dialout ann"),
        ({"permitted": False, "group": "root"}, "udev rule"),
        ({"holder": "softarm, process 7"}, "held by softarm, process 7"),
    ],
)
def test_serial_device_findings(change, says):
    finding = only(ports.judge_serial(replace(THERE, **change)))
    assert finding.state is State.PROBLEM
    assert says in f"{finding.figure}; {finding.advice}"
    assert only(ports.judge_serial(THERE)).state is State.OK


def test_a_simulated_serial_device_has_no_other_holder(tmp_path):
    master, slave = pty.openpty()
    link = tmp_path / "regulator"
    link.symlink_to(os.ttyname(slave))
    try:
        facts = ports.look_serial(str(link))
    finally:
        os.close(slave)
        os.close(master)
    assert (facts.there, facts.is_device, facts.permitted, facts.holder) == (True, True, True, None)


def test_the_process_with_an_open_file_is_found(tmp_path):
    (tmp_path / "device").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "device")
    assert ports.holder(str(tmp_path / "link")) is None
    with (tmp_path / "device").open():
        assert str(ports.holder(str(tmp_path / "link"))).endswith(f"process {os.getpid()}")


def test_other_devices_are_named_if_the_configured_one_is_missing(tmp_path):
    (tmp_path / "ttyACM3").write_text("")
    facts = ports.look_serial(str(tmp_path / "none"), tmp_path)
    assert (facts.there, facts.others) == (False, (str(tmp_path / "ttyACM3"),))
    (tmp_path / "plain").write_text("")
    assert not ports.look_serial(str(tmp_path / "plain")).is_device


@pytest.fixture
def drive():
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.2)
        yield server


def test_the_axis_check_connects_and_sends_nothing(drive):
    facts = ports.look_axis("127.0.0.1", drive.getsockname()[1])
    assert facts.connect_ms is not None
    connection, _ = drive.accept()
    with connection:
        assert connection.recv(1) == b""


def test_an_axis_in_use_by_this_computer_is_not_contacted(drive):
    port = drive.getsockname()[1]
    with socket.create_connection(("127.0.0.1", port)), drive.accept()[0]:
        facts = ports.look_axis("127.0.0.1", port)
        assert facts.held
        with pytest.raises(TimeoutError):  # no other client came
            drive.accept()
    assert only(ports.judge_axis(facts)).state is State.PROBLEM


def test_a_connection_is_found_by_the_name_of_its_host(drive):
    port = drive.getsockname()[1]
    assert not ports.is_connected("localhost", port)
    with socket.create_connection(("127.0.0.1", port)):
        assert ports.is_connected("localhost", port)
    assert not ports.is_connected("a..b", port)


def test_axis_findings():
    assert only(ports.judge_axis(Axis("a:502", connect_ms=0.5))).state is State.OK
    assert only(ports.judge_axis(Axis("a:502", connect_ms=30.0))).state is State.WARNING
    refused = only(ports.judge_axis(Axis("a:502", error="Connection refused")))
    assert refused.state is State.PROBLEM
    assert "check the drive's power" in refused.advice
    assert "softarm twin" in only(ports.judge_axis(Axis("127.0.0.1:502", error="Connection refused"))).advice
    port = socket.create_server(("127.0.0.1", 0))
    number = port.getsockname()[1]
    port.close()
    assert ports.look_axis("127.0.0.1", number).error == "Connection refused"


def test_a_used_port_and_a_foreign_address_are_reported(drive):
    taken = drive.getsockname()[1]
    config = Config(api=Api(port=taken, stop_port=0), drivers=Drivers(mocap=Mocap(endpoint=f"tcp/203.0.113.7:{taken}")))
    used, foreign = ports.listening(config, wires=True)
    assert {used.state, foreign.state} == {State.PROBLEM}
    assert f"api.port {taken}: cannot listen there, process {os.getpid()} (" in used.figure
    assert "choose another api.port" in used.figure
    assert foreign.figure.startswith(f"drivers.mocap.endpoint 203.0.113.7:{taken}: cannot listen there (")
    assert "name an address of this machine" in foreign.figure
    assert [each.name for each in ports.listening(config, wires=False)] == ["api.port"]
    drive.close()
    assert only(ports.listening(config, wires=False)).state is State.OK


def test_an_endpoint_without_tcp_is_not_checked():
    config = Config(api=Api(port=0), drivers=Drivers(mocap=Mocap(endpoint="unixpipe/none")))
    assert list(ports.listening(config, wires=True)) == []


def test_an_address_that_cannot_exist_is_reported():
    config = Config(api=Api(host="a..b", stop_port=0), drivers=Drivers(mocap=Mocap(endpoint="tcp/127.0.0.1:0")))
    found = only(ports.listening(config, wires=True))
    assert (found.name, found.state) == ("api.port", State.PROBLEM)
    assert ports.look_axis("a..b", 502).error


def test_an_address_error_without_a_text_of_the_system_is_an_error(monkeypatch):
    def refuse(*_, **__):
        raise OSError("no resolver")

    monkeypatch.setattr(ports.socket, "getaddrinfo", refuse)
    assert ports.look_axis("arm.example", 502).error == "no resolver"


def test_a_silent_ros_router_does_not_prevent_a_flight():
    assert list(ports.ros_router(Ros())) == []
    with socket.create_server(("127.0.0.1", 0)) as router:
        ros = Ros(router=f"tcp/127.0.0.1:{router.getsockname()[1]}", commands="stop")
        found = only(ports.ros_router(ros))
    assert (found.state, found.figure.rpartition("; ")[2]) == (State.OK, "topics under /softarm, commands: stop")
    gone = only(ports.ros_router(ros))
    assert (gone.state, gone.figure) == (State.WARNING, f"{ros.router}: Connection refused")
    assert "rmw_zenohd" in gone.advice
    assert only(ports.ros_router(Ros(router="tcp/exa mple..:1"))).state is State.WARNING
