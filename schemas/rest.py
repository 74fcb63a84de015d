"""Bodies of the REST API, in and out; the status itself is `softarm.daemon.api.status.Status`. See docs/rest.md."""

from typing import Annotated, Literal

from pydantic import AwareDatetime, Field

from softarm.schemas.base import Strict
from softarm.schemas.config import Workspace
from softarm.schemas.events import Entry
from softarm.schemas.goals import GoalKind, GoalState
from softarm.schemas.log import LogEntry
from softarm.schemas.policy import TrainingRange

API_VERSION = 1  # a daemon's answers and a client's requests may say theirs; a newer one is not read by an older
API_HEADER = "softarm-api"


class ReachBody(Strict):
    """Bring the tip to a target."""

    kind: Literal["reach"]
    y_m: Annotated[float, Field(strict=True, description="along the rail; negative is where pressure bends to")]
    z_m: Annotated[float, Field(strict=True, description="up; the arm hangs to 0.52")]


class HoldBody(Strict):
    """Brake the cart and let the arm settle."""

    kind: Literal["hold"]


class RunBody(Strict):
    """Let the policy in use play what it plays; for policies that need no target."""

    kind: Literal["run"]


GoalBody = Annotated[ReachBody | HoldBody | RunBody, Field(discriminator="kind")]


class PolicyBody(Strict):
    """Which policy to use from now on."""

    name: str


RoleName = Literal["stop", "view", "command"]  # each may do what those before it may


class LoginBody(Strict):
    """Who logs in from a browser."""

    token: str


class LoginAnswer(Strict):
    """Who asks, and whether that matters."""

    needed: bool = Field(description="false: this API asks for no token, everybody who reaches it may do everything")
    role: RoleName | None = Field(description="of who asks; null: not logged in")


class TicketAnswer(Strict):
    """Opens one stream."""

    ticket: str
    seconds: float = Field(description="that it is good for")


class RobotAnswer(Strict):
    """What does not change while the daemon runs. y is along the rail, z up; ends are [least, most]."""

    version: str
    run: str = Field(description="of the daemon; another one: it was started anew")
    simulated: bool = Field(description="a robot in the daemon's own process; the twin looks like a real one")
    stop_port: int | None = Field(description="of this host, where POST /api/stop waits for nobody")
    rate_hz: float = Field(description="of the control ticks")
    bodies: tuple[str, ...] = Field(description="names of the status' `bodies`, in their order")
    hinge_z_m: float = Field(description="height of the arm's upper end, which rides on the cart")
    link_length_m: tuple[float, ...] = Field(description="from the hinge down")
    reach_m: float = Field(description="from the hinge: the arm's length and the success radius")
    rail_travel_m: tuple[float, float] = Field(description="between the mechanical stops")
    rail_limit_m: tuple[float, float] = Field(description="the soft limits, which the safety filter holds the cart to")
    rail_margin_m: float = Field(description="so far before the soft limits the filter aims to stop")
    cart_velocity_max_m_s: float
    pressure_limit_kpa: tuple[float, float]
    workspace: Workspace = Field(description="where a reach goal may lie")
    success_radius_m: float
    time_limit_s: float = Field(description="of a reach goal")
    shelf_board_below_m: float = Field(
        description="where a policy's `shelf_depth_m` is a number, the shelf's front edge is so far on the +y side of "
        "the target, and its lower board so far below it as is said here"
    )


class RecentAnswer(Strict):
    """The newest ticks as columns of one length, oldest first; null: not finite, or not known then."""

    tick: tuple[int, ...] = Field(description="-1: the tick failed")
    time: tuple[float, ...] = Field(description="seconds of Unix' time")
    tip_y_m: tuple[float | None, ...]
    tip_z_m: tuple[float | None, ...]
    cart_m: tuple[float | None, ...] = Field(description="by the axis itself, the status' `rail_position_m`")
    cart_velocity_m_s: tuple[float | None, ...] = Field(description="the status' `rail_velocity_m_s`")
    action_velocity_m_s: tuple[float | None, ...] = Field(description="what the policy wanted")
    sent_velocity_m_s: tuple[float | None, ...]
    pressure_kpa: tuple[float | None, ...]
    action_pressure_kpa: tuple[float | None, ...]
    sent_pressure_kpa: tuple[float | None, ...]
    late_ms: tuple[float | None, ...]
    policy_ms: tuple[float | None, ...]
    mocap_age_ms: tuple[float | None, ...]
    pressure_age_ms: tuple[float | None, ...]
    rail_age_ms: tuple[float | None, ...]
    mode: tuple[str, ...]


class Refusal(Strict):
    """Why something was not done, and what is allowed."""

    detail: str
    reasons: tuple[str, ...]


class Health(Strict):
    """Whether the robot could be used now."""

    healthy: bool
    reasons: tuple[str, ...]


class GoalAnswer(Strict):
    """The newest goal and how it went."""

    kind: GoalKind | None
    state: GoalState
    reason: str | None = Field(description="why it failed or was cancelled")
    y_m: float | None
    z_m: float | None
    closest_m: float | None = Field(description="the tip's closest distance to the target so far")
    time_s: float
    number: int = Field(description="goals taken up since the daemon started")


class PolicyAnswer(Strict):
    """A policy that can be chosen, or why it cannot."""

    name: str
    plugin: str
    description: str
    error: str | None
    needs_target: bool | None = None
    episode_steps: int | None = None
    trained: TrainingRange | None = Field(default=None, description="targets outside are tried, with a warning")
    sha256: str | None = Field(default=None, description="of the model file")
    shelf_depth_m: float | None = Field(
        default=None, description="that targets lie behind a shelf's front edge; null: it flies without a shelf"
    )


class PoliciesAnswer(Strict):
    """All policies by name, and the one in use."""

    active: str | None
    policies: tuple[PolicyAnswer, ...]


class LogsAnswer(Strict):
    """The logs on this machine, newest first."""

    directory: str
    logs: tuple[LogEntry, ...]


class LogDeleted(Strict):
    """A log that is gone."""

    name: str


class ReplayAnswer(Strict):
    """How a log's replay went."""

    name: str
    same: bool = Field(description="every tick that was compared gave the same commands, bit for bit")
    ticks: int = Field(description="that the log holds")
    compared: int = Field(description="the others follow too closely on ticks that the log lacks")
    differences: int
    sentences: tuple[str, ...] = Field(description="as `softarm replay` prints them, the last one says what came of it")


class ReportEntry(Strict):
    """A page in the directory of reports."""

    name: str
    bytes: int
    modified: AwareDatetime


class ReportsAnswer(Strict):
    """The reports on this machine, newest first."""

    directory: str
    reports: tuple[ReportEntry, ...]


class EventsAnswer(Strict):
    """What happened, oldest first."""

    run: str = Field(description="of the daemon; another one counts its events from 1 again")
    events: tuple[Entry, ...]
    oldest: int | None = Field(description="number of the oldest event that is still kept")
    newest: int | None


class IncidentEntry(Strict):
    """The file of an emergency stop."""

    name: str
    bytes: int
    time: AwareDatetime
    text: str = Field(description="what stopped the robot")


class IncidentsAnswer(Strict):
    """The incident files on this machine, newest first."""

    directory: str
    incidents: tuple[IncidentEntry, ...]
