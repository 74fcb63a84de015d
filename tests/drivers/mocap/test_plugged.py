"""Motion capture from a plug-in: the loop receives valid frames or a sentence."""

import contextlib
import math
import threading
from collections.abc import AsyncIterator, Callable
from typing import Any

import numpy as np
import pytest

from softarm.common.plugins import PluginError
from softarm.daemon.runtime.devices import motion_capture
from softarm.drivers.mocap import plugged
from softarm.drivers.mocap.plugged import PluggedMocapSource
from softarm.drivers.mocap.source import Frames, Source
from softarm.schemas.config import Mocap
from softarm.schemas.messages import BODY_NAMES

pytestmark = pytest.mark.anyio
POSES = {name: (0.1 * i, 0.9 - 0.1 * i, 0.01 * i) for i, name in enumerate(BODY_NAMES)}


class Scripted:
    """Source that runs a test's functions in its thread."""

    description = "a script"

    def __init__(self, *runs: Any) -> None:
        self.runs, self.started = list(runs), 0

    def run(self, frames: Frames) -> None:
        self.started += 1
        script = self.runs.pop(0) if self.runs else _wait
        script(frames)


def _wait(frames: Frames) -> None:
    while frames.are_wanted:
        frames.wait(10.0)


def _fail(frames: Frames) -> None:
    raise OSError("port 9000\nis in use")


@pytest.fixture
def played(clock: Any, running: Any) -> Callable[[Scripted], Any]:
    """Context of a device that runs a source."""

    @contextlib.asynccontextmanager
    async def played(source: Scripted) -> AsyncIterator[PluggedMocapSource]:
        device = PluggedMocapSource("scripted", source, clock)
        async with running(device):
            yield device

    return played


async def test_frames_arrive_in_order_with_the_stamps_of_capture_and_arrival(
    played: Any, clock: Any, until: Any
) -> None:
    def source(frames: Frames) -> None:
        for sequence in (0, 1, 3):
            frames.put(sequence, 10 + sequence, POSES | {"link2": None})
        _wait(frames)

    async with played(Scripted(source)) as device:
        await until(lambda: device.frames == 3)
        frames = device.read(clock())
        assert [(frame.sequence, frame.t_capture_ns) for frame in frames] == [(0, 10), (1, 11), (3, 13)]
        assert {frame.t_receive_ns for frame in frames} == {clock()}
        assert [pose.tracked for pose in frames[0].bodies] == [True, True, False, True, True, True]
        assert frames[0].bodies[5][:3] == POSES["link5"]
        assert device.problem() is None
        assert device.read(clock()) == ()
        clock.advance(0.2)
        assert "motion capture source 'scripted': read: no frame for 0.2 s; check the cameras and the bridge" in (
            device.problem() or ""
        )


async def test_an_invalid_frame_is_counted_and_reported(played: Any, clock: Any, until: Any) -> None:
    bad: tuple[Any, ...] = ((1.5, POSES), (1, None), (1, {"cart": "abc"}), (1, {"cart": (0.0, math.nan, 0.0)}))

    def source(frames: Frames) -> None:
        frames.put(0, 10, POSES)
        for sequence, bodies in bad:
            frames.put(sequence, 20, bodies)
        frames.put(1, 10, POSES)
        frames.put(2, np.int64(30).item(), {name: np.array(pose) for name, pose in POSES.items()})
        _wait(frames)

    async with played(Scripted(source)) as device:
        await until(lambda: device.frames == 2)
        assert (device.malformed, device.misplaced) == (4, 1)
        assert [frame.sequence for frame in device.read(clock())] == [0, 2]
        assert "no newer than the last: repeated, or two bridges publish (4 malformed, 1 misp" in (
            device.problem() or ""
        )
        clock.advance(1.1)
        assert "no frame for 1.1 s" in (device.problem() or "")


async def test_input_refused_by_a_source_is_counted_and_reported(played: Any, until: Any) -> None:
    def source(frames: Frames) -> None:
        frames.refuse("7 words; allowed are 10")
        _wait(frames)

    async with played(Scripted(source)) as device:
        await until(lambda: device.malformed == 1)
        assert "a frame is malformed: 7 words; allowed are 10 (1 malformed" in (device.problem() or "")


async def test_a_source_that_raises_or_returns_is_reported_and_restarted(
    played: Any, until: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plugged, "RETRY_S", 0.01)
    again = threading.Event()

    def leave(frames: Frames) -> None:
        raise SystemExit(3)

    def work(frames: Frames) -> None:
        assert again.wait(20)
        frames.put(0, 10, POSES)
        _wait(frames)

    source = Scripted(lambda frames: None, leave, _fail, work)

    async with played(source) as device:
        await until(lambda: source.started == 4)
        assert "run: run raised OSError: port 9000 is in use; correct the source; it is restarted every second" in (
            device.problem() or ""
        )
        again.set()
        await until(lambda: device.frames == 1)
        await until(lambda: device.problem() is None)


async def test_a_source_ends_on_request(played: Any, until: Any) -> None:
    ended = threading.Event()

    def source(frames: Frames) -> None:
        _wait(frames)
        ended.set()

    async with played(Scripted(source)) as device:
        await until(lambda: "no frame yet" in (device.problem() or ""))
    assert ended.is_set()


MINE = """
    class Mine:
        description = "mine"
        def __init__(self, port: int = 1):
            self.port = port
        def run(self, frames):
            pass

    class Newer(Mine):
        interface = 2

    class Mute:
        description = "it runs nowhere"

    class Broken(Mine):
        def __init__(self):
            raise OSError("no such camera")
"""


def test_the_daemon_uses_the_source_in_its_configuration(install: Any) -> None:
    install("theirs", MINE, "softarm.mocap_sources", mine="Mine")
    assert plugged.names() == ("zenoh", "mine")
    device = motion_capture(Mocap(driver="mine", options={"port": 7}))
    assert isinstance(device, PluggedMocapSource)
    assert isinstance(device._source, Source)
    assert device._source.port == 7


@pytest.mark.parametrize(
    ("driver", "options", "text"),
    [
        ("mihne", {}, r"no motion capture source 'mihne'; did you mean 'mine'\? \(installed: .*mine.*zenoh\)"),
        ("mine", {"prt": 7}, r"has no option 'prt'; did you mean 'port'\?"),
        ("newer", {}, "was written for interface 2, this software speaks 1"),
        ("mute", {}, "lacks description or run"),
        ("broken", {}, "OSError: no such camera"),
    ],
)
def test_an_unusable_source_is_reported_at_the_start(
    driver: str, options: dict[str, Any], text: str, install: Any
) -> None:
    install("theirs", MINE, "softarm.mocap_sources", mine="Mine", newer="Newer", mute="Mute", broken="Broken")
    with pytest.raises(PluginError, match=rf"drivers.mocap.driver '{driver}': .*{text}"):
        motion_capture(Mocap(driver=driver, options=options))


def test_options_without_a_plugin_are_refused() -> None:
    with pytest.raises(ValueError, match="options port are a plugin's: name it as driver, or remove them"):
        Mocap(driver="zenoh", options={"port": 1})
