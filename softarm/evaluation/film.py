"""Film of one flight in real time, as a GIF or MP4 file, drawn from the frames of the motion capture."""

import importlib.util
import io
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.daemon.control import workspace
from softarm.daemon.control.records import Inputs, Outputs, TickTiming
from softarm.evaluation.runner import Robot, Runner
from softarm.evaluation.tests import scenarios
from softarm.policies.base import Policy, PolicyError
from softarm.reporting.colours import LIGHT
from softarm.schemas.config import Config
from softarm.schemas.flights import CART_STARTS_M, SHELF_MIDDLE_M, Flight, Scenario
from softarm.schemas.goals import Goal
from softarm.schemas.messages import MocapFrame
from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_RATE_HZ, RAIL_LIMIT_M
from softarm.training.gym_picture import Picture, View

Pixels = NDArray[np.uint8]

KINDS = (".gif", ".mp4")
BYTES_MAX = 2_000_000
LONGEST_S = 10.0
BEFORE_TICKS, AFTER_TICKS = 15, 45  # still pictures at the start and at the end
_COLOURS, _NAME_MAX = 64, 44
_STEPS = (1, 2, 3)  # control ticks per picture of a GIF; the first that keeps the file below BYTES_MAX


class Flown(NamedTuple):
    """One flight with the frames of the motion capture, one for each control tick."""

    scenario: Scenario
    flight: Flight
    frames: list[MocapFrame]


def check(file: Path) -> None:
    """Check that a film can be written as this kind of file on this computer.

    Raises:
        ValueError: The suffix is unknown, or matplotlib or ffmpeg is missing.
    """
    if file.suffix not in KINDS:
        raise ValueError(f"--film {file}: the suffix is '{file.suffix}'; allowed {' or '.join(KINDS)}")
    if importlib.util.find_spec("matplotlib") is None:
        raise ValueError(f"--film {file} needs the package 'matplotlib': pip install 'softarm[train]'")
    if file.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise ValueError(f"--film {file} needs the program ffmpeg, which is missing: install it, or name a .gif file")


def candidates(test: str, target_m: tuple[float, float] | None, config: Config) -> list[Scenario]:
    """Return the flights from rest that a film may show, in the order of preference.

    Args:
        test: The test whose targets and shelf are used.
        target_m: The only target (y, z), or None for the test's targets, highest and farthest first.
        config: Configuration with the workspace.

    Raises:
        ValueError: The daemon refuses the target.
    """
    every = [each._replace(swing=None) for each in scenarios(test)]
    if target_m is None:
        chosen = [each for each in every if each.cart_start_m == CART_STARTS_M[0]] or every
        return sorted(chosen, key=lambda each: (-each.goal.z_m, each.goal.y_m))
    goal = Goal("reach", *target_m)
    if refusals := workspace.refusals(goal, config):
        raise ValueError(f"--target {goal.y_m:g} {goal.z_m:g}: {'; '.join(refusals)}")
    depth_m = None if every[0].depth_m is None else SHELF_MIDDLE_M
    return [Scenario(goal, CART_STARTS_M[0], depth_m=depth_m)]


def fly(policy: Policy, robot: Robot, wanted: Sequence[Scenario], config: Config) -> Flown:
    """Fly scenarios until one reaches its target, and return that flight, or the first one if none does.

    Raises:
        PolicyError: The policy had no answer in the returned flight.
        ValueError: The returned flight is longer than LONGEST_S.
    """
    ticks: list[tuple[Goal | None, MocapFrame | None]] = []

    def record(inputs: Inputs, outputs: Outputs, timing: TickTiming) -> None:
        newest = inputs.mocap[-1] if inputs.mocap else ticks[-1][1] if ticks else None
        ticks.append((outputs.goal.goal, newest))

    runner, first = Runner(policy, robot, config, record), None
    for scenario in wanted:
        ticks.clear()
        flight = runner.fly(scenario)
        frames = [frame for goal, frame in ticks if goal == scenario.goal and frame is not None]
        first = first or Flown(scenario, flight, frames)
        if flight.reached:
            first = Flown(scenario, flight, frames)
            break
    assert first is not None, "there is at least one scenario"
    goal, refusal, ticks_flown = first.scenario.goal, first.flight.refusal, first.flight.ticks
    if refusal is not None:
        raise PolicyError(f"--film: the policy has no answer for the target ({goal.y_m:g}, {goal.z_m:g}): {refusal}")
    if ticks_flown > LONGEST_S * CONTROL_RATE_HZ:
        raise ValueError(
            f"--film: the flight lasts {ticks_flown / CONTROL_RATE_HZ:.0f} s; allowed up to {LONGEST_S:g} s: "
            "lower goals.time_limit_s, or choose another --target"
        )
    return first


