"""Tests of `softarm bridge`."""

import json
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
import yaml

from softarm.drivers.bridge.bridging import read
from softarm.drivers.bridge.calibration import rest_shape
from softarm.drivers.twin.motive import Motive
from softarm.schemas.bridge import Room
from softarm.schemas.messages import BODY_NAMES, Pose
from tests.cli.invoke import refuse, succeed
from tests.drivers.bridge.streaming import Streaming
from tests.processes import free_port, running


def ask(*arguments: object) -> Any:
    return succeed("bridge", *arguments)


@pytest.fixture
def poses() -> dict[str, Pose]:
    """Return the poses that the server streams."""
    return {name: Pose(0.1, 0.965 - 0.0885 * i, 0.0, tracked=True) for i, name in enumerate(BODY_NAMES)}


@pytest.fixture
def server() -> Iterator[Motive]:
    """Run a server."""
    with Motive() as served:
        yield served


@pytest.fixture
def stream(server: Motive, poses: dict[str, Pose]) -> Iterator[Streaming]:
    """Stream these poses from the server."""
    with Streaming(server, poses, Room()) as streaming:
        yield streaming


@pytest.fixture
def file(server: Motive, stream: Streaming, tmp_path: Path) -> Path:
    """Return a bridge.yaml for this server and a daemon that does not run."""
    path = tmp_path / "bridge.yaml"
    settings = {
        "server": "127.0.0.1",
        "command_port": server.port,
        "daemon": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
    }
    path.write_text(yaml.safe_dump(settings))
    return path


@pytest.mark.slow
def test_natnet_once_shows_every_body_and_what_the_daemon_lacks(file: Path, poses: dict[str, Pose]) -> None:
    answer = ask("natnet", "--config", file, "--once", "--json")
    answered = json.loads(answer.stdout)
    assert [body["body"] for body in answered["bodies"]] == list(BODY_NAMES)
    assert answered["bodies"][5]["pose"] == pytest.approx([0.1, 0.5225, 0.0], abs=1e-6)
    assert answered["problem"] is None
    assert "Motive 3.1.0.0 uses NatNet 4.1, unicast" in answer.stderr
    poses["link5"] = poses["link5"]._replace(tracked=False)
    message = "link5 not tracked: the daemon needs these bodies"
    answer = refuse(message, "bridge", "natnet", "--config", file, "--once")
    assert "+0.100 0.965 m +0.000 rad" in answer.stdout


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sever: 1.2.3.4", "bridge.yaml:1: sever: unknown key; did you mean server?"),
        ("room: {yaw_rad: 90}", "room.yaw_rad: is 90; allowed -3.14159 to 3.14159 rad"),
        ("bodies: {cart: {hanging: [0, 0, 0, 0.5]}}", "hanging must be a unit quaternion"),
        ("bodies: {cart: {rigid_body: link1}}", "bodies.link1.rigid_body is 'link1', which is cart already"),
    ],
)
def test_a_mistake_in_the_file_is_reported(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bridge.yaml"
    path.write_text(f"{text}\n")
    refuse(message, "bridge", "natnet", "--config", path, "--server", "127.0.0.1")


def arm(cart_m: float) -> dict[str, Pose]:
    """Return the poses of an arm that hangs at rest below the cart."""
    return {name: Pose(cart_m + at.y_m, 0.965 + at.z_m, at.angle_rad) for name, at in rest_shape().items()}


@pytest.mark.slow
def test_a_calibration_writes_a_file_with_which_the_arm_is_tracked(
    file: Path, stream: Streaming, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def show(text: str) -> None:
        click.echo(text, err=True)
        if "now push" in text:
            path = [*np.linspace(-0.2, -0.3, 41), *[-0.3] * 20, *np.linspace(-0.3, 0.3, 121)]
            stream.motion = map(arm, path)

    monkeypatch.setattr("softarm.cli.bridge.warn", show)
    # Shorter than the times at rest that a real arm needs.
    monkeypatch.setattr("softarm.drivers.bridge.gathering.REST_NS", 300_000_000)
    monkeypatch.setattr("softarm.drivers.bridge.gathering.STAND_NS", 300_000_000)
    stream.motion = iter([arm(-0.2)])
    out = tmp_path / "found.yaml"
    answer = ask("calibrate", "--config", file, "--end", "+y", "--out", out)
    assert "it hangs still; now push the cart slowly along the rail to one stop, then to the other" in answer.stderr
    assert f"next: `softarm bridge natnet --config {out} --once`" in answer.stdout
    found = read(out)
    assert found.command_port == read(file).command_port
    assert found.daemon == read(file).daemon
    assert found.room.yaw_rad == pytest.approx(0.0, abs=1e-4)
    assert found.room.origin_m == pytest.approx((0.0, 0.0, 0.0), abs=0.002)
    look = json.loads(ask("natnet", "--config", out, "--once", "--json").stdout)
    assert look["bodies"][5]["pose"] == pytest.approx(arm(0.3)["link5"][:3], abs=0.002)
    message = f"{out}: exists and was not changed; name another --out, or give --replace"
    refuse(message, "bridge", "calibrate", "--config", file, "--end", "+y", "--out", out)


@pytest.mark.slow
def test_ctrl_c_ends_the_bridge_and_it_reports_the_consequence(file: Path) -> None:
    with running("bridge", "natnet", "--config", file, "--json", stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        status: dict[str, Any] = {"rate_hz": 0}
        deadline = time.monotonic() + 30
        while status["rate_hz"] < 10 and time.monotonic() < deadline:
            status = json.loads(process.stdout.readline())
        assert status["counts"]["without_daemon"] > 0
        assert not status["daemon_listens"]
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "an arm in flight makes a soft stop" in stderr
