"""Data model of softarm.yaml: units are part of the names, unknown keys are refused."""

import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from softarm.common.braking import BrakingLaw
from softarm.schemas.base import Endpoint, Strict, tcp_address
from softarm.schemas.robot import (
    CART_VELOCITY_MAX_M_S,
    CONTROL_PERIOD_S,
    CONTROL_RATE_HZ,
    PRESSURE_MAX_KPA,
    PRESSURE_MIN_KPA,
    RAIL_LIMIT_M,
    RAIL_TRAVEL_M,
)


class RailLimits(Strict):
    """Limits of the cart that the safety filter enforces."""

    position_min_m: Annotated[float, Field(ge=-RAIL_TRAVEL_M, le=RAIL_TRAVEL_M)] = -RAIL_LIMIT_M
    position_max_m: Annotated[float, Field(ge=-RAIL_TRAVEL_M, le=RAIL_TRAVEL_M)] = RAIL_LIMIT_M
    velocity_max_m_s: Annotated[float, Field(gt=0, le=CART_VELOCITY_MAX_M_S)] = CART_VELOCITY_MAX_M_S
    # Upper limit of the drive's own ramp. Set-points for a drive without a ramp change at this rate.
    acceleration_max_m_s2: Annotated[float, Field(gt=0, le=20.0)] = 6.0
    # Worst acceleration and guaranteed braking of the cart. The swinging arm pulls the cart either way: an arm that
    # is swung up on purpose leaves little of the drive's ramp for 0.1 s.
    surge_m_s2: Annotated[float, Field(gt=0, le=40.0)] = 10.5
    braking_m_s2: Annotated[float, Field(gt=0, le=20.0)] = 1.7
    # Longest time from the tick that decides on a command to its effect on the cart.
    latency_s: Annotated[float, Field(ge=0, le=0.2)] = CONTROL_PERIOD_S
    # Speed by which the arm may drag the cart beyond its set-points without being measured.
    drag_m_s: Annotated[float, Field(ge=0, le=1.0)] = 0.0
    # Distance before the limit at which the filter aims to stop; covers sensing errors and the arm's pull at rest.
    margin_m: Annotated[float, Field(ge=0, le=0.1)] = 0.01

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.position_max_m - self.position_min_m < 4 * self.margin_m or (
            self.position_max_m <= self.position_min_m
        ):
            raise ValueError(
                "position_max_m must lie above position_min_m by four margin_m or more: widen them or lower margin_m"
            )
        return self

    def braking_law(self, hold_s: float) -> BrakingLaw:
        """Return the braking law for these limits and a rail link that holds a set-point for `hold_s`."""
        return BrakingLaw(
            position_min_m=self.position_min_m + self.margin_m,
            position_max_m=self.position_max_m - self.margin_m,
            surge_m_s2=self.surge_m_s2,
            braking_m_s2=self.braking_m_s2,
            latency_s=self.latency_s,
            hold_s=hold_s,
            drag_m_s=self.drag_m_s,
        )


class PressureLimits(Strict):
    """Limits of the muscle's gauge pressure that the safety filter enforces."""

    min_kpa: Annotated[float, Field(ge=PRESSURE_MIN_KPA, le=0.0)] = PRESSURE_MIN_KPA
    max_kpa: Annotated[float, Field(gt=0.0, le=PRESSURE_MAX_KPA)] = PRESSURE_MAX_KPA
    # The shipped policies may step the full range within a tick (621 kPa/s at 30 Hz). Lower it for gentler motion.
    slew_max_kpa_s: Annotated[float, Field(gt=0, le=1000.0)] = 621.0
    # The failsafe stops the arm when the regulator's sensor exceeds the range by more than this.
    sensor_tolerance_kpa: Annotated[float, Field(ge=0, le=5.0)] = 2.0


class Limits(Strict):
    """Limits of rail and pressure; they cannot be switched off."""

    rail: RailLimits = RailLimits()
    pressure: PressureLimits = PressureLimits()


class Failsafe(Strict):
    """Largest ages, delays and disagreements before the failsafe reacts."""

    # Age limit without an estimate. An estimate replaces dropped frames for mocap_bridge_s; 0: never.
    mocap_stale_s: Annotated[float, Field(gt=0, le=1.0)] = 0.1
    mocap_bridge_s: Annotated[float, Field(ge=0, le=0.25)] = 0.15
    # Largest delay of poses from exposure to arrival. Poses that are late but within it cause a warning.
    mocap_late_max_s: Annotated[float, Field(gt=0, le=0.14)] = 0.1
    pressure_stale_s: Annotated[float, Field(gt=0, le=1.0)] = 0.15
    rail_stale_s: Annotated[float, Field(gt=0, le=1.0)] = 0.15
    arming_frames: Annotated[int, Field(ge=1, le=1000)] = 30  # fresh mocap frames required before arming
    arming_timeout_s: Annotated[float, Field(gt=0, le=30)] = 3.0
    policy_budget_s: Annotated[float, Field(gt=0, le=0.03)] = 0.02
    missed_ticks_max: Annotated[int, Field(ge=1, le=30)] = 3  # in a row
    rail_mocap_disagreement_m: Annotated[float, Field(gt=0, le=0.2)] = 0.03


