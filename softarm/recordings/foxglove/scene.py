"""Robot as Foxglove messages: coordinate frames and solids, in metres.

World: y along the rail, z up, x out of the arm's plane. A straight arm has zero rotation about x.
"""

import math
from collections.abc import Sequence
from typing import Any

from softarm.recordings import flight
from softarm.reporting.arm import RADII_M
from softarm.reporting.colours import LIGHT, on_any_ground, rgb
from softarm.schemas.config import Config
from softarm.schemas.goals import GoalStatus
from softarm.schemas.messages import BODY_NAMES, MocapFrame
from softarm.schemas.model import Arm
from softarm.schemas.robot import RAIL_TRAVEL_M

Json = dict[str, Any]
Colour = tuple[float, float, float, float]

WORLD, RAIL = "world", "rail"
CART_M, RAIL_M, WALL_M = (0.08, 0.09, 0.04), 0.02, 0.12  # for the drawing; the real dimensions are unknown
BOARD_M = (0.20, 0.25, 0.006)  # width, depth behind the front edge, thickness

GREY, STEEL = (*on_any_ground("floor"), 1.0), (*on_any_ground("soft"), 1.0)
LIMIT, STOP, TIP = (*on_any_ground("warning"), 0.9), (*on_any_ground("stop"), 0.9), (*on_any_ground("measured"), 1.0)
BEAM, WOOD = (*rgb(LIGHT["arm"]), 1.0), (*rgb(LIGHT["board"]), 0.9)
REQUESTED, REACHED = (*on_any_ground("requested"), 0.9), (*on_any_ground("good"), 0.9)
BY_STATE = {"running": REQUESTED, "reached": REACHED, "failed": STOP, "cancelled": GREY}


