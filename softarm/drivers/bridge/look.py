"""Inspection of a camera system's stream without publishing."""

import time
from typing import NamedTuple

from softarm.drivers.bridge.bridging import Bridging, NullOutlet, Status
from softarm.drivers.bridge.client import Client
from softarm.drivers.bridge.frame import number_of
from softarm.drivers.bridge.natnet import Body, Vector
from softarm.schemas.bridge import Bridge
from softarm.schemas.messages import BODY_NAMES, Pose

LOOK_NS = 1_000_000_000
# A frame without these bodies is not usable.
NEEDED = ("cart", "link5")


class Row(NamedTuple):
    """One rigid body. `body` is empty if it is not part of the arm; `seen` is its share of the frames."""

    body: str
    rigid_body: str
    id: int | None
    seen: float
    room_m: Vector | None
    pose: tuple[float, float, float] | None


class Found(NamedTuple):
    """Result of an inspection; `problem` is why the daemon cannot use the stream."""

    rows: list[Row]
    status: Status
    problem: str | None


def look_at(config: Bridge, inlet: Client, patience_s: float) -> Found:
    """Inspect the stream for a second after the first frame, which may take up to `patience_s`."""
    bridging = Bridging(config, inlet, NullOutlet(), lambda text: None)
    until_ns = time.monotonic_ns() + round(patience_s * 1e9)
    counted: dict[int, int] = {}
    newest: dict[int, Body] = {}
    poses: dict[str, Pose] = {}
    frames = 0
    while time.monotonic_ns() < until_ns:
        for taken, seen in bridging.step():
            if frames == 0:
                until_ns = time.monotonic_ns() + LOOK_NS
            frames += 1
            for body in taken.frame.bodies:
                counted[body.id] = counted.get(body.id, 0) + body.tracked
                newest |= {body.id: body} if body.tracked or body.id not in newest else {}
            poses |= {name: pose for name, pose in zip(BODY_NAMES, seen, strict=True) if pose.tracked}
    rows = list(_rows(config, inlet, newest, {number: n / frames for number, n in counted.items()}, poses))
    return Found(rows, bridging.status(), _problem(bridging.status(), frames, poses))


def _rows(
    config: Bridge, inlet: Client, newest: dict[int, Body], seen: dict[int, float], poses: dict[str, Pose]
) -> list[Row]:
    ids = inlet.conversation.ids
    names = {number: name for name, number in ids.items()}
    rows, used = [], set()
    for name, mark in config.bodies.used.items():
        number = number_of(name, mark, ids)
        used.add(number)
        share = seen.get(number, 0.0) if number is not None else 0.0
        body = newest[number] if number is not None and share else None
        pose = poses[name][:3] if name in poses else None
        shown = names.get(mark.rigid_body, "") if isinstance(mark.rigid_body, int) else mark.rigid_body or name
        rows.append(Row(name, shown, number, share, body.position_m if body else None, pose))
    for number in sorted(newest.keys() - used):
        place = newest[number].position_m if seen[number] else None
        rows.append(Row("", names.get(number, ""), number, seen[number], place, None))
    return rows


def _problem(status: Status, frames: int, poses: dict[str, Pose]) -> str | None:
    if not frames:
        return status.problem or "no frames arrived"
    unseen = [name for name in NEEDED if name not in poses]
    if unseen:
        remedy = "name them in Motive, or in bodies of bridge.yaml, and bring them into view"
        return status.problem or f"{' and '.join(unseen)} not tracked: the daemon needs these bodies; {remedy}"
    return None
