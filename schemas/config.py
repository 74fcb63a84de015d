"""The daemon's configuration: one YAML file, units in every name, unknown keys refused."""

import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from softarm.common.braking import BrakingLaw
from softarm.schemas.base import Strict
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
    """What the safety filter holds the cart to."""

    position_min_m: Annotated[float, Field(ge=-RAIL_TRAVEL_M, le=RAIL_TRAVEL_M)] = -RAIL_LIMIT_M
    position_max_m: Annotated[float, Field(ge=-RAIL_TRAVEL_M, le=RAIL_TRAVEL_M)] = RAIL_LIMIT_M
    velocity_max_m_s: Annotated[float, Field(gt=0, le=CART_VELOCITY_MAX_M_S)] = CART_VELOCITY_MAX_M_S
    # The drive's own ramp is refused above this; a drive without one has its set-points slewed at it.
    acceleration_max_m_s2: Annotated[float, Field(gt=0, le=20.0)] = 6.0
    # What speeding up and braking are counted on. The swinging arm pulls the cart along either way: an arm that is
    # swung up on purpose leaves little of the ramp for a tenth of a second.
    surge_m_s2: Annotated[float, Field(gt=0, le=40.0)] = 10.5
    braking_m_s2: Annotated[float, Field(gt=0, le=20.0)] = 1.7
    # From the tick that decides on a command to its effect on the cart, at most.
    latency_s: Annotated[float, Field(ge=0, le=0.2)] = CONTROL_PERIOD_S
    # By how much the arm may come to drag the cart beyond its set-points, unseen; what is seen is counted anyway.
    drag_m_s: Annotated[float, Field(ge=0, le=1.0)] = 0.0
    # How far before the limit the filter aims to stop; covers sensing error and the arm's pull at rest.
    margin_m: Annotated[float, Field(ge=0, le=0.1)] = 0.01

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.position_max_m - self.position_min_m < 4 * self.margin_m or (
            self.position_max_m <= self.position_min_m
        ):
            raise ValueError(
                "position_max_m must lie above position_min_m by four margin_m or more: widen them or lower margin_m"
            )
        return self

    def braking_law(self, hold_s: float) -> BrakingLaw:
        """The law that holds the cart to these limits, with a rail whose link holds a set-point for `hold_s`."""
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
    """What the safety filter holds the muscle's pressure to (gauge)."""

    min_kpa: Annotated[float, Field(ge=PRESSURE_MIN_KPA, le=0.0)] = PRESSURE_MIN_KPA
    max_kpa: Annotated[float, Field(gt=0.0, le=PRESSURE_MAX_KPA)] = PRESSURE_MAX_KPA
    # The seed's policies may step the full range within a tick (621 kPa/s at 30 Hz); lower it to be gentle.
    slew_max_kpa_s: Annotated[float, Field(gt=0, le=1000.0)] = 621.0
    # The regulator's own sensor may pass the range by this much before the failsafe stops the arm.
    sensor_tolerance_kpa: Annotated[float, Field(ge=0, le=5.0)] = 2.0


class Limits(Strict):
    """Mandatory and on by default."""

    rail: RailLimits = RailLimits()
    pressure: PressureLimits = PressureLimits()


class Failsafe(Strict):
    """How old or late a thing may be before the failsafe answers."""

    # Without a bridge; a drop-out is bridged by an estimate for so long, 0: not at all.
    mocap_stale_s: Annotated[float, Field(gt=0, le=1.0)] = 0.1
    mocap_bridge_s: Annotated[float, Field(ge=0, le=0.25)] = 0.15
    # A camera whose poses are so old on arrival is flown with a warning, an older one is not.
    mocap_late_max_s: Annotated[float, Field(gt=0, le=0.14)] = 0.1
    pressure_stale_s: Annotated[float, Field(gt=0, le=1.0)] = 0.15
    rail_stale_s: Annotated[float, Field(gt=0, le=1.0)] = 0.15
    arming_frames: Annotated[int, Field(ge=1, le=1000)] = 30  # fresh mocap frames seen before arming
    arming_timeout_s: Annotated[float, Field(gt=0, le=30)] = 3.0
    policy_budget_s: Annotated[float, Field(gt=0, le=0.03)] = 0.02
    missed_ticks_max: Annotated[int, Field(ge=1, le=30)] = 3  # in a row
    rail_mocap_disagreement_m: Annotated[float, Field(gt=0, le=0.2)] = 0.03


