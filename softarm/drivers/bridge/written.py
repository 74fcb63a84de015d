"""Text of bridge.yaml after a calibration, with the quality of the result in comments."""

import json
import math
from collections.abc import Iterator, Mapping
from datetime import date

from softarm.drivers.bridge.calibration import HINGE_Z_M, Found
from softarm.schemas.bridge import Bridge
from softarm.schemas.messages import BODY_NAMES

DIGITS = {"yaw_rad": 5, "tilt_rad": 5, "origin_m": 4, "hanging": 6, "across_m": 4, "along_m": 4}


def configuration(config: Bridge, server: str, found: Found) -> Bridge:
    """Return the configuration with the calibration's result, rounded as in the file."""
    whole = config.model_copy(update={"server": server, "room": found.room, "bodies": found.marks})
    return Bridge.model_validate(_rounded(whole.model_dump()))


def text(config: Bridge, found: Found, when: date) -> str:
    """Return the text of the file."""
    return "\n".join(_lines(config, found, when)) + "\n"


def _rounded(value: object, digits: int | None = None) -> object:
    """Round the numbers under the keys of `DIGITS`, at any depth."""
    if isinstance(value, dict):
        return {key: _rounded(each, DIGITS.get(key)) for key, each in value.items()}
    if isinstance(value, tuple):
        return tuple(_rounded(each, digits) for each in value)
    # The sum turns minus zero into zero.
    return value if digits is None or not isinstance(value, float) else round(value, digits) + 0.0


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
