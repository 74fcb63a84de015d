"""Checks of a running daemon over REST: rates, ages, latency and reasons against arming."""

import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import httpx

from softarm.common import http
from softarm.common.finding import Finding, State, by, graded, ok, problem, warning
from softarm.schemas.config import Config
from softarm.schemas.policy import Observation
from softarm.schemas.rest import API_HEADER

ASK_S = 2.0
SAMPLES, APART_S = 20, 0.1
RATE_OFF_MAX = 0.05  # by which a rate may differ, as a share, over two seconds
IN_USE = ("arming", "armed", "stopping")
STILL_M_S = 0.05  # a faster cart is elsewhere by the time that the cameras have shown it
ZERO_FINE_MM = 10.0  # axis from motion capture; the failsafe's own bound leaves a cart past its limit by as much
EXCHANGES_FINE_MS = 25.0  # of a tick's questions and answers, within 33 ms


@dataclass(frozen=True, slots=True)
class Running:
    """Answers of a running daemon."""

    url: str
    refused: str | None = None  # why the daemon refused to answer
    statuses: tuple[dict[str, Any], ...] = ()  # consecutive answers of GET /api/status

    @property
    def in_use(self) -> bool:
        """Return whether the arm may be in use, also if unknown; heavy checks are then skipped."""
        return not self.statuses or self.statuses[-1]["mode"] in IN_USE


def look(url: str, token: str | None, samples: int = SAMPLES) -> Running | None:
    """Request several statuses; return None if no softarm daemon answers. Raises ValueError for an invalid URL."""
    try:
        scheme = httpx.URL(url).scheme
    except httpx.InvalidURL as error:
        raise ValueError(f"{url!r} is no URL ({error})") from None
    if scheme not in ("http", "https"):
        raise ValueError(f"{url!r} lacks http:// or https://")
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    statuses: list[dict[str, Any]] = []
    with http.client(url, headers, ASK_S) as client:
        for number in range(samples):
            if number:
                time.sleep(APART_S)
            try:
                answer = client.get("/api/status")
                body = answer.json()
            except (httpx.HTTPError, ValueError):
                return Running(url, "it stopped answering", tuple(statuses)) if statuses else None
            if answer.is_success and isinstance(body, dict) and "arming_refusals" in body:
                statuses.append(body)
            elif API_HEADER in answer.headers:
                detail = body.get("detail") if isinstance(body, dict) else None
                return Running(url, str(detail or f"HTTP {answer.status_code}"), tuple(statuses))
            else:
                return None
    return Running(url, None, tuple(statuses))


def judge(facts: Running, config: Config) -> Iterator[Finding]:
    """Yield findings on a running daemon by the limits of the configuration."""
    if facts.refused is not None:
        yield problem("daemon", f"{facts.url}: {facts.refused}", "give its token with --token-file, or read its log")
    if not facts.statuses:
        return
    now = facts.statuses[-1]
    yield ok("daemon", f"{facts.url}, softarm {now['version']}, {now['mode']}, up for {now['uptime_s']:.0f} s")
    if now["stalled"]:
        yield problem("loop", "no longer ticks", "read the daemon's log (`journalctl -u softarmd`) and restart it")
        return
    if len(facts.statuses) > 1:
        yield from _rates(facts.statuses, config)
    yield from _ages(facts.statuses, config)
    yield from _times(facts.statuses, config)
    yield from _zero(facts.statuses, config)
    if now["recorder"]["problem"]:
        yield problem("recorder", now["recorder"]["problem"], "see `softarm status`")
    if now["mode"] == "disarmed":
        for reason in now["arming_refusals"]:
            yield problem("arming", reason, "correct it, then run `softarm arm`")
        if not now["arming_refusals"]:
            yield ok("arming", "ready to arm")


def _rates(statuses: Sequence[dict[str, Any]], config: Config) -> Iterator[Finding]:
    """Judge the rates of ticks and frames; frames are counted by sequence number."""
    first, last = statuses[0], statuses[-1]
    seconds = (last["t_ns"] - first["t_ns"]) * 1e-9
    if seconds <= 0.0:
        return
    rate_hz, wanted_hz = (last["tick"] - first["tick"]) / seconds, config.control.rate_hz
    late_ms = max(each["late_ns"] for each in statuses) * 1e-6
    missed = last["missed_total"] - first["missed_total"]
    figure = f"{rate_hz:.1f} Hz, at most {late_ms:.1f} ms late, {missed} missed now, {last['missed_total']} in all"
    state = State.PROBLEM if missed or abs(rate_hz / wanted_hz - 1.0) > RATE_OFF_MAX else State.OK
    yield graded("loop", state, figure, f"{wanted_hz} Hz required: reduce this computer's load; see `scheduling` below")
    seen = [each["observed"]["mocap_sequence"] for each in (first, last) if each["observed"]]
    if len(seen) == 2:
        frames_hz = (seen[1] - seen[0]) / seconds
        state = State.WARNING if frames_hz < wanted_hz * (1.0 - RATE_OFF_MAX) else State.OK
        advice = f"raise the cameras' rate to {wanted_hz} Hz or more, or check the bridge for lost frames"
        yield graded("motion capture's rate", state, f"{frames_hz:.0f} frames a second", advice)


