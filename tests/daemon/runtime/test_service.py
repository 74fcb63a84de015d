"""Notifications to systemd, its watchdog, and the limit of open files."""

import os
import resource
import socket
from itertools import pairwise

import pytest

from softarm.daemon.runtime.service import Notifier, allow_descriptors

S = 1_000_000_000


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """Yield the service manager's notification socket, named in the environment."""
    name = str(tmp_path / "notify") if request.param == "path" else f"@softarm-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind("\0" + name[1:] if name.startswith("@") else name)
        receiver.settimeout(5)
        yield receiver, {"NOTIFY_SOCKET": name}


def test_ready_status_and_stopping_arrive_as_single_messages(manager):
    receiver, environment = manager
    notifier = Notifier(environment)
    notifier.ready("disarmed,\nwaiting")
    notifier.stopping()
    assert [receiver.recv(4096) for _ in range(2)] == [
        b"READY=1\nSTATUS=disarmed, waiting",
        b"STOPPING=1\nSTATUS=stopping",
    ]


def test_only_good_ticks_feed_the_watchdog_twice_per_period(manager):
    receiver, environment = manager
    environment |= {"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": str(os.getpid())}
    notifier = Notifier(environment)
    receiver.settimeout(0)
    with pytest.raises(BlockingIOError):
        receiver.recv(100)  # nothing without a tick
    ticks = [round(k * S / 30) for k in range(90)]
    fed = []
    for now in ticks:
        notifier.good_tick(now)
        try:
            assert receiver.recv(100) == b"WATCHDOG=1"
        except BlockingIOError:
            continue
        fed.append(now)
    gaps = [b - a for a, b in pairwise(fed)]
    assert fed[0] == 0
    assert all(S // 2 <= gap <= S // 2 + S // 30 for gap in gaps)
    assert len(fed) == 6


@pytest.mark.parametrize(
    "environment",
    [{}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "soon"}, {"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}],
)
def test_without_a_watchdog_period_nothing_is_sent(manager, environment):
    receiver, ours = manager
    Notifier(ours | environment).good_tick(0)
    receiver.settimeout(0)
    with pytest.raises(BlockingIOError):
        receiver.recv(100)


@pytest.mark.parametrize("address", ["", "/nowhere/notify", "@no-listener", "/" + "x" * 300])
def test_the_notifier_never_raises(address):
    notifier = Notifier({"WATCHDOG_USEC": "1000"} | ({"NOTIFY_SOCKET": address} if address else {}))
    notifier.ready("up")
    notifier.good_tick(0)


def test_the_notifier_never_blocks(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as deaf:
        deaf.bind(str(tmp_path / "deaf"))
        notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "deaf")})
        for _ in range(2000):  # far more than its queue holds
            notifier.ready("x" * 1000)


@pytest.fixture
def limit_of_files():
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    yield before
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_the_limit_of_open_files_is_raised_as_far_as_granted_and_never_lowered(limit_of_files):
    _, hard = limit_of_files
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, hard))
    assert allow_descriptors(512) == 512
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == (512, hard)
    assert allow_descriptors(100) == 512
    if hard != resource.RLIM_INFINITY:
        assert allow_descriptors(hard + 1) == hard
