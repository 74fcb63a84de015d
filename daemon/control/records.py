"""What goes into one tick and what comes out: immutable, numbers and text only."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.messages import SAFE, Command, MocapFrame, PressureReading, RailReading
from softarm.schemas.policy import Observation


class Mode(StrEnum):
    """What the daemon is doing with the actuators."""

    DISARMED = "disarmed"  # drive off, muscle vented; the default
    ARMING = "arming"  # waiting for drive and regulator to take the arm command
    ARMED = "armed"  # the policy of the running goal, or a hold, has the arm
    STOPPING = "stopping"  # braking and venting, the cart held until the arm is still; ends disarmed
    STOPPED = "stopped"  # emergency stop, latched until acknowledged


class EStop(StrEnum):
    """The emergency stop's three states."""

    CLEAR = "clear"
    ENGAGED = "engaged"  # its cause is still there
    LATCHED = "latched"  # the cause is gone; waits for an acknowledgement


RequestKind = Literal["arm", "disarm", "stop", "acknowledge", "goal", "cancel_goal", "policy"]


@dataclass(frozen=True, slots=True)
class Request:
    """Something a person asked for, through the inbox."""

    number: int
    kind: RequestKind
    goal: Goal | None = None
    policy: str | None = None  # its runner travels beside it, in the inbox
    who: str = ""  # asked: by which way, in which role, from where; logs up to November 2026 do not say


@dataclass(frozen=True, slots=True)
class RequestResult:
    """The answer to a request; `reasons` say why it was refused and what to do."""

    number: int
    accepted: bool
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Problems:
    """Each device's own sentence on what is wrong with it; None when all is well."""

    mocap: str | None = None
    regulator: str | None = None
    rail: str | None = None


@dataclass(frozen=True, slots=True)
class Inputs:
    """All that a tick may know."""

    t_ns: int  # start of the tick, CLOCK_MONOTONIC
    late_ns: int = 0  # past its deadline
    missed: int = 0  # whole periods skipped since the previous tick
    mocap: tuple[MocapFrame, ...] = ()
    pressure: PressureReading | None = None
    rail: RailReading | None = None
    requests: tuple[Request, ...] = ()
    problems: Problems = Problems()
    recorder_dropped: int = 0  # messages the recorder could not take, since start
    recorder_problem: str | None = None  # why no log is being written; None: one is, or none is asked for
    latched: str | None = None  # in a daemon's first tick: what had stopped the robot when the one before it ended
    latch_problem: str | None = None  # why a stop would not outlive this daemon


@dataclass(frozen=True, slots=True)
class ActiveEvent:
    """An event of the failsafe table that holds now."""

    name: str
    response: str
    text: str  # what is wrong, with numbers, and the next step


@dataclass(frozen=True, slots=True)
class Observed:
    """What the policy was fed, and how old it was: as it was seen or, in the dark, as it was carried on from there."""

    values: Observation
    mocap_sequence: int  # of the newest good frame
    mocap_age_ns: int  # of that frame
    pressure_age_ns: int
    rail_age_ns: int
    dark_ns: int = 0  # that the values were carried on for; 0: they were seen
    tip_deviation_m: float = 0.0  # standard deviation of the tip then


@dataclass(frozen=True, slots=True)
class Outputs:
    """All that a tick decided; also the snapshot that the API shows and the record that the log keeps."""

    t_ns: int
    tick: int
    late_ns: int
    missed: int
    missed_total: int
    mode: Mode
    estop: EStop
    sent: Command = SAFE
    action: tuple[float, float] | None = None  # what the policy wanted: m/s, kPa
    policy: str = ""
    policy_ns: int = 0  # time the policy took
    policy_fault: str | None = None
    clamps: tuple[str, ...] = ()  # why `sent` differs from `action`
    observed: Observed | None = None
    rail_position_m: float | None = None  # the axis's own read-back
    rail_velocity_m_s: float | None = None
    rail_cycle_p50_ms: float | None = None  # what the questions and answers of a tick take, over the last second
    rail_cycle_max_ms: float | None = None
    goal: GoalStatus = field(default_factory=GoalStatus)
    events: tuple[ActiveEvent, ...] = ()
    arming_refusals: tuple[str, ...] = ()  # why arming would be refused now; empty: it would not
    last_stop: str | None = None  # why the arm last left `armed`
    last_stop_ns: int | None = None  # the tick in which it did; None also where the daemon before this one was stopped
    results: tuple[RequestResult, ...] = ()  # of this tick and a few before
    reset_devices: bool = False  # an acknowledgement also sends a fault reset to the devices

    def has_stopped(self, number: int, asked_ns: int) -> bool:
        """Was the stop of this number carried out, which lay in the inbox at `asked_ns`?

        A later tick that holds a stop says so as well as its result does: that one, a flood of requests or a tick that
        failed leaves behind.
        """
        held = self.t_ns >= asked_ns and self.estop is not EStop.CLEAR
        return held or any(result.number == number and result.accepted for result in self.results)


@dataclass(frozen=True, slots=True)
class TickTiming:
    """How long a tick's parts took; written beside it by the loop."""

    read_ns: int
    compute_ns: int
    write_ns: int
    sensor_to_command_ns: int | None  # age of the newest mocap frame's capture when the command was handed over
