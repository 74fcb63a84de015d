"""Serial device, axis, places to listen at: looked at without taking them from anybody."""

import errno
import os
import pty
import socket
from dataclasses import replace

import pytest

from softarm.daemon.doctor import ports
from softarm.daemon.doctor.finding import State
from softarm.daemon.doctor.ports import Axis, Listening, Serial
from softarm.schemas.config import Api, Config, Drivers, Mocap

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
        ({"is_device": False}, "is no serial device"),
        ({"permitted": False}, "usermod -aG dialout ann"),
        ({"permitted": False, "group": "root"}, "udev rule"),
        ({"holder": "softarm, process 7"}, "held by softarm, process 7"),
    ],
)
def test_what_is_wrong_with_the_serial_device(change, says):
    told = only(ports.judge_serial(replace(THERE, **change)))
    assert told.state is State.PROBLEM
    assert says in f"{told.figure}; {told.advice}"
    assert only(ports.judge_serial(THERE)).state is State.OK


def test_a_device_is_looked_at_and_the_twin_behind_one_is_nobody_who_holds_it(tmp_path):
    master, slave = pty.openpty()
    link = tmp_path / "regulator"
    link.symlink_to(os.ttyname(slave))
    try:
        facts = ports.look_serial(str(link))
    finally:
        os.close(slave)
        os.close(master)
    assert (facts.there, facts.is_device, facts.permitted, facts.holder) == (True, True, True, None)


def test_who_has_a_file_open_is_found(tmp_path):
    (tmp_path / "device").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "device")
    assert ports.holder(str(tmp_path / "link")) is None
    with (tmp_path / "device").open():
        assert str(ports.holder(str(tmp_path / "link"))).endswith(f"process {os.getpid()}")


def test_other_devices_are_named_where_the_one_is_not_there(tmp_path):
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


def test_an_axis_is_connected_to_and_sent_nothing(drive):
    facts = ports.look_axis("127.0.0.1", drive.getsockname()[1])
    assert facts.connect_ms is not None
    connection, _ = drive.accept()
    with connection:
        assert connection.recv(1) == b""


def test_an_axis_that_this_computer_leads_is_left_alone(drive):
    port = drive.getsockname()[1]
    with socket.create_connection(("127.0.0.1", port)), drive.accept()[0]:
        facts = ports.look_axis("127.0.0.1", port)
        assert facts.held
        with pytest.raises(TimeoutError):  # nobody else came
            drive.accept()
    assert only(ports.judge_axis(facts)).state is State.PROBLEM


def test_what_is_said_of_the_axis():
    assert only(ports.judge_axis(Axis("a:502", connect_ms=0.5))).state is State.OK
    assert only(ports.judge_axis(Axis("a:502", connect_ms=30.0))).state is State.WARNING
    refused = only(ports.judge_axis(Axis("a:502", error="Connection refused")))
    assert refused.state is State.PROBLEM
    assert "is the drive on" in refused.advice
    assert "softarm twin" in only(ports.judge_axis(Axis("127.0.0.1:502", error="Connection refused"))).advice
    port = socket.create_server(("127.0.0.1", 0))
    number = port.getsockname()[1]
    port.close()
    assert ports.look_axis("127.0.0.1", number).error == "Connection refused"


def test_a_place_that_is_taken_and_one_that_is_not_ours_are_told(drive):
    taken = drive.getsockname()[1]
    config = Config(api=Api(port=taken, stop_port=0), drivers=Drivers(mocap=Mocap(endpoint=f"tcp/203.0.113.7:{taken}")))
    places = {each.key: each.error for each in ports.look_listening(config)}
    assert places == {"api.port": errno.EADDRINUSE, "drivers.mocap.endpoint": errno.EADDRNOTAVAIL}
    told = [*ports.judge_listening(ports.look_listening(config))]
    assert [each.state for each in told] == [State.PROBLEM, State.PROBLEM]
    assert "choose another api.port" in told[0].advice
    assert only(ports.judge_listening((Listening("api.port", "a:1"),))).state is State.OK
    assert "above 1023" in only(ports.judge_listening((Listening("api.port", "a:1", errno.EACCES),))).advice


def test_an_endpoint_that_is_no_tcp_is_not_looked_at():
    config = Config(api=Api(port=0), drivers=Drivers(mocap=Mocap(endpoint="unixpipe/none")))
    assert ports.look_listening(config) == ()