def _ages(statuses: Sequence[dict[str, Any]], config: Config) -> Iterator[Finding]:
    """Judge the largest age of each device's readings at the start of a tick."""
    failsafe, problems = config.failsafe, statuses[-1]["problems"]
    for name, device, key, stale_s in (
        ("motion capture", "mocap", "mocap", failsafe.mocap_stale_s),
        ("regulator", "regulator", "pressure", failsafe.pressure_stale_s),
        ("rail", "rail", "rail", failsafe.rail_stale_s),
    ):
        ages_ms = [age for each in statuses if (age := each["ages_ms"][key]) is not None]
        if problems[device]:
            yield problem(name, problems[device], "correct it; `softarm status --watch` shows the device")
        elif not ages_ms:
            yield problem(name, "no reading yet", "switch on all devices of the robot")
        else:
            limit = f"failsafe.{key}_stale_s is {stale_s * 1e3:g} ms"
            figure = f"readings are {max(ages_ms):.0f} ms old at most ({limit})"
            state = by(max(ages_ms), 0.6 * stale_s * 1e3, stale_s * 1e3)
            yield graded(name, state, figure, "check network and load for delays")


def _times(statuses: Sequence[dict[str, Any]], config: Config) -> Iterator[Finding]:
    """Judge the duration of the rail's exchanges and of the policy."""
    cycles_ms = [cycle for each in statuses if (cycle := each["rail_cycle_max_ms"]) is not None]
    if cycles_ms:
        figure, latency_ms = f"{max(cycles_ms):.1f} ms at most", config.limits.rail.latency_s * 1e3
        advice = "a tick has 33 ms: connect the drive by a dedicated cable"
        if (state := by(max(cycles_ms), min(EXCHANGES_FINE_MS, latency_ms), latency_ms)) is State.PROBLEM:
            advice = f"limits.rail.latency_s is {latency_ms:.0f} ms: use a dedicated cable, or raise it"
            advice = f"{advice} (docs/operate/limits.md)"
        yield graded("rail's exchanges", state, figure, advice)
    policy_ms, budget_ms = max(each["policy_ns"] for each in statuses) * 1e-6, config.failsafe.policy_budget_s * 1e3
    if policy_ms > budget_ms:
        advice = f"failsafe.policy_budget_s is {budget_ms:g} ms: choose a smaller policy, or reduce the load"
        yield warning("policy's time", f"{policy_ms:.1f} ms", advice)


def _zero(statuses: Sequence[dict[str, Any]], config: Config) -> Iterator[Finding]:
    """Judge the median difference of the cart at rest between axis and motion capture."""
    name, homing = "rail's zero", "end the daemon, then `softarm rail home`; else `softarm rail centre`"
    if any(event["name"] == "rail_not_homed" for event in statuses[-1]["events"]):
        yield problem(name, "the drive reports that it is not homed", homing)
        return
    apart_mm = [
        1e3 * (each["rail_position_m"] - Observation(*seen).cart_position_m)
        for each in statuses
        if (seen := (each["observed"] or {}).get("values")) is not None
        and each["rail_position_m"] is not None
        and abs(each["rail_velocity_m_s"]) < STILL_M_S
    ]
    if not apart_mm:
        return
    off_mm, most_mm = statistics.median(apart_mm), 1e3 * config.failsafe.rail_mocap_disagreement_m
    figure = f"the axis is {off_mm:+.1f} mm from motion capture here"
    if abs(off_mm) <= min(ZERO_FINE_MM, most_mm):
        yield ok(name, figure)
    elif abs(off_mm) <= most_mm:
        yield warning(name, figure, f"the cart may pass its limits by as much: {homing}")
    else:
        yield problem(name, figure, f"at most {most_mm:.0f} mm (failsafe.rail_mocap_disagreement_m): {homing}")
