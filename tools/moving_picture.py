"""Make the animation of the README: the arm swings onto its targets, then the diagnosis finds the faults of a robot.

    python -m tools.moving_picture --out docs/pictures/softarm.gif

No frame is drawn by hand: the flights run the daemon's tick with the shipped policy, the recordings come from an
independent robot with two faults, and the named effects are the diagnosis's. Needs the extras diagnosis and mujoco.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import click
import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont
from rich.console import Console

from benchmarks import diagnosis as campaign
from softarm.daemon.control import workspace
from softarm.daemon.control.records import Inputs, Outputs, TickTiming
from softarm.daemon.runtime.offline import Lockstep
from softarm.diagnosis.data.read import read_all
from softarm.diagnosis.diagnose import diagnose
from softarm.diagnosis.engine.result import Diagnosis, Overlay, Rival
from softarm.policies import registry
from softarm.policies.base import PolicySpec
from softarm.reporting.arm import RADII_M, outline
from softarm.reporting.colours import LIGHT
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_RATE_HZ, RAIL_LIMIT_M

TARGETS = ((-0.05, 0.62), (-0.30, 0.72), (-0.15, 0.78), (-0.40, 0.66), (-0.20, 0.80))
SIZE, FINER = (720, 400), 2  # pixels; drawn at this multiple, then reduced
PX_PER_M = 530  # scale of the plane of the arm
PERIOD_MS, TICKS = 70, 2  # duration of a frame, and control ticks per frame: real time within 5 %
REST_TICKS, HELD_MS = 14, 2600
SHOWN_S = 9.0  # duration shown of a recording
RIVALS = 6
DRAWN = ("ink", "soft", "line", "measured", "requested", "simulated", "patched", "floor", "good", "accent", "arm")
SMALL = {"s": "ms", "kg": "g"}
Point = tuple[float, float]
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Seen:
    """State of the robot at one control tick."""

    bodies: tuple[Point, ...]  # as measured: cart, then the ends of the links
    target: Point
    reached: int  # targets reached so far


class Watched:
    """Recorder that keeps the positions of the bodies."""

    problem: str | None = None
    dropped = 0

    def __init__(self) -> None:
        self.bodies: tuple[Point, ...] = ()

    def policy(self, spec: PolicySpec) -> None:
        """Do nothing, since the policy is not drawn."""

    def tick(self, inputs: Inputs, outputs: Outputs, timing: TickTiming) -> None:
        """Store the bodies of one tick."""
        if inputs.mocap:
            self.bodies = tuple((pose.y_m, pose.z_m) for pose in inputs.mocap[-1].bodies)


def flown(policy: str) -> list[Seen]:
    """Fly to TARGETS one after the other with the daemon's tick on the simulated robot."""
    watched = Watched()
    daemon = Lockstep(Config(), registry.load(policy), recorder=watched)
    daemon.arm()
    seen: list[Seen] = []
    reached = 0
    for target in TARGETS:
        outputs = daemon.tick(daemon.request("goal", Goal("reach", *target)))
        rest = 0
        while rest < REST_TICKS:
            rest += outputs.goal.state != "running"
            seen.append(Seen(watched.bodies, target, reached + (outputs.goal.state == "reached")))
            outputs = daemon.tick()
        reached = seen[-1].reached
    return seen


def diagnosed() -> Diagnosis:
    """Diagnose eight recordings of a robot with a lag and a payload."""
    with tempfile.TemporaryDirectory() as folder:
        return diagnose(read_all([campaign.make_campaign(Path(folder))]), Model())


class Canvas:
    """Frame with lines and text in the pages' colours, on a metre scale for the arm."""

    def __init__(self, title: str, under: str) -> None:
        self._image = Image.new("RGB", (SIZE[0] * FINER, SIZE[1] * FINER), LIGHT["paper"])
        self._draw = ImageDraw.Draw(self._image)
        self.text((28, 24), title, 21, bold=True)
        self.text((28, 54), under, 14, "soft")

    def text(
        self, at: Point, words: str, size: int, colour: str = "ink", bold: bool = False, anchor: str = "la"
    ) -> None:
        """Draw text with an anchor of Pillow."""
        place = at[0] * FINER, at[1] * FINER
        self._draw.text(place, words, LIGHT[colour], font(size * FINER, bold), anchor=anchor)

    def line(self, points: Sequence[Point], colour: str, width: float) -> None:
        """Draw a line through points with round ends."""
        scaled = [(x * FINER, y * FINER) for x, y in points]
        self._draw.line(scaled, LIGHT[colour], round(width * FINER), joint="curve")
        for x, y in (scaled[0], scaled[-1]):
            self.disc((x / FINER, y / FINER), width / 2, colour)

    def disc(self, at: Point, radius: float, colour: str, ring: float = 0.0) -> None:
        """Draw a disc, or a ring of a given width."""
        box = [(at[i % 2] + (radius if i > 1 else -radius)) * FINER for i in range(4)]
        if ring:
            self._draw.ellipse(box, outline=LIGHT[colour], width=round(ring * FINER))
        else:
            self._draw.ellipse(box, fill=LIGHT[colour])

    def box(self, corner: Point, size: Point, colour: str) -> None:
        """Draw a filled rectangle."""
        far = corner[0] + size[0], corner[1] + size[1]
        self._draw.rectangle([x * FINER for x in (*corner, *far)], fill=LIGHT[colour])

    def shape(self, corners: Array, colour: str, edge: str) -> None:
        """Draw a filled polygon with an edge."""
        scaled = [(x * FINER, y * FINER) for x, y in corners.tolist()]
        self._draw.polygon(scaled, fill=LIGHT[colour])
        self._draw.line([*scaled, scaled[0]], LIGHT[edge], round(1.5 * FINER), joint="curve")

    def frame(self) -> Image.Image:
        """Return the picture in its final size."""
        return self._image.resize(SIZE, Image.Resampling.LANCZOS)


