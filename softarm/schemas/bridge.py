"""Data model of bridge.yaml: the camera system, its frame relative to the robot, and the rigid bodies of the arm."""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from softarm.schemas.base import Endpoint, Strict

Port = Annotated[int, Field(ge=1, le=65535)]
Metres = Annotated[float, Field(ge=-100, le=100)]
Part = Annotated[float, Field(ge=-1.001, le=1.001)]

TILT_MAX_RAD = 0.05


class Room(Strict):
    """Pose of the robot's plane in the cameras' frame. Default: the rail lies along x, its middle above the origin."""

    up: Literal["y", "z"] = "y"  # the streamed axis that points up
    # Angle about the vertical axis from the cameras' x to the rail's +y.
    yaw_rad: Annotated[float, Field(ge=-math.pi, le=math.pi)] = 0.0
    # Slope of the rail towards +y, against the cameras' ground plane.
    tilt_rad: Annotated[float, Field(ge=-TILT_MAX_RAD, le=TILT_MAX_RAD)] = 0.0
    origin_m: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)  # the point on the floor below the rail's middle


class Marked(Strict):
    """One body of the arm: its rigid body in the stream, and the pose of its markers."""

    rigid_body: str | int | None = None  # name in Motive, or streaming id; null: this body's name
    # Streamed orientation while the arm hangs straight down: x, y, z, w.
    hanging: tuple[Part, Part, Part, Part] = (0.0, 0.0, 0.0, 1.0)
    # Offset from the streamed point to the body's point while the arm hangs: towards +y, and upwards.
    across_m: Annotated[float, Field(ge=-0.3, le=0.3)] = 0.0
    along_m: Annotated[float, Field(ge=-0.3, le=0.3)] = 0.0

    @model_validator(mode="after")
    def _check_quaternion(self) -> Self:
        if not 0.99 < math.sqrt(sum(part**2 for part in self.hanging)) < 1.01:
            raise ValueError("hanging must be a unit quaternion x, y, z, w: [0, 0, 0, 1], or what calibrate finds")
        return self


class Marks(Strict):
    """Bodies of the arm. Null leaves a body out; cart and link5 (the tip) are required."""

    cart: Marked = Marked()
    link1: Marked | None = Marked()
    link2: Marked | None = Marked()
    link3: Marked | None = Marked()
    link4: Marked | None = Marked()
    link5: Marked = Marked()

    @property
    def used(self) -> dict[str, Marked]:
        """Return the bodies that are not left out, in the order of `BODY_NAMES`."""
        return {name: mark for name, mark in self if mark is not None}

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        taken: dict[str | int, str] = {}
        for name, mark in self.used.items():
            body = name if mark.rigid_body is None else mark.rigid_body
            if body in taken:
                raise ValueError(f"bodies.{name}.rigid_body is {body!r}, which is {taken[body]} already: name another")
            taken[body] = name
        return self


class Listener(Strict):
    """Address of the daemon, as in its `drivers.mocap`."""

    endpoint: Endpoint = "tcp/127.0.0.1:7447"
    key: str = "softarm/mocap"


class Bridge(Strict):
    """Data model of bridge.yaml."""

    server: str | None = None  # the computer that runs Motive; --server overrides it
    command_port: Port = 1510
    local: str = "0.0.0.0"  # this computer's address on the cameras' network, if it has several
    # Time from the middle of the exposure to the server's stamp, for cameras that do not report the exposure.
    received_after_s: Annotated[float, Field(ge=0, le=0.1)] = 0.005
    room: Room = Room()
    bodies: Marks = Marks()
    daemon: Listener = Listener()
