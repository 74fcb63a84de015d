"""Checks of serial device, drive address, ROS 2 router and the daemon's own ports: present, permitted, free.

The drive gets one TCP connection without data, only if no daemon answers and this computer holds no connection to it.
The serial device is never opened, since that would disturb the program that uses it.
"""

import contextlib
import grp
import os
import socket
import stat
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from softarm.common.finding import Finding, ok, problem, warning
from softarm.daemon.access import sockets
from softarm.daemon.access.sockets import holders
from softarm.drivers.mocap import plugged
from softarm.schemas.base import tcp_address
from softarm.schemas.config import Config, Ros

CONNECT_S = 1.0
SLOW_MS = 8.0  # to connect; exchanges are shorter than a tick
SERIAL = ("serial/by-id/*", "ttyACM*", "softarm-regulator")  # under /dev: where a Teensy shows
ESTABLISHED = "01"
TWIN = "start the twin: `softarm twin --config FILE`"


@dataclass(frozen=True, slots=True)
class Serial:
    """Facts about the regulator's serial device."""

    path: str
    there: bool
    is_device: bool = False
    permitted: bool = False
    group: str = ""
    user: str = ""
    holder: str | None = None  # a process of this computer; the twin's end of a pty is none
    others: tuple[str, ...] = ()  # devices that may be meant


@dataclass(frozen=True, slots=True)
class Axis:
    """Facts about the address of the drive."""

    address: str
    held: bool = False  # somebody of this computer is connected: not tried
    connect_ms: float | None = None
    error: str | None = None


def look_serial(path: str, devices: Path = Path("/dev")) -> Serial:
    """Gather facts about a serial device; `devices` is searched for alternatives."""
    user = os.environ.get("USER") or f"uid {os.geteuid()}"
    try:
        state = os.stat(path)
    except OSError:
        others = (str(each) for pattern in SERIAL for each in sorted(devices.glob(pattern)))
        return Serial(path, False, user=user, others=tuple(others))
    try:
        group = grp.getgrgid(state.st_gid).gr_name
    except KeyError:
        group = str(state.st_gid)
    permitted = os.access(path, os.R_OK | os.W_OK)
    return Serial(path, True, stat.S_ISCHR(state.st_mode), permitted, group, user, holder(path))


def look_axis(host: str, port: int) -> Axis:
    """Connect to the drive and disconnect."""
    address = f"{host}:{port}"
    try:
        families = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        return Axis(address, error=getattr(error, "strerror", None) or str(error))
    if any(is_connected(str(where[0]), port) for *_, where in families):
        return Axis(address, held=True)
    begun_s = time.monotonic()
    try:
        socket.create_connection((host, port), timeout=CONNECT_S).close()
    except TimeoutError:
        return Axis(address, error=f"no answer in {CONNECT_S:g} s")
    except OSError as error:
        return Axis(address, error=error.strerror or str(error))
    return Axis(address, connect_ms=(time.monotonic() - begun_s) * 1e3)


def is_connected(host: str, port: int) -> bool:
    """Return whether this computer holds a connection to an IPv4 address of a host, from /proc/net/tcp."""
    try:
        families = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return False
    numbers = (struct.unpack("=I", socket.inet_aton(str(where[0])))[0] for *_, where in families)
    wanted = [[f"{number:08X}:{port:04X}", ESTABLISHED] for number in numbers]
    return any(row[2:4] in wanted for row in sockets.entries(Path("/proc/net/tcp")))


def holder(path: str) -> str | None:
    """Return the process that has a device open, or None if this user sees none."""
    real = os.path.realpath(path)
    if real.startswith("/dev/pts/"):  # the twin, which is behind it, has it open as well
        return None
    for process in holders({real}):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            return f"{(process / 'comm').read_text().strip()}, process {process.name}"
    return None


def judge_serial(facts: Serial) -> Iterator[Finding]:
    """Yield a finding on the regulator's serial device."""
    if not facts.there and not facts.path.startswith("/dev/"):
        yield problem("regulator", f"{facts.path} is not there", f"{TWIN}, or name a device under /dev")
    elif not facts.there:
        seen = ", ".join(facts.others)
        others = f"or name one of {seen} as drivers.regulator.port" if seen else "see `dmesg` for whether it shows"
        yield problem("regulator", f"{facts.path} is not there", f"plug the Teensy in, {others}")
    elif not facts.is_device:
        yield problem("regulator", f"{facts.path} is no serial device", "name one as drivers.regulator.port")
    elif not facts.permitted:
        join = f"`sudo usermod -aG {facts.group} {facts.user}` and log in again"
        if facts.group == "root":
            join = "install the udev rule (`softarm service install`), which gives it to dialout"
        yield problem("regulator", f"{facts.path} belongs to {facts.group}, not {facts.user}", join)
    elif facts.holder is not None:
        advice = "end that program, which blocks the device"
        yield problem("regulator", f"{facts.path} is held by {facts.holder}", advice)
    else:
        yield ok("regulator", f"{facts.path} is readable and writable")


def judge_axis(facts: Axis) -> Iterator[Finding]:
    """Yield a finding on the address of the drive."""
    if facts.held:
        advice = "a program of this computer uses the drive: end it, or name its daemon with --url"
        yield problem("rail", f"{facts.address} is held by another connection of this computer", advice)
    elif facts.error is not None:
        advice = "check the drive's power, cable and network; else correct drivers.rail.host and port"
        advice = TWIN if facts.address.startswith(("127.", "localhost:")) else advice
        yield problem("rail", f"{facts.address}: {facts.error}", advice)
    elif facts.connect_ms is not None and facts.connect_ms > SLOW_MS:
        advice = f"an exchange with the drive may take {SLOW_MS:g} ms: connect it by cable without a router"
        yield warning("rail", f"{facts.address} took a connection in {facts.connect_ms:.1f} ms", advice)
    else:
        yield ok("rail", f"{facts.address} takes a connection in {facts.connect_ms:.1f} ms")


def ros_router(ros: Ros) -> Iterator[Finding]:
    """Yield a finding on the ROS 2 router, if one is configured; the arm flies without it."""
    if ros.router is None:
        return
    try:
        socket.create_connection(ros.address, timeout=CONNECT_S).close()
    except (OSError, UnicodeError) as error:
        advice = "start it (`ros2 run rmw_zenoh_cpp rmw_zenohd`), or correct ros.router"
        yield warning("ROS 2", f"{ros.router}: {getattr(error, 'strerror', None) or error}", advice)
    else:
        yield ok("ROS 2", f"{ros.router} takes a connection; topics under /{ros.name}, commands: {ros.commands}")


def listening(config: Config, wires: bool) -> Iterator[Finding]:
    """Yield a finding for each TCP port on which the daemon will listen; port 0 is skipped.

    `wires` is false for a robot simulated in the daemon's process, which needs no port for motion capture.
    """
    wanted = [("api.port", config.api.host, config.api.port), ("api.stop_port", config.api.host, config.api.stops_at)]
    mocap = config.drivers.mocap
    if wires and mocap.driver == plugged.BUILT_IN:
        address = tcp_address(mocap.endpoint)
        if address is not None:
            wanted.append(("drivers.mocap.endpoint", *address))
    for key, host, port in wanted:
        try:
            if port:
                sockets.try_out(host, port, key)
                yield ok(key, f"{host}:{port} is free")
        except sockets.ApiError as error:
            yield problem(key, str(error))
