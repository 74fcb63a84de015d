"""The robot as Foxglove's messages: coordinate frames and solids, in metres. Pure.

World: y along the rail, z up, x out of the arm's plane. An arm that hangs straight down is turned by zero about x.
"""

import math
from collections.abc import Sequence
from typing import Any

from softarm.recordings import flight
from softarm.schemas.config import Config
from softarm.schemas.flights import BOARD_BELOW_M
from softarm.schemas.goals import GoalStatus
from softarm.schemas.messages import BODY_NAMES, MocapFrame
from softarm.schemas.model import Arm
from softarm.schemas.robot import RAIL_TRAVEL_M

Json = dict[str, Any]
Colour = tuple[float, float, float, float]

WORLD, RAIL = "world", "rail"
CART_M, RAIL_M, WALL_M = (0.08, 0.09, 0.04), 0.02, 0.12  # as it is drawn; no measure of the real ones is known
BEAM_RADII_M = (0.030, 0.024)  # at the cart, at the tip
BOARD_M = (0.20, 0.25, 0.006)  # x, behind the front edge, thickness

GREY, DARK = (0.55, 0.55, 0.55, 1.0), (0.25, 0.26, 0.28, 1.0)
ORANGE, RED, BLUE = (0.90, 0.60, 0.0, 0.9), (0.84, 0.15, 0.15, 0.9), (0.34, 0.71, 0.91, 1.0)
BEAM, WOOD = (0.93, 0.90, 0.82, 1.0), (0.72, 0.53, 0.33, 0.9)
BY_STATE = {"running": ORANGE, "reached": (0.0, 0.62, 0.45, 0.9), "failed": RED, "cancelled": GREY}


