"""Wire format of a motion capture frame: JSON, so that a bridge needs ten lines.

    {"sequence": 7, "t_capture_ns": 81234567890, "bodies": {"cart": [0.1, 0.97, 0.0], ..., "link5": null}}

A body is [y (m), z (m), absolute angle (rad)], or null without tracking; a missing body counts as null.
Both ends use this module: the driver (`softarm.drivers.mocap.driver`) and the publishers.
"""

import json
import math
from collections.abc import Sequence

from softarm.schemas.messages import BODY_NAMES, MocapFrame, Pose

# Schema of the Zenoh encoding application/json; a bridge may omit it.
SCHEMA = "softarm.mocap.v1"
# Six bodies at full precision take 500.
MAX_BYTES = 4096
LOST = Pose(math.nan, math.nan, math.nan, tracked=False)


def encode(sequence: int, t_capture_ns: int, bodies: Sequence[Pose]) -> bytes:
    """Return the payload of a frame with poses in the order of `BODY_NAMES`.

    Raises:
        ValueError: A tracked pose holds NaN or infinity.
    """
    poses = {name: list(pose[:3]) if pose.tracked else None for name, pose in zip(BODY_NAMES, bodies, strict=True)}
    message = {"sequence": sequence, "t_capture_ns": t_capture_ns, "bodies": poses}
    return json.dumps(message, separators=(",", ":"), allow_nan=False).encode()


def check_schema(encoding: str) -> None:
    """Check the schema in a Zenoh encoding. Raises ValueError, with both versions, if it is another version."""
    schema = encoding.partition(";")[2]
    if schema.startswith("softarm.mocap.") and schema != SCHEMA:
        raise ValueError(f"the sample is {schema[:40]}, this software supports {SCHEMA}: update the older side")


def decode(payload: bytes, t_receive_ns: int) -> MocapFrame:
    """Return the frame in a payload. Raises ValueError with the invalid field and its allowed values."""
    try:
        message = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not JSON: {error}") from None
    return frame_of(message, t_receive_ns)


def frame_of(message: object, t_receive_ns: int) -> MocapFrame:
    """Return the frame in parsed JSON. Raises ValueError with the invalid field and its allowed values."""
    if not isinstance(message, dict) or set(message) != {"sequence", "t_capture_ns", "bodies"}:
        raise ValueError("a frame must have exactly the fields sequence, t_capture_ns and bodies")
    bodies = message["bodies"]
    if not isinstance(bodies, dict) or not set(bodies) <= set(BODY_NAMES):
        raise ValueError(f"the names of bodies must be among {', '.join(BODY_NAMES)}")
    return MocapFrame(
        sequence=_count(message, "sequence"),
        t_capture_ns=_count(message, "t_capture_ns"),
        t_receive_ns=t_receive_ns,
        bodies=tuple(_pose(name, bodies.get(name)) for name in BODY_NAMES),
    )


def _count(message: dict[str, object], field: str) -> int:
    value = message[field]
    if type(value) is not int or not 0 <= value < 2**63:
        raise ValueError(f"{field} must be an integer from 0 to 2^63 - 1")
    return value


def _pose(name: str, value: object) -> Pose:
    if value is None:
        return LOST
    if not isinstance(value, list) or len(value) != 3 or any(type(v) not in (int, float) for v in value):
        raise ValueError(f"{name} must be [y, z, angle] or null")
    try:
        y_m, z_m, angle_rad = map(float, value)
    except OverflowError:
        raise ValueError(f"{name} holds a number beyond a float's range") from None
    if not all(map(math.isfinite, (y_m, z_m, angle_rad))):
        raise ValueError(f"{name} holds NaN or infinity")
    return Pose(y_m, z_m, angle_rad)