class Control(Strict):
    """Settings of the control loop."""

    rate_hz: Literal[30] = CONTROL_RATE_HZ
    realtime_priority: Annotated[int, Field(ge=0, le=98)] = 20  # SCHED_FIFO priority of the loop, if permitted; 0: off
    policy: str = "reach"  # the policy in use at start


class Workspace(Strict):
    """Allowed region of reach goals, which must also be within the arm's length of the rail."""

    y_min_m: Annotated[float, Field(ge=-0.75, le=0.75)] = -0.6
    y_max_m: Annotated[float, Field(ge=-0.75, le=0.75)] = 0.6
    z_min_m: Annotated[float, Field(ge=0.4, le=1.4)] = 0.50
    z_max_m: Annotated[float, Field(ge=0.4, le=1.4)] = 0.85

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if not (self.y_min_m < self.y_max_m and self.z_min_m < self.z_max_m):
            raise ValueError("y_min_m must lie below y_max_m, and z_min_m below z_max_m: swap or widen them")
        return self


class Goals(Strict):
    """Criteria of a reached goal ([P] section 4)."""

    workspace: Workspace = Workspace()
    success_radius_m: Annotated[float, Field(gt=0, le=0.2)] = 0.04
    time_limit_s: Annotated[float, Field(gt=0, le=600)] = 100 / CONTROL_RATE_HZ


class Policy(Strict):
    """A policy made from a plug-in with options; its key is the policy's name."""

    plugin: str
    options: dict[str, str | float | int | bool] = Field(default_factory=dict)


class Mocap(Strict):
    """Motion capture over Zenoh (the daemon listens, bridges connect), or from an installed plugin with options."""

    driver: str = "zenoh"  # or a plug-in of the group softarm.mocap_sources
    endpoint: Endpoint = "tcp/127.0.0.1:7447"
    key: str = "softarm/mocap"
    options: dict[str, str | float | int | bool] = Field(default_factory=dict)  # options of the plug-in

    @model_validator(mode="after")
    def _check_options(self) -> Self:
        if self.driver == "zenoh" and self.options:
            raise ValueError(f"options {', '.join(self.options)} are a plugin's: name it as driver, or remove them")
        return self


class SerialRegulator(Strict):
    """The Teensy that drives the pressure regulators."""

    driver: Literal["serial"] = "serial"
    port: str = "/dev/serial/by-id/usb-Teensyduino_USB_Serial-if00"
    # The device vents after this time without a command.
    time_to_live_s: Annotated[float, Field(gt=0.03, le=0.25)] = 0.1


class DryveRail(Strict):
    """The igus dryve D1 over Modbus TCP."""

    driver: Literal["dryve_d1"] = "dryve_d1"
    host: str = "169.254.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 502
    units_per_m: Annotated[float, Field(ge=1000, le=10_000_000)] = 100_000  # 60A8h: 0.01 mm by default
    # Position of the rail's middle on the homed axis.
    centre_m: Annotated[float, Field(ge=-2.0, le=2.0)] = 0.30
    reversed: bool = False  # true: the axis counts down towards +y
    asks_homed: bool = True  # true: arm only if the drive reports that it is homed
    acceleration_m_s2: Annotated[float, Field(gt=0, le=20)] = 6.0
    quick_stop_m_s2: Annotated[float, Field(gt=0, le=20)] = 6.0
    timeout_s: Annotated[float, Field(gt=0, le=1)] = 0.1
    # The rail process brakes after this time without a new set-point, and resumes with the next one.
    hold_s: Annotated[float, Field(gt=0.03, le=0.1)] = 0.045
    # After this time it stops, switches the drive off and keeps it off until the arm is armed again.
    time_to_live_s: Annotated[float, Field(gt=0.03, le=0.5)] = 0.15


class Drivers(Strict):
    """Settings of the three device drivers."""

    mocap: Mocap = Mocap()
    regulator: SerialRegulator = SerialRegulator()
    rail: DryveRail = DryveRail()


ORIGIN = re.compile(r"https://[a-z0-9.-]+(:[1-9][0-9]{0,4})?")