class Control(Strict):
    """The loop."""

    rate_hz: Literal[30] = CONTROL_RATE_HZ
    realtime_priority: Annotated[int, Field(ge=0, le=98)] = 20  # SCHED_FIFO of the loop where granted; 0: off
    policy: str = "reach"  # at start


class Workspace(Strict):
    """Where a reach goal may lie; it must also be within the arm's length of the rail."""

    y_min_m: Annotated[float, Field(ge=-0.75, le=0.75)] = -0.6
    y_max_m: Annotated[float, Field(ge=-0.75, le=0.75)] = 0.6
    z_min_m: Annotated[float, Field(ge=0.4, le=1.4)] = 0.50
    z_max_m: Annotated[float, Field(ge=0.4, le=1.4)] = 0.85

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not (self.y_min_m < self.y_max_m and self.z_min_m < self.z_max_m):
            raise ValueError("y_min_m must lie below y_max_m, and z_min_m below z_max_m: swap or widen them")
        return self


class Goals(Strict):
    """What reaching means ([P] section 4)."""

    workspace: Workspace = Workspace()
    success_radius_m: Annotated[float, Field(gt=0, le=0.2)] = 0.04
    time_limit_s: Annotated[float, Field(gt=0, le=600)] = 100 / CONTROL_RATE_HZ


class Policy(Strict):
    """A policy made from a plugin with options; its key is the name it is chosen by."""

    plugin: str
    options: dict[str, str | float | int | bool] = Field(default_factory=dict)


class Mocap(Strict):
    """Motion capture over Zenoh (the daemon listens, bridges connect), or from an installed plugin with options."""

    driver: str = "zenoh"  # or a plugin of the group softarm.mocap_sources
    endpoint: str = "tcp/127.0.0.1:7447"
    key: str = "softarm/mocap"
    options: dict[str, str | float | int | bool] = Field(default_factory=dict)  # the plugin's

    @model_validator(mode="after")
    def _options_are_a_plugins(self) -> Self:
        if self.driver == "zenoh" and self.options:
            raise ValueError(f"options {', '.join(self.options)} are a plugin's: name it as driver, or remove them")
        return self


class SerialRegulator(Strict):
    """The Teensy that drives the pressure regulators."""

    driver: Literal["serial"] = "serial"
    port: str = "/dev/serial/by-id/usb-Teensyduino_USB_Serial-if00"
    # The device vents without a command for so long.
    time_to_live_s: Annotated[float, Field(gt=0.03, le=0.25)] = 0.1


class DryveRail(Strict):
    """The igus dryve D1 over Modbus TCP."""

    driver: Literal["dryve_d1"] = "dryve_d1"
    host: str = "169.254.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 502
    units_per_m: Annotated[float, Field(gt=0)] = 100_000  # 60A8h: 0.01 mm by default
    # Where on the axis (as homed) the middle of the rail is.
    centre_m: Annotated[float, Field(ge=-2.0, le=2.0)] = 0.30
    reversed: bool = False  # true: the axis counts down towards +y
    asks_homed: bool = True  # whether it is homed; a drive that says no is not armed
    acceleration_m_s2: Annotated[float, Field(gt=0, le=20)] = 6.0
    quick_stop_m_s2: Annotated[float, Field(gt=0, le=20)] = 6.0
    timeout_s: Annotated[float, Field(gt=0, le=1)] = 0.1
    # A set-point that is not renewed for so long makes the link brake, and go on when the next one comes ...
    hold_s: Annotated[float, Field(gt=0.03, le=0.1)] = 0.045
    # ... and for so long makes it stop, switch the drive off and leave it off until armed anew.
    time_to_live_s: Annotated[float, Field(gt=0.03, le=0.5)] = 0.15


class Drivers(Strict):
    """The three devices."""

    mocap: Mocap = Mocap()
    regulator: SerialRegulator = SerialRegulator()
    rail: DryveRail = DryveRail()


ORIGIN = re.compile(r"https://[a-z0-9.-]+(:[1-9][0-9]{0,4})?")


