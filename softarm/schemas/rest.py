"""Request and response bodies of the REST API (docs/reference/rest.md), except `daemon.api.status.Status`."""

from typing import Annotated, Literal

from pydantic import AwareDatetime, Field

from softarm.schemas.base import Pair, Strict
from softarm.schemas.config import Workspace
from softarm.schemas.events import Entry
from softarm.schemas.goals import GoalKind, GoalState
from softarm.schemas.log import LogEntry
from softarm.schemas.policy import TrainingRange

API_VERSION = 1  # stated by responses and requests; an older program refuses a newer version
API_HEADER = "softarm-api"


class ReachBody(Strict):
    """Bring the tip to a target."""

    kind: Literal["reach"]
    y_m: Annotated[float, Field(strict=True, description="along the rail; pressure bends the arm towards negative y")]
    z_m: Annotated[float, Field(strict=True, description="height; the tip of the hanging arm is at 0.52")]


class HoldBody(Strict):
    """Brake the cart and let the arm settle."""

    kind: Literal["hold"]


class RunBody(Strict):
    """Run the active policy, for policies that need no target."""

    kind: Literal["run"]


GoalBody = Annotated[ReachBody | HoldBody | RunBody, Field(discriminator="kind")]


class PolicyBody(Strict):
    """Select the active policy."""

    name: str


RoleName = Literal["stop", "view", "command"]  # each role includes the permissions of those before it


class LoginBody(Strict):
    """Log in from a browser."""

    token: str


class LoginAnswer(Strict):
    """Role of the client, and whether a login is needed."""

    needed: bool = Field(description="false: this API needs no token, every client may do everything")
    role: RoleName | None = Field(description="of the client; null: not logged in")


class TicketAnswer(Strict):
    """Ticket that opens one stream."""

    ticket: str
    seconds: float = Field(description="validity of the ticket")


class RobotAnswer(Strict):
    """Constants of a run of the daemon. y is along the rail, z up; ranges are [lowest, highest]."""

    version: str
    run: str = Field(description="id of the daemon's run; it changes when the daemon restarts")
    simulated: bool = Field(description="true: the robot is simulated in the daemon's process; false also for the twin")
    stop_port: int | None = Field(description="dedicated stop port, which never waits for other clients")
    rate_hz: float = Field(description="rate of the control ticks")
    bodies: tuple[str, ...] = Field(description="names of `bodies` in the status, in order")
    hinge_z_m: float = Field(description="height of the arm's upper end, which is fixed to the cart")
    link_length_m: tuple[float, ...] = Field(description="from the hinge down")
    reach_m: float = Field(description="from the hinge: the arm's length and the success radius")
    rail_travel_m: Pair = Field(description="between the mechanical stops")
    rail_limit_m: Pair = Field(description="the soft limits of the cart that the safety filter enforces")
    rail_margin_m: float = Field(description="distance before the soft limits at which the filter aims to stop")
    cart_velocity_max_m_s: float
    pressure_limit_kpa: Pair
    workspace: Workspace = Field(description="allowed region of reach goals")
    success_radius_m: float
    time_limit_s: float = Field(description="of a reach goal")
    shelf_board_below_m: float = Field(
        description="distance of the shelf's lower board below the target, for a policy whose `shelf_depth_m` is a "
        "number; the shelf's front edge is `shelf_depth_m` on the +y side of the target"
    )


class RecentAnswer(Strict):
    """The newest ticks as columns of one length, oldest first; null: not finite, or unknown."""

    tick: tuple[int, ...] = Field(description="-1: the tick failed")
    time: tuple[float, ...] = Field(description="Unix time, s")
    tip_y_m: tuple[float | None, ...]
    tip_z_m: tuple[float | None, ...]
    cart_m: tuple[float | None, ...] = Field(description="measured by the axis: `rail_position_m` of the status")
    cart_velocity_m_s: tuple[float | None, ...] = Field(description="`rail_velocity_m_s` of the status")
    action_velocity_m_s: tuple[float | None, ...] = Field(description="requested by the policy")
    sent_velocity_m_s: tuple[float | None, ...]
    pressure_kpa: tuple[float | None, ...]
    action_pressure_kpa: tuple[float | None, ...]
    sent_pressure_kpa: tuple[float | None, ...]
    late_ms: tuple[float | None, ...]
    policy_ms: tuple[float | None, ...]
    mocap_age_ms: tuple[float | None, ...]
    pressure_age_ms: tuple[float | None, ...]
    rail_age_ms: tuple[float | None, ...]
    bodies: tuple[tuple[Pair | None, ...], ...] = Field(
        description="y, z of each rigid body in the newest frame, m, in the order of `bodies` of the robot; "
        "null: not tracked"
    )
    mode: tuple[str, ...]


