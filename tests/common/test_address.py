"""Addresses of servers on this computer."""

import httpx
import pytest

from softarm.common.address import is_loopback, is_shared, local_url


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("::1", "http://[::1]:8080"),
        ("::", "http://127.0.0.1:8080"),
        ("0.0.0.0", "http://127.0.0.1:8080"),
        ("arm.example", "http://arm.example:8080"),
    ],
)
def test_the_url_of_a_server_on_this_computer_is_valid(host: str, url: str) -> None:
    assert local_url(host, 8080) == url
    assert httpx.URL(url).port == 8080


@pytest.mark.parametrize("expected", [True, False])
def test_loopback_is_known(expected):
    hosts = {True: "127.0.0.1 127.9.9.9 ::1 localhost", False: "0.0.0.0 192.168.1.4 robot.example"}
    assert {is_loopback(host) for host in hosts[expected].split()} == {expected}


@pytest.mark.parametrize(
    ("host", "other", "shared"),
    [
        ("127.0.0.1", "localhost", True),
        ("0.0.0.0", "10.0.0.2", True),
        ("10.0.0.2", "::", True),
        ("10.0.0.2", "10.0.0.2", True),
        ("10.0.0.2", "127.0.0.1", False),
        ("10.0.0.2", "10.0.0.3", False),
    ],
)
def test_servers_share_a_port_unless_their_networks_differ(host: str, other: str, shared: bool) -> None:
    assert is_shared(host, other) is shared
