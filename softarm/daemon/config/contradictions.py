"""Contradictions between values of a configuration that are allowed by themselves.

Checked for every configuration file, but not in `Config` itself: the configuration inside a log stays readable.
"""

from collections.abc import Iterator

from softarm.common.address import is_loopback, is_shared
from softarm.daemon.control.checks import OUTSIDE_M
from softarm.daemon.control.safety import KNOWN_S
from softarm.drivers.mocap import plugged
from softarm.schemas.base import tcp_address
from softarm.schemas.config import Config
from softarm.schemas.robot import RAIL_TRAVEL_M

LATENCY_MIN_S = 0.005  # an exchange with the drive takes longer on any network
PULL_SHARE_MAX = 0.5  # of the drive's ramp; a higher surge is caution and does not reduce braking
ROUNDING = 1e-9  # accepts 1/30 s written by hand


def contradictions(config: Config) -> Iterator[str]:
    """Yield a message for each: both keys with their values, and the next step. The wrong key comes first."""
    yield from _rail(config)
    yield from _times(config)
    yield from _folders(config)
    yield from _ports(config)
    yield from _ros(config)


def arms_pull_m_s2(ramp_m_s2: float, surge_m_s2: float) -> float:
    """Return the deceleration lost to the arm's pull, from the drive's ramp and the cart's highest acceleration."""
    return min(max(surge_m_s2 - ramp_m_s2, 0.0), PULL_SHARE_MAX * ramp_m_s2)


def _rail(config: Config) -> Iterator[str]:
    limits, drive = config.limits.rail, config.drivers.rail
    ramp, surge, braking = drive.acceleration_m_s2, limits.surge_m_s2, limits.braking_m_s2
    if surge < ramp:
        yield (
            f"limits.rail.surge_m_s2 is {surge}, below drivers.rail.acceleration_m_s2 {ramp}: the drive alone "
            f"accelerates the cart faster than assumed; raise surge_m_s2 to {ramp} plus the arm's pull, or lower "
            "the ramp"
        )
    pull = arms_pull_m_s2(ramp, surge)
    if braking > ramp - pull + ROUNDING:
        yield (
            f"limits.rail.braking_m_s2 is {braking}, above drivers.rail.acceleration_m_s2 {ramp} less the arm's pull "
            f"of {pull:g} (limits.rail.surge_m_s2 {surge} less the ramp, at most half of it): the cart cannot brake "
            f"that hard; lower braking_m_s2 to {ramp - pull:g}, or raise the ramp"
        )
    if braking > drive.quick_stop_m_s2:
        yield (
            f"drivers.rail.quick_stop_m_s2 is {drive.quick_stop_m_s2}, below limits.rail.braking_m_s2 {braking}: an "
            f"emergency stop would brake less than assumed; raise quick_stop_m_s2 to {braking} or more"
        )
    if limits.latency_s < LATENCY_MIN_S:
        yield (
            f"limits.rail.latency_s is {limits.latency_s}, below {LATENCY_MIN_S}: no command reaches "
            f"drivers.rail.driver {drive.driver} faster; measure the latency, or remove the line for the default"
        )
    for key, limit_m in (("position_min_m", limits.position_min_m), ("position_max_m", limits.position_max_m)):
        if abs(limit_m) + OUTSIDE_M > RAIL_TRAVEL_M + ROUNDING:
            yield (
                f"limits.rail.{key} is {limit_m}, and the mechanical stop at {RAIL_TRAVEL_M} m is less than "
                f"{OUTSIDE_M} m beyond it: the cart would hit the stop before the failsafe reacts; "
                f"move the limit within {RAIL_TRAVEL_M - OUTSIDE_M:g} m of the middle"
            )