@cache
def font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    """Return matplotlib's font in a given size."""
    folder = Path(matplotlib.get_data_path()) / "fonts/ttf"
    return ImageFont.truetype(str(folder / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")), size)


def place(y_m: float, z_m: float) -> Point:
    """Return the pixel of a point of the plane."""
    return SIZE[0] / 2 + 60 + PX_PER_M * y_m, 120 + PX_PER_M * (workspace.HINGE_Z_M - z_m)


def swings(seen: Sequence[Seen]) -> Iterator[Image.Image]:
    """Yield the frames of the arm with the trail of its tip and its target."""
    radius = PX_PER_M * Config().goals.success_radius_m
    for i in range(0, len(seen), TICKS):
        now = seen[i]
        canvas = Canvas(
            "A soft arm swings onto its targets",
            "learned in simulation, flown by the daemon 30 times a second; one muscle, one cart",
        )
        canvas.line([place(-RAIL_LIMIT_M, workspace.HINGE_Z_M), place(RAIL_LIMIT_M, workspace.HINGE_Z_M)], "line", 8)
        done = i > 0 and now.reached > seen[max(0, i - TICKS)].reached
        hit = now.reached > TARGETS.index(now.target)
        target = place(*now.target)
        canvas.disc(target, radius, "good" if hit else "requested", ring=3)
        canvas.disc(target, 4, "good" if hit else "requested")
        if done:
            canvas.disc(target, radius + 6, "good", ring=2)
        trail = [place(*each.bodies[-1]) for each in seen[max(0, i - 45) : i + 1]]
        if len(trail) > 1:
            canvas.line(trail, "measured", 2)
        arm = [place(*point) for point in now.bodies]
        canvas.shape(outline(np.array(arm), (RADII_M[0] * PX_PER_M, RADII_M[1] * PX_PER_M)), "arm", "ink")
        canvas.box((arm[0][0] - 22, arm[0][1] - 10), (44, 20), "ink")
        canvas.disc(arm[-1], 8, "measured")
        canvas.text((SIZE[0] - 28, SIZE[1] - 34), f"{now.reached} of {len(TARGETS)} reached", 16, "soft", anchor="ra")
        canvas.text((SIZE[0] - 28, SIZE[1] - 58), f"{i / CONTROL_RATE_HZ:.1f} s", 16, "soft", anchor="ra")
        yield canvas.frame()


def searched(found: Diagnosis) -> Iterator[tuple[Image.Image, int]]:
    """Yield the frames of the diagnosis with their durations in ms."""
    overlay = _overlay(found)
    head = "Another robot has unknown faults", "measured (black) and simulated (purple)"
    for share in np.linspace(0.08, 1.0, 24):
        canvas = Canvas(*head)
        curves(canvas, overlay, float(share), patched=False)
        yield canvas.frame(), PERIOD_MS
    rivals = _rivals(found)
    for share in np.linspace(0.1, 1.0, 14):
        canvas = Canvas(
            "softarm diagnose weighs every known effect",
            "what the gap loses with each alone, on flights that no fit has seen",
        )
        bars(canvas, rivals, float(share))
        yield canvas.frame(), PERIOD_MS if share < 1 else HELD_MS
    named = " and ".join(effect.name for effect in found.verdict.effects)
    sizes = ", ".join(
        f"{size.value * (1e3 if size.unit in SMALL else 1):.0f} {SMALL.get(size.unit, size.unit)}"
        for effect in found.verdict.effects
        for size in effect.parameters.values()
    )
    canvas = Canvas(
        f"{found.verdict.verdict}: {named}",
        f"{sizes}; with both simulated, the curves coincide (green)",
    )
    curves(canvas, overlay, 1.0, patched=True)
    yield canvas.frame(), 2 * HELD_MS


def curves(canvas: Canvas, overlay: Overlay, share: float, patched: bool) -> None:
    """Draw the measured and simulated curves up to a share of the time."""
    left, top, width, height = 70.0, 100.0, SIZE[0] - 100.0, SIZE[1] - 150.0
    start = window(overlay)
    inside = (overlay.t_s >= start) & (overlay.t_s <= start + SHOWN_S * share)
    whole = (overlay.t_s >= start) & (overlay.t_s <= start + SHOWN_S)
    low, high = np.nanmin(overlay.measured[whole]), np.nanmax(overlay.measured[whole])
    low, high = min(low, np.nanmin(overlay.nominal[whole])), max(high, np.nanmax(overlay.nominal[whole]))

    def drawn(values: Array, colour: str, thick: float) -> None:
        x = left + width * (overlay.t_s[inside] - start) / SHOWN_S
        y = top + height * (high - values[inside]) / (high - low)
        kept = np.isfinite(y)
        canvas.line(list(zip(x[kept].tolist(), y[kept].tolist(), strict=True)), colour, thick)

    for mark in (low, high):
        y = top + height * (high - mark) / (high - low)
        canvas.line([(left, y), (left + width, y)], "line", 1)
        canvas.text((left - 8, y), f"{1e3 * mark:.0f}", 12, "soft", anchor="rm")
    canvas.text((left, top + height + 12), f"{overlay.channel.replace('_', ' ')}, mm, over {SHOWN_S:.0f} s", 12, "soft")
    drawn(overlay.measured, "measured", 4 if patched else 2.5)
    if patched and overlay.patched is not None:
        drawn(overlay.patched, "patched", 2)
    else:
        drawn(overlay.nominal, "simulated", 2.5)


def bars(canvas: Canvas, rivals: Sequence[Rival], share: float) -> None:
    """Draw how much each effect alone explains."""
    for row, rival in enumerate(rivals):
        y = 110 + row * 44
        named = rival.note == "named"
        canvas.text((240, y + 12), " + ".join(rival.names), 14, "ink" if named else "soft", bold=named, anchor="rm")
        canvas.box((256, y), (380 * max(0.0, rival.alone) * share, 24), "patched" if named else "line")
        canvas.text(
            (266 + 380 * max(0.0, rival.alone) * share, y + 12),
            f"{100 * rival.alone * share:.0f} %",
            13,
            "soft",
            anchor="lm",
        )


def palette() -> Image.Image:
    """Return an image with all colours; one palette for all frames keeps the file small."""
    paper, *colours = (np.array(ImageColor.getrgb(LIGHT[name])) for name in ("paper", *DRAWN))
    steps = [paper + (colour - paper) * share for colour in colours for share in np.linspace(0, 1, 16)]
    image = Image.new("P", (1, 1))
    image.putpalette(np.rint(steps).astype(int).ravel().tolist())
    return image


def _overlay(found: Diagnosis) -> Overlay:
    """Return the arm's channel and trial with the largest gap relative to its motion."""
    arm = [each for each in found.overlays if each.stage == "arm" and each.t_s[-1] - each.t_s[0] > SHOWN_S]
    return max(arm, key=lambda each: float(np.nanstd(each.measured - each.nominal)))


def window(overlay: Overlay) -> float:
    """Return the start of the window, where the measured signal moves most."""
    starts = np.arange(overlay.t_s[0], overlay.t_s[-1] - SHOWN_S, 0.5)
    moved = [np.nanstd(overlay.measured[(overlay.t_s >= s) & (overlay.t_s <= s + SHOWN_S)]) for s in starts]
    return float(starts[int(np.argmax(moved))])


def _rivals(found: Diagnosis) -> list[Rival]:
    """Return the named effects and the next ones, best first."""
    tried = [rival for rival in found.rivals if len(rival.names) == 1]
    tried.sort(key=lambda rival: (rival.note != "named", -rival.alone))
    return sorted(tried[:RIVALS], key=lambda rival: -rival.alone)


@click.command()
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="The GIF.")
@click.option("--policy", default="reach", show_default=True)
def main(out: Path, policy: str) -> None:
    """Fly, diagnose and draw, which takes half a minute.

    \b
    Example:
      python -m tools.moving_picture --out docs/pictures/softarm.gif
    """
    console = Console(stderr=True)
    with console.status("flying"):
        frames = [(frame, PERIOD_MS) for frame in swings(flown(policy))]
    with console.status("diagnosing"):
        frames += list(searched(diagnosed()))
    colours = palette()
    pictures = [frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame, _ in frames]
    pictures[0].save(
        out, save_all=True, append_images=pictures[1:], duration=[shown for _, shown in frames], loop=0, optimize=True
    )
    console.print(f"{out}: {len(frames)} frames, {out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