class Api(Strict):
    """Settings of the REST API. Any address but loopback requires a token; each token file is for another role."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8080
    stop_port: Annotated[int, Field(ge=0, le=65535)] | None = None  # dedicated stop port; null: port + 1
    token_file: Path | None = None  # token that permits everything
    view_token_file: Path | None = None  # token that permits reading and stopping
    stop_token_file: Path | None = None  # token that permits stopping
    public_origin: str | None = None  # address of a TLS proxy before this API, as browsers show it
    reports: Path = Path("reports")  # directory of diagnosis reports that the API serves

    @model_validator(mode="after")
    def _check_token_files(self) -> Self:
        for key in ("view_token_file", "stop_token_file"):
            if self.token_file is None and getattr(self, key) is not None:
                raise ValueError(
                    f"{key} without token_file: any client may command; name a token_file too, or remove it"
                )
        return self

    @model_validator(mode="after")
    def _check_public_origin(self) -> Self:
        if self.public_origin is None:
            return self
        if not ORIGIN.fullmatch(self.public_origin) or self.public_origin.endswith(":443"):
            raise ValueError(
                f"public_origin is {self.public_origin!r}; allowed https://HOST or https://HOST:PORT as a browser "
                "shows it: lower case, no path, no :443"
            )
        if self.token_file is None:
            raise ValueError(
                "public_origin without token_file: every client of the proxy may command; name a token_file too"
            )
        return self

    @model_validator(mode="after")
    def _check_ports(self) -> Self:
        if self.stop_port is None and self.port == 65535:
            raise ValueError("port 65535 leaves no port for the stop: choose another, or name a stop_port")
        if self.stop_port == self.port != 0:
            raise ValueError(f"stop_port is {self.port} like port: choose another, or null for the one after port")
        return self

    @property
    def stops_at(self) -> int:
        """Return the dedicated stop port; 0 means any free port."""
        return self.stop_port if self.stop_port is not None else self.port + 1 if self.port else 0


class Recorder(Strict):
    """Settings of the flight recorder."""

    directory: Path = Path("logs")
    enabled: bool = True
    flush_interval_s: Annotated[float, Field(gt=0, le=1)] = 0.05
    queue_max: Annotated[int, Field(ge=100)] = 10_000
    # Interval of recorded ticks while the arm is disarmed and nothing changes; 0: every tick. Every tick within
    # around_s before and after a change is recorded.
    idle_interval_s: Annotated[float, Field(ge=0, le=3600)] = 5.0
    around_s: Annotated[float, Field(ge=0.5, le=60)] = 5.0
    # Size and age at which a new file begins, as soon as no goal is active.
    file_max_mb: Annotated[int, Field(ge=1, le=1_000_000)] = 500
    file_max_days: Annotated[float, Field(gt=0, le=365)] = 1.0
    # Limits beyond which the oldest logs are deleted; null: logs are never deleted.
    keep_mb: Annotated[int, Field(ge=2, le=100_000_000)] | None = None
    keep_days: Annotated[float, Field(gt=0, le=36_500)] | None = None
    # Number and total size of incident files beyond which the oldest are deleted.
    incidents_max: Annotated[int, Field(ge=1, le=1000)] = 50
    incidents_max_mb: Annotated[int, Field(ge=20, le=100_000)] = 200
    # false: arming is refused while the log cannot be written. With `enabled: false` no log is needed.
    arm_without_log: bool = False


class Ros(Strict):
    """ROS 2 topics over Zenoh in the wire format of rmw_zenoh; off without a router."""

    router: str | None = None  # tcp/HOST:PORT; null: off
    domain_id: Annotated[int, Field(ge=0, le=232)] = 0  # ROS_DOMAIN_ID
    name: str = "softarm"  # of the node; its topics are /NAME/...
    commands: Literal["none", "stop", "all"] = "none"  # topics that may command the robot

    @model_validator(mode="after")
    def _check_texts(self) -> Self:
        if self.router is not None and (tcp_address(self.router) or ("", 0))[1] == 0:
            allowed = "tcp/HOST:PORT with a port from 1 to 65535, e.g. tcp/127.0.0.1:7447, or null"
            raise ValueError(f"ros.router is {self.router!r}; allowed {allowed}")
        if not re.fullmatch("[a-z][a-z0-9_]*", self.name):
            raise ValueError(f"ros.name is {self.name!r}; allowed a-z, 0-9 and _ after a letter: choose another")
        return self

    @property
    def address(self) -> tuple[str, int]:
        """Return host and port of a router that is not null."""
        address = tcp_address(self.router or "")
        assert address is not None
        return address


class Config(Strict):
    """Data model of softarm.yaml."""

    limits: Limits = Limits()
    failsafe: Failsafe = Failsafe()
    control: Control = Control()
    goals: Goals = Goals()
    policies: dict[str, Policy] = Field(default_factory=dict)
    drivers: Drivers = Drivers()
    api: Api = Api()
    recorder: Recorder = Recorder()
    ros: Ros = Ros()

    @model_validator(mode="after")
    def _check_ramp(self) -> Self:
        ramp, limit = self.drivers.rail.acceleration_m_s2, self.limits.rail.acceleration_max_m_s2
        if ramp > limit:
            raise ValueError(
                f"drivers.rail.acceleration_m_s2 is {ramp}, above limits.rail.acceleration_max_m_s2 {limit}: "
                "lower the drive's ramp or raise the limit"
            )
        return self