def _times(config: Config) -> Iterator[str]:
    rate = config.control.rate_hz
    period_s = 1 / rate
    failsafe, live_s = config.failsafe, config.drivers.regulator.time_to_live_s
    if live_s <= period_s + ROUNDING:
        yield (
            f"drivers.regulator.time_to_live_s is {live_s}, no longer than a tick ({period_s:.4f} s at control.rate_hz "
            f"{rate}): the regulator would vent between two commands; raise it to {3 * period_s:.1f}"
        )
    rail = config.drivers.rail
    if rail.hold_s <= period_s + ROUNDING:
        yield (
            f"drivers.rail.hold_s is {rail.hold_s}, no longer than a tick ({period_s:.4f} s at control.rate_hz "
            f"{rate}): the cart would be braked between two set-points; raise it to 0.045 or remove the line"
        )
    if rail.time_to_live_s <= rail.hold_s:
        yield (
            f"drivers.rail.time_to_live_s is {rail.time_to_live_s}, not above drivers.rail.hold_s {rail.hold_s}: the "
            f"drive would be switched off before it brakes; raise it to {max(0.15, 2 * rail.hold_s):g}"
        )
    if rail.timeout_s >= rail.time_to_live_s:
        yield (
            f"drivers.rail.timeout_s is {rail.timeout_s}, not below drivers.rail.time_to_live_s {rail.time_to_live_s}: "
            f"the link would still wait for an answer when it must switch the drive off; lower it to "
            f"{min(0.1, 0.5 * rail.time_to_live_s):g}"
        )
    if failsafe.rail_stale_s > KNOWN_S:
        yield (
            f"failsafe.rail_stale_s is {failsafe.rail_stale_s}, above {KNOWN_S}: the safety filter brakes for an "
            f"axis reading older than that without reporting an event; lower it to {KNOWN_S} or less"
        )
    for key, device, stale_s in (
        ("mocap_stale_s", "motion capture", failsafe.mocap_stale_s),
        ("pressure_stale_s", "the regulator", failsafe.pressure_stale_s),
        ("rail_stale_s", "the axis", failsafe.rail_stale_s),
    ):
        if stale_s <= period_s + ROUNDING:
            yield (
                f"failsafe.{key} is {stale_s}, no longer than a tick ({period_s:.4f} s at control.rate_hz {rate}): a "
                f"valid reading of {device} would count as too old; raise it to {2 * period_s:.2f} or more"
            )


def _folders(config: Config) -> Iterator[str]:
    for key, folder in (("recorder.directory", config.recorder.directory), ("api.reports", config.api.reports)):
        if str(folder).startswith("~"):
            yield f"{key} is {folder}, and ~ is not expanded in this file; write the whole path"
    kept_mb, file_mb = config.recorder.keep_mb, config.recorder.file_max_mb
    if kept_mb is not None and kept_mb < 2 * file_mb:
        yield (
            f"recorder.keep_mb is {kept_mb}, less than two files of recorder.file_max_mb {file_mb}: a log would be "
            f"deleted as soon as the next one is full; raise keep_mb to {2 * file_mb} or lower file_max_mb"
        )


def _ports(config: Config) -> Iterator[str]:
    api, mocap, ros = config.api, config.drivers.mocap, config.ros
    taken = []
    if mocap.driver == plugged.BUILT_IN and (listens := tcp_address(mocap.endpoint)) is not None:
        taken.append((f"drivers.mocap.endpoint {mocap.endpoint}", *listens))
    if ros.router is not None and is_loopback(ros.address[0]):
        taken.append((f"ros.router {ros.router}", *ros.address))
    for other, host, port in taken:
        for key, own in (("api.port", api.port), ("api.stop_port", api.stops_at)):
            if own == port and is_shared(api.host, host):
                yield f"{key} is {own}, and {other} has this port; name another port"


def _ros(config: Config) -> Iterator[str]:
    """Refuse goals of clients who would need a token at the API: a ROS message carries none."""
    ros, token_file = config.ros, config.api.token_file
    if ros.commands != "none" and ros.router is None:
        yield f"ros.commands is {ros.commands}, and ros.router is null: no command would arrive; name the router"
    elif ros.commands == "all" and token_file is not None:
        yield (
            f"ros.commands is all, and api.token_file is {token_file}: every client of the router could command "
            "without the token; set ros.commands to stop, or remove token_file"
        )
    elif ros.commands == "all" and not is_loopback(ros.address[0]):
        yield (
            f"ros.commands is all, and ros.router {ros.router} is on another machine, whose clients need a token at "
            "the API; connect to a router on 127.0.0.1 that is linked to it, or set ros.commands to stop"
        )