def time_of(ns: int) -> Json:
    """Return a stamp of the wall clock."""
    return {"sec": ns // 1_000_000_000, "nsec": ns % 1_000_000_000}


def fixed_frames(ns: int) -> Json:
    """Return foxglove.FrameTransforms of the rail's middle at the height of the arm's hinge."""
    return {"transforms": [_transform(time_of(ns), WORLD, RAIL, 0.0, Arm().base_height_m, 0.0)]}


def frames(frame: MocapFrame, ns: int) -> Json:
    """Return foxglove.FrameTransforms of the cart and of the far end of each link, without untracked bodies."""
    stamp = time_of(ns)
    seen = zip(BODY_NAMES, frame.bodies, strict=True)
    finite = [(name, body) for name, body in seen if body.tracked and all(map(math.isfinite, body[:3]))]
    return {"transforms": [_transform(stamp, WORLD, name, b.y_m, b.z_m, b.angle_rad) for name, b in finite]}


def robot(config: Config, ns: int) -> Json:
    """Return foxglove.SceneUpdate of rail, cart, links and tip, which move with their frames."""
    soft_m, arm = (config.limits.rail.position_min_m, config.limits.rail.position_max_m), Arm()
    walls = [
        *(_box((0.0, y, 0.0), (WALL_M, 0.004, WALL_M), LIMIT) for y in soft_m),
        *(_box((0.0, y, 0.0), (WALL_M, 0.008, WALL_M), STOP) for y in (-RAIL_TRAVEL_M, RAIL_TRAVEL_M)),
    ]
    names = [_text((0.0, y, 0.10), f"soft limit {y:g} m") for y in soft_m]
    beam = _box((0.0, 0.0, 0.03), (RAIL_M, 2 * RAIL_TRAVEL_M, RAIL_M), GREY)
    tip = BODY_NAMES[-1]
    return _update(
        ns,
        _entity(ns, RAIL, "rail", cubes=[beam, *walls], texts=names),
        _entity(ns, BODY_NAMES[0], "cart", cubes=[_box((0.0, 0.0, 0.02), CART_M, STEEL)]),
        *(_entity(ns, name, name, cylinders=[_link(i, arm)]) for i, name in enumerate(BODY_NAMES[1:])),
        _entity(ns, tip, "tip", spheres=[_ball((0.0, 0.0, 0.0), 0.02, TIP)]),
    )


def target(status: GoalStatus, radius_m: float, ns: int) -> Json:
    """Return foxglove.SceneUpdate of the target and the sphere that counts as reached; empty without a target."""
    goal = status.goal
    if goal is None or not (math.isfinite(goal.y_m) and math.isfinite(goal.z_m)):
        return _update(ns)
    at = (0.0, goal.y_m, goal.z_m)
    colour = BY_STATE.get(status.state, GREY)
    balls = [_ball(at, radius_m, (*colour[:3], 0.3)), _ball(at, 0.006, colour)]
    return _update(ns, _entity(ns, WORLD, "target", spheres=balls))


def trail(places: Sequence[tuple[float, float]], ns: int) -> Json:
    """Return foxglove.SceneUpdate of a line through the last tip positions (y, z) in m; empty with fewer than two."""
    if len(places) < 2:
        return _update(ns)
    points = [_xyz((0.0, round(y, 4), round(z, 4))) for y, z in places]
    line = {"type": 0, "pose": _pose((0.0, 0.0, 0.0)), "points": points, "color": _rgba(TIP), "colors": []}
    line |= {"thickness": 2.0, "scale_invariant": True, "indices": []}
    return _update(ns, _entity(ns, WORLD, "trail", lines=[line]))


def shelf(status: GoalStatus, policy: str, config: Config, ns: int) -> Json:
    """Return foxglove.SceneUpdate of the shelf's board; empty unless the policy flies to a shelf.

    The policy and not the goal determines whether there is a shelf.
    """
    shelf_m = None if status.goal is None else flight.shelf_m(status.goal, policy, config)
    if shelf_m is None or not math.isfinite(shelf_m[0]):
        return _update(ns)
    middle = (0.0, shelf_m[0] - BOARD_M[1] / 2, shelf_m[1] - BOARD_M[2] / 2)
    return _update(ns, _entity(ns, WORLD, "shelf", cubes=[_box(middle, BOARD_M, WOOD)]))


def _transform(stamp: Json, parent: str, child: str, y_m: float, z_m: float, angle_rad: float) -> Json:
    """Return a rotation about x; six decimals are a micrometre."""
    half = angle_rad / 2
    return {
        "timestamp": stamp,
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": {"x": 0.0, "y": round(y_m, 6), "z": round(z_m, 6)},
        "rotation": {"x": round(math.sin(half), 6), "y": 0.0, "z": 0.0, "w": round(math.cos(half), 6)},
    }


def _update(ns: int, *entities: Json) -> Json:
    """Return a complete scene that replaces the earlier one of its topic, so that the newest message is enough."""
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
    """Return a section of the tapered beam, from the frame at its far end back to the previous one."""
    length_m, count = arm.link_length_m[index], arm.links
    near, far = (RADII_M[0] + (RADII_M[1] - RADII_M[0]) * (index + i) / count for i in (0, 1))
    size = _xyz((2 * near, 2 * near, length_m))
    solid = {"pose": _pose((0.0, 0.0, length_m / 2)), "size": size, "color": _rgba(BEAM)}
    return solid | {"bottom_scale": round(far / near, 3), "top_scale": 1.0}


def _box(middle: Sequence[float], size: Sequence[float], colour: Colour) -> Json:
    return {"pose": _pose(middle), "size": _xyz(size), "color": _rgba(colour)}


def _ball(middle: Sequence[float], radius_m: float, colour: Colour) -> Json:
    return _box(middle, (2 * radius_m,) * 3, colour)


def _text(at: Sequence[float], text: str) -> Json:
    label = {"pose": _pose(at), "text": text, "color": _rgba(STEEL)}
    return label | {"billboard": True, "font_size": 0.028, "scale_invariant": False}


def _pose(at: Sequence[float]) -> Json:
    return {"position": _xyz(at), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


def _xyz(numbers: Sequence[float]) -> Json:
    return dict(zip("xyz", numbers, strict=True))


def _rgba(colour: Colour) -> Json:
    return dict(zip("rgba", colour, strict=True))
