"""bridge.yaml: where a camera system is, how its room lies to the robot's plane, which of its bodies are the arm's."""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from softarm.schemas.base import Strict

Port = Annotated[int, Field(ge=1, le=65535)]
Metres = Annotated[float, Field(ge=-100, le=100)]
Part = Annotated[float, Field(ge=-1.001, le=1.001)]

TILT_MAX_RAD = 0.05


class Room(Strict):
    """The robot's plane in the cameras' frame. As it stands: the rail lies along the room's x, its middle above 0."""

    up: Literal["y", "z"] = "y"  # the axis that is streamed as up
    # From the room's x to the rail's +y, about up; turned by pi the other end of the rail is +y.
    yaw_rad: Annotated[float, Field(ge=-math.pi, le=math.pi)] = 0.0
    # By how much the rail rises towards +y above the cameras' ground plane.
    tilt_rad: Annotated[float, Field(ge=-TILT_MAX_RAD, le=TILT_MAX_RAD)] = 0.0
    origin_m: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)  # the floor below the rail's middle


class Marked(Strict):
    """One body of the arm: which rigid body it is, and how its markers sit."""

    rigid_body: str | int | None = None  # its name in Motive, or its streaming id; null: the body's own name
    # How it is streamed while the arm hangs straight down: x, y, z, w.
    hanging: tuple[Part, Part, Part, Part] = (0.0, 0.0, 0.0, 1.0)
    # From the streamed point to the one that is meant, while the arm hangs: towards +y, and up.
    across_m: Annotated[float, Field(ge=-0.3, le=0.3)] = 0.0
    along_m: Annotated[float, Field(ge=-0.3, le=0.3)] = 0.0

    @model_validator(mode="after")
    def _turned(self) -> Self:
        if not 0.99 < math.sqrt(sum(part**2 for part in self.hanging)) < 1.01:
            raise ValueError("hanging must be a unit quaternion x, y, z, w: [0, 0, 0, 1], or what calibrate finds")
        return self


class Marks(Strict):
    """The arm's bodies; null leaves one out. Cart and tip have to be there."""

    cart: Marked = Marked()
    link1: Marked | None = Marked()
    link2: Marked | None = Marked()
    link3: Marked | None = Marked()
    link4: Marked | None = Marked()
    link5: Marked = Marked()

    @model_validator(mode="after")
    def _each_its_own(self) -> Self:
        taken: dict[str | int, str] = {}
        for name, mark in self:
            if mark is None:
                continue
            body = name if mark.rigid_body is None else mark.rigid_body
            if body in taken:
                raise ValueError(f"bodies.{name}.rigid_body is {body!r}, which is {taken[body]} already: name another")
            taken[body] = name
        return self


class Listener(Strict):
    """The daemon, as its `drivers.mocap` has it."""

    endpoint: str = "tcp/127.0.0.1:7447"
    key: str = "softarm/mocap"


class Bridge(Strict):
    """bridge.yaml."""

    server: str | None = None  # the computer that runs Motive; --server goes before it
    command_port: Port = 1510
    local: str = "0.0.0.0"  # this computer's address on the cameras' network, where it has several
    # From the middle of the exposure to the server's own stamp, for cameras that do not say the former.
    received_after_s: Annotated[float, Field(ge=0, le=0.1)] = 0.005
    room: Room = Room()
    bodies: Marks = Marks()
    daemon: Listener = Listener()