class Refusal(Strict):
    """Reasons of a refused request, and what is allowed."""

    detail: str
    reasons: tuple[str, ...]


class Health(Strict):
    """Readiness of the robot, with reasons if it is not ready."""

    healthy: bool
    reasons: tuple[str, ...]


class GoalAnswer(Strict):
    """The newest goal and its progress."""

    kind: GoalKind | None
    state: GoalState
    reason: str | None = Field(description="reason of a failure or cancellation")
    y_m: float | None
    z_m: float | None
    closest_m: float | None = Field(description="the tip's closest distance to the target so far")
    time_s: float
    number: int = Field(description="goals accepted since the daemon started")


class PolicyAnswer(Strict):
    """A policy, or the reason why it cannot be selected."""

    name: str
    plugin: str
    description: str
    error: str | None
    needs_target: bool | None = None
    episode_steps: int | None = None
    trained: TrainingRange | None = Field(default=None, description="training ranges; targets outside cause a warning")
    sha256: str | None = Field(default=None, description="of the model file")
    shelf_depth_m: float | None = Field(
        default=None, description="distance of targets behind a shelf's front edge; null: the policy needs no shelf"
    )


class PoliciesAnswer(Strict):
    """All policies, the active one first, those that cannot be used last."""

    active: str | None
    policies: tuple[PolicyAnswer, ...]


class LogsAnswer(Strict):
    """The logs on this machine, newest first."""

    directory: str
    logs: tuple[LogEntry, ...]


class LogDeleted(Strict):
    """Name of a deleted log."""

    name: str


class ExciteBody(Strict):
    """Play an excitation on the armed robot, as a goal, and record it in a log of its own."""

    kind: Literal["excite"]
    excitation: str = Field(description="a name of `excitations` in GET /api/jobs")


class DiagnoseBody(Strict):
    """Diagnose logs, as `softarm diagnose --report` does."""

    kind: Literal["diagnose"]
    logs: Annotated[tuple[str, ...], Field(min_length=1, max_length=20)]


class ReplayBody(Strict):
    """Replay a log and compare all commands bit for bit, as `softarm logs replay` does."""

    kind: Literal["replay"]
    log: str


JobBody = Annotated[ExciteBody | DiagnoseBody | ReplayBody, Field(discriminator="kind")]
JobKind = Literal["excite", "diagnose", "replay"]


class JobEntry(Strict):
    """Job as the dashboard shows it."""

    number: int
    kind: JobKind
    text: str = Field(description="what it does, for people")
    state: Literal["running", "done", "failed", "cancelled"] = "running"
    progress: str = Field(default="", description="the current work of a running job")
    share: float | None = Field(default=None, description="completed share, 0 to 1; null: unknown")
    sentences: tuple[str, ...] = Field(default=(), description="result, or why the job failed")
    started: AwareDatetime
    ended: AwareDatetime | None = None
    report: str | None = Field(default=None, description="name in GET /api/reports")
    log: str | None = Field(default=None, description="name of the recorded log")


class ExcitationEntry(Strict):
    """An excitation that a job can play."""

    name: str
    duration_s: float
    description: str


class JobsAnswer(Strict):
    """The newest jobs since the start of the daemon, newest first; at most one is running."""

    jobs: tuple[JobEntry, ...]
    excitations: tuple[ExcitationEntry, ...]


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
    """Events of the daemon, oldest first."""

    run: str = Field(description="id of the daemon's run; each run counts its events from 1")
    events: tuple[Entry, ...]
    oldest: int | None = Field(description="number of the oldest stored event")
    newest: int | None


class IncidentEntry(Strict):
    """The file of an emergency stop."""

    name: str
    bytes: int
    time: AwareDatetime
    text: str = Field(description="cause of the stop")


class IncidentsAnswer(Strict):
    """The incident files on this machine, newest first."""

    directory: str
    incidents: tuple[IncidentEntry, ...]
