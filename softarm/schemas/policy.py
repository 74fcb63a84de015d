"""Metadata of a learned policy; an ONNX file carries it as JSON under the metadata key `softarm`."""

from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from softarm.schemas.base import Strict, json_array
from softarm.schemas.robot import CART_VELOCITY_MAX_M_S, PRESSURE_MAX_KPA, PRESSURE_MIN_KPA

METADATA_KEY = "softarm"
METADATA_FORMAT = 1
TaskKind = Literal["reach", "shelf"]


class Signal(Strict):
    """One element of an observation, goal or action vector."""

    name: str
    unit: str
    low: float | None = None  # of actions: the values of -1 and +1
    high: float | None = None


@json_array
class Observation(NamedTuple):
    """Observation of a policy; as an array, float32 [8] in this order.

    Velocities are first differences over a control step ([P] section 3.3).
    """

    cart_position_m: float
    cart_velocity_m_s: float
    tip_y_m: float
    tip_z_m: float
    tip_vy_m_s: float
    tip_vz_m_s: float
    previous_cart_velocity_command_m_s: float  # the sent command
    pressure_kpa: float


def places(*names: str) -> list[int]:
    """Return the indices of these fields in an array of an `Observation`."""
    return [Observation._fields.index(name) for name in names]


# The fields of an observation, for files and logs.
OBSERVATION = (
    Signal(name="cart_position", unit="m"),
    Signal(name="cart_velocity", unit="m/s"),
    Signal(name="tip_y", unit="m"),
    Signal(name="tip_z", unit="m"),
    Signal(name="tip_vy", unit="m/s"),
    Signal(name="tip_vz", unit="m/s"),
    Signal(name="previous_cart_velocity_command", unit="m/s"),
    Signal(name="pressure", unit="kPa"),
)
REACH_GOAL = (Signal(name="target_y", unit="m"), Signal(name="target_z", unit="m"))
SHELF_GOAL = (*REACH_GOAL, Signal(name="target_depth", unit="m"))  # behind the shelf's front edge
GOALS = {"reach": REACH_GOAL, "shelf": SHELF_GOAL}  # by the policy's task
ACTION = (
    Signal(name="cart_velocity", unit="m/s", low=-CART_VELOCITY_MAX_M_S, high=CART_VELOCITY_MAX_M_S),
    Signal(name="pressure", unit="kPa", low=PRESSURE_MIN_KPA, high=PRESSURE_MAX_KPA),
)


class TrainingRange(Strict):
    """Ranges of the policy's training; the daemon warns outside them."""

    target_y_m: tuple[float, float]
    target_z_m: tuple[float, float]
    cart_start_m: tuple[float, float]


class Golden(Strict):
    """A short recorded run that the file must reproduce before it may be armed.

    `inputs` is [steps, observation + goal], `outputs` [steps, action] in -1..1 before scaling; the recurrent
    state starts at zero and is carried from step to step.
    """

    inputs: tuple[tuple[float, ...], ...]
    outputs: tuple[tuple[float, ...], ...]
    tolerance: float = 1e-4


class PolicyMetadata(Strict):
    """The self-description of a learned policy."""

    format: Literal[1] = 1
    name: str
    task: TaskKind
    rate_hz: Annotated[float, Field(gt=0)]
    observation: tuple[Signal, ...]
    goal: tuple[Signal, ...]
    action: tuple[Signal, ...]
    state_size: int  # h and c are [1, batch, state_size]
    rail_limit_m: float  # largest |cart position| of training
    episode_steps: int
    trained: TrainingRange
    training: dict[str, str | float | int | bool | list[float] | None]  # the training configuration
    seed: int
    git_revision: str
    validation_success: float
    golden: Golden