class Api(Strict):
    """The REST endpoint; any address but loopback requires a token. Each file holds one, of another role."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8080
    stop_port: Annotated[int, Field(ge=0, le=65535)] | None = None  # of the stop's own way; null: the one after port
    token_file: Path | None = None  # whose holder may do everything
    view_token_file: Path | None = None  # may look, and stop
    stop_token_file: Path | None = None  # may stop
    public_origin: str | None = None  # of a proxy with TLS before this API, as browsers see it
    reports: Path = Path("reports")  # directory of the diagnosis' reports, to be shown

    @model_validator(mode="after")
    def _commanding_takes_a_token_if_looking_does(self) -> Self:
        for key in ("view_token_file", "stop_token_file"):
            if self.token_file is None and getattr(self, key) is not None:
                raise ValueError(
                    f"{key} without token_file: whoever has no token may command; name a token_file too, or remove it"
                )
        return self

    @model_validator(mode="after")
    def _what_everybody_reaches_takes_a_token(self) -> Self:
        if self.public_origin is None:
            return self
        if not ORIGIN.fullmatch(self.public_origin) or self.public_origin.endswith(":443"):
            raise ValueError(
                f"public_origin is {self.public_origin!r}; allowed https://HOST or https://HOST:PORT as a browser "
                "shows it: small letters, no path, no :443"
            )
        if self.token_file is None:
            raise ValueError(
                "public_origin without token_file: whoever reaches the proxy may command; name a token_file too"
            )
        return self

    @model_validator(mode="after")
    def _a_port_for_each(self) -> Self:
        if self.stop_port is None and self.port == 65535:
            raise ValueError("port 65535 has none after it: choose another, or name a stop_port")
        if self.stop_port == self.port != 0:
            raise ValueError(f"stop_port is {self.port} like port: choose another, or null for the one after port")
        return self

    @property
    def stops_at(self) -> int:
        """The port of the stop's own way; 0: any."""
        return self.stop_port if self.stop_port is not None else self.port + 1 if self.port else 0


class Recorder(Strict):
    """The black box."""

    directory: Path = Path("logs")
    enabled: bool = True
    flush_interval_s: Annotated[float, Field(gt=0, le=1)] = 0.05
    queue_max: Annotated[int, Field(ge=100)] = 10_000
    # Of a disarmed arm at which nothing changes one tick so often, 0 for all; around a change all, before and after.
    idle_interval_s: Annotated[float, Field(ge=0, le=3600)] = 5.0
    around_s: Annotated[float, Field(ge=0.5, le=60)] = 5.0
    # A new file once one is so large or so old, as soon as no goal is flown.
    file_max_mb: Annotated[int, Field(ge=1, le=1_000_000)] = 500
    file_max_days: Annotated[float, Field(gt=0, le=365)] = 1.0
    # The oldest logs are deleted beyond this; without a number none ever is.
    keep_mb: Annotated[int, Field(ge=2, le=100_000_000)] | None = None
    keep_days: Annotated[float, Field(gt=0, le=36_500)] | None = None
    # Of the incident files of emergency stops the oldest are deleted beyond so many, or so large.
    incidents_max: Annotated[int, Field(ge=1, le=1000)] = 50
    incidents_max_mb: Annotated[int, Field(ge=20, le=100_000)] = 200
    # Otherwise arming is refused while nothing can be written. (`enabled: false` asks for no log: it refuses nothing.)
    arm_without_log: bool = False


class Config(Strict):
    """softarm.yaml."""

    limits: Limits = Limits()
    failsafe: Failsafe = Failsafe()
    control: Control = Control()
    goals: Goals = Goals()
    policies: dict[str, Policy] = Field(default_factory=dict)
    drivers: Drivers = Drivers()
    api: Api = Api()
    recorder: Recorder = Recorder()

    @model_validator(mode="after")
    def _drive_ramp_within_limit(self) -> Self:
        ramp, limit = self.drivers.rail.acceleration_m_s2, self.limits.rail.acceleration_max_m_s2
        if ramp > limit:
            raise ValueError(
                f"drivers.rail.acceleration_m_s2 is {ramp}, above limits.rail.acceleration_max_m_s2 {limit}: "
                "lower the drive's ramp or raise the limit"
            )
        return self