def encode(name: str, flown: Flown, robot: Robot, config: Config, suffix: str) -> bytes:
    """Return the content of a film's file.

    Args:
        name: Name of the policy, which the film shows.
        flown: The flight.
        robot: The robot that flew; the independent one is drawn with the seed's dimensions of the rail.
        config: Configuration of the flight.
        suffix: One of KINDS.

    Raises:
        ValueError: A GIF would exceed BYTES_MAX, or ffmpeg failed.
    """
    model = robot if isinstance(robot, Model) else Model()
    pictures = list(_pictures(name, flown, model, config.goals.success_radius_m))
    pictures = pictures[:1] * BEFORE_TICKS + pictures + pictures[-1:] * AFTER_TICKS
    return _mp4(pictures) if suffix == ".mp4" else _gif(pictures)


def sentence(name: str, flown: Flown) -> str:
    """Return a sentence about the flight of a film."""
    goal, status = flown.scenario.goal, flown.flight.status
    closest = "" if status.closest_m is None else f", closest {1e3 * status.closest_m:.0f} mm"
    stop = "" if flown.flight.stop is None else f"; {flown.flight.stop}"
    result = "reached" if flown.flight.reached else "missed"
    return f"film: {name}, target y {goal.y_m:g}, z {goal.z_m:g} m {result} in {status.time_s:.1f} s{closest}{stop}"


def _pictures(name: str, flown: Flown, model: Model, radius_m: float) -> Iterator[Pixels]:
    """Yield a picture of each control tick."""
    scenario = flown.scenario
    target = np.array((scenario.goal.y_m, scenario.goal.z_m), dtype=np.float32)
    shelf = None if scenario.shelf_m is None else np.array(scenario.shelf_m, dtype=np.float32)
    picture = Picture(model, RAIL_LIMIT_M, radius_m)
    shown = name if len(name) <= _NAME_MAX else f"…{name[1 - _NAME_MAX :]}"
    text = f"{shown}\ntarget y {target[0]:.2f}, z {target[1]:.2f} m"
    picture.figure.text(0.985, 0.965, text, ha="right", va="top", color=LIGHT["ink"], fontsize=11, family="monospace")
    for number, frame in enumerate(flown.frames):
        cart, *links = frame.bodies
        ends = np.array([(pose.y_m, pose.z_m) for pose in links], dtype=np.float32)
        reached = flown.flight.reached and number == len(flown.frames) - 1
        picture.draw(View(number / CONTROL_RATE_HZ, cart.y_m, ends, target, reached, shelf))
        yield picture.pixels()


def _gif(pictures: Sequence[Pixels]) -> bytes:
    from PIL import Image

    # One palette for all pictures keeps the file small; the last one has the colour of the result.
    both = Image.fromarray(np.concatenate((pictures[0], pictures[len(pictures) // 2], pictures[-1])))
    palette = both.quantize(_COLOURS, dither=Image.Dither.NONE)
    for step in _STEPS:
        images = [
            Image.fromarray(each).quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures[::step]
        ]
        # A GIF counts hundredths of a second: 3, 3 and 4 of them are three ticks.
        ends = [round(100 * step * number / CONTROL_RATE_HZ) for number in range(len(images) + 1)]
        durations_ms = [10 * (end - start) for start, end in pairwise(ends)]
        content = io.BytesIO()
        options = {"save_all": True, "append_images": images[1:], "duration": durations_ms, "loop": 0}
        images[0].save(content, "GIF", optimize=True, **options)
        if (size := len(content.getvalue())) <= BYTES_MAX:
            return content.getvalue()
    raise ValueError(
        f"--film: the GIF has {size / 1e6:.1f} MB; allowed {BYTES_MAX / 1e6:g} MB: choose another --target"
    )


def _mp4(pictures: Sequence[Pixels]) -> bytes:
    height, width, _ = pictures[0].shape
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "film.mp4"
        source = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{CONTROL_RATE_HZ:g}")
        target = ("-pix_fmt", "yuv420p", "-movflags", "+faststart", str(file))
        command = ["ffmpeg", "-loglevel", "error", "-y", *source, "-i", "-", *target]
        done = subprocess.run(
            command, input=b"".join(map(np.ndarray.tobytes, pictures)), capture_output=True, check=False
        )
        if done.returncode or not file.is_file():
            said = done.stderr.decode(errors="replace").strip().splitlines() or [f"exit code {done.returncode}"]
            raise ValueError(f"--film: ffmpeg failed: {said[-1]}; name a .gif file instead")
        return file.read_bytes()
