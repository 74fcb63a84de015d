"""Inputs and outputs of a control tick: immutable records of numbers and text."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.messages import SAFE, Command, MocapFrame, PressureReading, RailReading
from softarm.schemas.policy import Observation


class Mode(StrEnum):
    """Mode of the daemon: its use of the actuators."""

    DISARMED = "disarmed"  # drive off, muscle vented; the default
    ARMING = "arming"  # waiting until drive and regulator accept the arm command
    ARMED = "armed"  # controlled by the policy of the running goal, or holding
    STOPPING = "stopping"  # braking and venting, the cart held until the arm is still; ends disarmed
    STOPPED = "stopped"  # emergency stop, latched until acknowledged


class EStop(StrEnum):
    """State of the emergency stop."""

    CLEAR = "clear"
    ENGAGED = "engaged"  # a cause is still active
    LATCHED = "latched"  # no cause is active; waiting for an acknowledgement


RequestKind = Literal["arm", "disarm", "stop", "acknowledge", "goal", "cancel_goal", "policy"]


@dataclass(frozen=True, slots=True)
class Request:
    """A request to the control loop, sent through the inbox."""

    number: int
    kind: RequestKind
    goal: Goal | None = None
    policy: str | None = None  # the loaded policy itself is in the inbox
    who: str = ""  # sender: interface, role, address; empty for requests inside this process


@dataclass(frozen=True, slots=True)
class RequestResult:
    """Answer to a request, with the reasons for a refusal and the next step."""

    number: int
    accepted: bool
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Problems:
    """Problem reported by each device, or None."""

    mocap: str | None = None
    regulator: str | None = None
    rail: str | None = None


@dataclass(frozen=True, slots=True)
class Inputs:
    """Inputs of a control tick."""

    t_ns: int  # start of the tick, CLOCK_MONOTONIC
    late_ns: int = 0  # past its deadline
    missed: int = 0  # whole periods skipped since the previous tick
    mocap: tuple[MocapFrame, ...] = ()
    pressure: PressureReading | None = None
    rail: RailReading | None = None
    requests: tuple[Request, ...] = ()
    problems: Problems = Problems()
    recorder_dropped: int = 0  # messages the recorder could not keep since the start
    recorder_problem: str | None = None  # why no log is written, although one is configured
    latched: str | None = None  # first tick only: emergency stop left by the previous daemon
    latch_problem: str | None = None  # why a stop would be lost if the daemon restarted


@dataclass(frozen=True, slots=True)
class ActiveEvent:
    """An active event of the failsafe table."""

    name: str
    response: str
    text: str  # cause with numbers, and the next step


@dataclass(frozen=True, slots=True)
class Observed:
    """Observation of the policy and its age; during a dropout, the estimate by dead reckoning."""

    values: Observation
    mocap_sequence: int  # of the newest good frame
    mocap_age_ns: int  # age of that frame
    pressure_age_ns: int
    rail_age_ns: int
    bridged_ns: int = 0  # time bridged by dead reckoning; 0 if the cameras saw the robot
    tip_deviation_m: float = 0.0  # standard deviation of the estimated tip


@dataclass(frozen=True, slots=True)
class Outputs:
    """Outputs of a control tick: also the snapshot for the API and the record for the log."""

    t_ns: int
    tick: int
    late_ns: int
    missed: int
    missed_total: int
    mode: Mode
    estop: EStop
    sent: Command = SAFE
    action: tuple[float, float] | None = None  # requested by the policy: m/s, kPa
    policy: str = ""
    policy_ns: int = 0  # computing time of the policy
    policy_fault: str | None = None
    clamps: tuple[str, ...] = ()  # why `sent` differs from `action`
    observed: Observed | None = None
    rail_position_m: float | None = None  # the axis's own read-back
    rail_velocity_m_s: float | None = None
    rail_cycle_p50_ms: float | None = None  # exchange with the drive, over the last second
    rail_cycle_max_ms: float | None = None
    goal: GoalStatus = field(default_factory=GoalStatus)
    events: tuple[ActiveEvent, ...] = ()
    arming_refusals: tuple[str, ...] = ()  # reasons for which arming would be refused now
    last_stop: str | None = None  # why the arm last left `armed`
    last_stop_ns: int | None = None  # tick of the last stop; None if it is the previous daemon's
    results: tuple[RequestResult, ...] = ()  # of this tick and a few earlier ones
    reset_devices: bool = False  # an acknowledgement also sends a fault reset to the devices

    def has_stopped(self, number: int, asked_ns: int) -> bool:
        """Return whether the stop request that was in the inbox at `asked_ns` was carried out.

        A later tick with an engaged or latched stop counts as well: the request's own result is lost in a flood of
        requests or in a failed tick.
        """
        held = self.t_ns >= asked_ns and self.estop is not EStop.CLEAR
        return held or any(result.number == number and result.accepted for result in self.results)

    def answer(self, kind: RequestKind, number: int, asked_ns: int) -> RequestResult | None:
        """Return the answer to a request that was in the inbox at `asked_ns`, or None if there is none yet."""
        if kind == "stop" and self.has_stopped(number, asked_ns):
            return RequestResult(number, True)
        return next((result for result in reversed(self.results) if result.number == number), None)


@dataclass(frozen=True, slots=True)
class TickTiming:
    """Duration of the parts of a tick, measured by the control loop."""

    read_ns: int
    compute_ns: int
    write_ns: int
    sensor_to_command_ns: int | None  # age of the newest mocap frame when the command was sent


Tick = tuple[Inputs, Outputs, TickTiming]