def time_of(ns: int) -> Json:
    """A stamp of the wall clock."""
    return {"sec": ns // 1_000_000_000, "nsec": ns % 1_000_000_000}


def fixed_frames(ns: int) -> Json:
    """foxglove.FrameTransforms of what never moves: the rail's middle, at the height of the arm's hinge."""
    return {"transforms": [_transform(time_of(ns), WORLD, RAIL, 0.0, Arm().base_height_m, 0.0)]}


def frames(frame: MocapFrame, ns: int) -> Json:
    """foxglove.FrameTransforms of the cart and of each link's far end; a body that was not seen is left out."""
    stamp = time_of(ns)
    seen = zip(BODY_NAMES, frame.bodies, strict=True)
    finite = [(name, body) for name, body in seen if body.tracked and all(map(math.isfinite, body[:3]))]
    return {"transforms": [_transform(stamp, WORLD, name, b.y_m, b.z_m, b.angle_rad) for name, b in finite]}


def robot(config: Config, ns: int) -> Json:
    """foxglove.SceneUpdate of rail, cart, links and tip; they move with their frames."""
    soft, arm = config.limits.rail, Arm()
    walls = [
        *(_box((0.0, y, 0.0), (WALL_M, 0.004, WALL_M), ORANGE) for y in (soft.position_min_m, soft.position_max_m)),
        *(_box((0.0, y, 0.0), (WALL_M, 0.008, WALL_M), RED) for y in (-RAIL_TRAVEL_M, RAIL_TRAVEL_M)),
    ]
    names = [
        _text((0.0, soft.position_min_m, 0.10), f"soft limit {soft.position_min_m:g} m"),
        _text((0.0, soft.position_max_m, 0.10), f"soft limit {soft.position_max_m:g} m"),
    ]
    beam = _box((0.0, 0.0, 0.03), (RAIL_M, 2 * RAIL_TRAVEL_M, RAIL_M), GREY)
    tip = BODY_NAMES[-1]
    return _update(
        ns,
        _entity(ns, RAIL, "rail", cubes=[beam, *walls], texts=names),
        _entity(ns, BODY_NAMES[0], "cart", cubes=[_box((0.0, 0.0, 0.02), CART_M, DARK)]),
        *(_entity(ns, name, name, cylinders=[_link(i, arm)]) for i, name in enumerate(BODY_NAMES[1:])),
        _entity(ns, tip, "tip", spheres=[_ball((0.0, 0.0, 0.0), 0.02, BLUE)]),
    )


def target(status: GoalStatus, radius_m: float, ns: int) -> Json:
    """foxglove.SceneUpdate of the target and the sphere that counts as reached; empty without one."""
    goal = status.goal
    if goal is None or not (math.isfinite(goal.y_m) and math.isfinite(goal.z_m)):
        return _update(ns)
    at = (0.0, goal.y_m, goal.z_m)
    colour = BY_STATE.get(status.state, GREY)
    balls = [_ball(at, radius_m, (*colour[:3], 0.3)), _ball(at, 0.006, colour)]
    return _update(ns, _entity(ns, WORLD, "target", spheres=balls))


def trail(places: Sequence[tuple[float, float]], ns: int) -> Json:
    """foxglove.SceneUpdate of a line through the tip's last places: (y, z) in metres, two or more, else it is empty."""
    if len(places) < 2:
        return _update(ns)
    points = [_xyz((0.0, round(y, 4), round(z, 4))) for y, z in places]
    line = {"type": 0, "pose": _pose((0.0, 0.0, 0.0)), "points": points, "color": _rgba(BLUE), "colors": []}
    line |= {"thickness": 2.0, "scale_invariant": True, "indices": []}
    return _update(ns, _entity(ns, WORLD, "trail", lines=[line]))


def shelf(status: GoalStatus, policy: str, config: Config, ns: int) -> Json:
    """foxglove.SceneUpdate of the shelf's board, which a target on the shelf implies; empty where nothing implies it.

    A goal does not say that it lies on a shelf; the policy that flies it does.
    """
    goal, depth_m = status.goal, flight.shelf_depth_m(policy, config)
    if goal is None or depth_m is None or not math.isfinite(goal.y_m):
        return _update(ns)
    edge_m, thick_m = goal.y_m + depth_m, BOARD_M[2]
    middle = (0.0, edge_m - BOARD_M[1] / 2, goal.z_m - BOARD_BELOW_M - thick_m / 2)
    return _update(ns, _entity(ns, WORLD, "shelf", cubes=[_box(middle, BOARD_M, WOOD)]))


def _transform(stamp: Json, parent: str, child: str, y_m: float, z_m: float, angle_rad: float) -> Json:
    """A turn about x; six decimals are a micrometre."""
    half = angle_rad / 2
    return {
        "timestamp": stamp,
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": {"x": 0.0, "y": round(y_m, 6), "z": round(z_m, 6)},
        "rotation": {"x": round(math.sin(half), 6), "y": 0.0, "z": 0.0, "w": round(math.cos(half), 6)},
    }


def _update(ns: int, *entities: Json) -> Json:
    """A whole scene: what was there before on its topic is gone, so that the newest message alone shows all."""
    gone = {"timestamp": time_of(ns), "type": 1, "id": ""}
    return {"deletions": [gone], "entities": list(entities)}


_KINDS = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")


def _entity(ns: int, frame: str, name: str, **solids: list[Json]) -> Json:
    return {
        "timestamp": time_of(ns),
        "frame_id": frame,
        "id": name,
        "lifetime": time_of(0),
        "frame_locked": True,
        "metadata": [],
        **{kind: solids.get(kind, []) for kind in _KINDS},
    }


def _link(index: int, arm: Arm) -> Json:
    """A piece of the tapering beam, from the frame at its far end back to the one before."""
    length_m, count = arm.link_length_m[index], arm.links
    near, far = (BEAM_RADII_M[0] + (BEAM_RADII_M[1] - BEAM_RADII_M[0]) * (index + i) / count for i in (0, 1))
    size = _xyz((2 * near, 2 * near, length_m))
    solid = {"pose": _pose((0.0, 0.0, length_m / 2)), "size": size, "color": _rgba(BEAM)}
    return solid | {"bottom_scale": round(far / near, 3), "top_scale": 1.0}


def _box(middle: Sequence[float], size: Sequence[float], colour: Colour) -> Json:
    return {"pose": _pose(middle), "size": _xyz(size), "color": _rgba(colour)}


def _ball(middle: Sequence[float], radius_m: float, colour: Colour) -> Json:
    return _box(middle, (2 * radius_m,) * 3, colour)


def _text(at: Sequence[float], text: str) -> Json:
    told = {"pose": _pose(at), "text": text, "color": _rgba(DARK)}
    return told | {"billboard": True, "font_size": 0.028, "scale_invariant": False}


def _pose(at: Sequence[float]) -> Json:
    return {"position": _xyz(at), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


def _xyz(numbers: Sequence[float]) -> Json:
    return dict(zip("xyz", numbers, strict=True))


def _rgba(colour: Colour) -> Json:
    return dict(zip("rgba", colour, strict=True))
