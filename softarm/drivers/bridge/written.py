"""Text of bridge.yaml after a calibration, with the quality of the result in comments."""

import json
import math
from collections.abc import Iterator, Mapping
from datetime import date

from softarm.drivers.bridge.calibration import HINGE_Z_M, Found
from softarm.schemas.bridge import Bridge, Marked
from softarm.schemas.messages import BODY_NAMES


def configuration(config: Bridge, server: str, found: Found) -> Bridge:
    """Return the configuration with the calibration's result, rounded as in the file."""
    room = found.room.model_copy(
        update={
            "yaw_rad": _round(found.room.yaw_rad, 5),
            "tilt_rad": _round(found.room.tilt_rad, 5),
            "origin_m": tuple(_round(part, 4) for part in found.room.origin_m),
        }
    )
    marks = {name: _rounded(getattr(found.marks, name)) for name in BODY_NAMES}
    return config.model_copy(update={"server": server, "room": room, "bodies": found.marks.model_copy(update=marks)})


def text(config: Bridge, found: Found, when: date) -> str:
    """Return the text of the file."""
    return "\n".join(_lines(config, found, when)) + "\n"


def _rounded(mark: Marked | None) -> Marked | None:
    if mark is None:
        return None
    hanging = tuple(_round(part, 6) for part in mark.hanging)
    return mark.model_copy(
        update={"hanging": hanging, "across_m": _round(mark.across_m, 4), "along_m": _round(mark.along_m, 4)}
    )


def _round(value: float, digits: int) -> float:
    # The sum turns minus zero into zero.
    return round(value, digits) + 0.0


def _lines(config: Bridge, found: Found, when: date) -> Iterator[str]:
    yield f"# Written by `softarm bridge calibrate` on {when}. Keys: docs/hardware/bridge.md."
    yield f"# The cart moved {found.travel_m:.3f} m, at most {1e3 * found.crooked_m:.1f} mm away from a straight line."
    yield f"# At rest the bodies stayed within {1e3 * found.noise_m:.2f} mm."
    for note in found.notes:
        yield f"# Note: {note}."
    whole = json.loads(config.model_dump_json())
    plain = json.loads(Bridge().model_dump_json())
    for key in ("server", "command_port", "local", "received_after_s"):
        if whole[key] != plain[key]:
            yield f"{key}: {json.dumps(whole[key])}"
    room = config.room
    yield "room:"
    yield f"  up: {json.dumps(room.up)}"
    yield f"  yaw_rad: {json.dumps(room.yaw_rad)} # {math.degrees(room.yaw_rad):.2f} degrees"
    yield f"  tilt_rad: {json.dumps(room.tilt_rad)} # {math.degrees(room.tilt_rad):+.2f} degrees"
    place = f"puts the first hinge at {HINGE_Z_M} m; the cameras' ground plane is {found.floor_m:+.3f} m from the floor"
    yield f"  origin_m: {json.dumps(room.origin_m)} # {place}"
    yield "bodies:"
    for name in BODY_NAMES:
        yield _body(name, whole["bodies"][name], found)
    if whole["daemon"] != plain["daemon"]:
        yield f"daemon: {json.dumps(whole['daemon'])}"


def _body(name: str, mark: Mapping[str, object] | None, found: Found) -> str:
    if mark is None:
        return f"  {name}: null"
    kept = {key: value for key, value in mark.items() if value is not None}
    parts = ", ".join(f"{key}: {json.dumps(value)}" for key, value in kept.items())
    beside = f" # {1e3 * found.beside_m[name]:+.1f} mm away from its nominal place" if name in found.beside_m else ""
    return f"  {name}: {{{parts}}}{beside}"
