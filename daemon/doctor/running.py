"""What a running daemon says of itself over REST: rates, ages, latency, and why it cannot be armed."""

import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import httpx

from softarm.daemon.doctor.finding import Finding, State, by, ok, problem, warning
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
    """A daemon that answers."""

    url: str
    refused: str | None = None  # why it does not tell
    statuses: tuple[dict[str, Any], ...] = ()  # GET /api/status, one after another

    @property
    def in_use(self) -> bool:
        """Whether it may be moving the arm: then nothing heavy is done beside it. Not known counts as yes."""
        return not self.statuses or self.statuses[-1]["mode"] in IN_USE


def look(url: str, token: str | None, samples: int = SAMPLES, apart_s: float = APART_S) -> Running | None:
    """Ask for so many statuses; None where no softarm daemon answers. Raises ValueError for what is no URL."""
    try:
        scheme = httpx.URL(url).scheme
    except httpx.InvalidURL as error:
        raise ValueError(f"{url!r} is no URL ({error})") from None
    if scheme not in ("http", "https"):
        raise ValueError(f"{url!r} lacks http:// or https://")
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    statuses: list[dict[str, Any]] = []
    with httpx.Client(base_url=url, headers=headers, timeout=ASK_S, trust_env=False) as client:
        for number in range(samples):
            if number:
                time.sleep(apart_s)
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
    """Findings on a daemon that answers; what is too old or late is told by the configuration's limits."""
    if facts.refused is not None:
        yield problem("daemon", f"{facts.url}: {facts.refused}", "give its token with --token-file, or see its output")
    if not facts.statuses:
        return
    now = facts.statuses[-1]
    yield ok("daemon", f"{facts.url}, softarm {now['version']}, {now['mode']}, up for {now['uptime_s']:.0f} s")
    if now["stalled"]:
        yield problem(
            "loop", "it no longer ticks", "see the daemon's own output (`journalctl -u softarmd`); restart it"
        )
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
            yield problem("arming", reason, "see to it, then `softarm arm`")
        if not now["arming_refusals"]:
            yield ok("arming", "nothing stands against it")


def _rates(statuses: Sequence[dict[str, Any]], config: Config) -> Iterator[Finding]:
    """How often the loop ticks and frames arrive; frames are counted by the sequence numbers of their bridge."""
    first, last = statuses[0], statuses[-1]
    seconds = (last["t_ns"] - first["t_ns"]) * 1e-9
    if seconds <= 0.0:
        return
    rate_hz, wanted_hz = (last["tick"] - first["tick"]) / seconds, config.control.rate_hz
    late_ms = max(each["late_ns"] for each in statuses) * 1e-6
    missed = last["missed_total"] - first["missed_total"]
    figure = f"{rate_hz:.1f} Hz, at most {late_ms:.1f} ms late, {missed} missed now, {last['missed_total']} in all"
    if missed or abs(rate_hz / wanted_hz - 1.0) > RATE_OFF_MAX:
        yield problem("loop", figure, f"{wanted_hz} Hz are wanted: take load off this computer; see `scheduling` below")
    else:
        yield ok("loop", figure)
    seen = [each["observed"]["mocap_sequence"] for each in (first, last) if each["observed"]]
    if len(seen) == 2:
        frames_hz = (seen[1] - seen[0]) / seconds
        figure = f"{frames_hz:.0f} frames a second"
        if frames_hz < wanted_hz * (1.0 - RATE_OFF_MAX):
            advice = f"raise the cameras' rate to {wanted_hz} Hz or more, or see what the bridge loses"
            yield warning("motion capture's rate", figure, advice)
        else:
            yield ok("motion capture's rate", figure)


def _ages(statuses: Sequence[dict[str, Any]], config: Config) -> Iterator[Finding]:
    """How old each device's readings were when a tick began, at worst."""
    failsafe, problems = config.failsafe, statuses[-1]["problems"]
    for name, device, key, stale_s in (
        ("motion capture", "mocap", "mocap", failsafe.mocap_stale_s),
        ("regulator", "regulator", "pressure", failsafe.pressure_stale_s),
        ("rail", "rail", "rail", failsafe.rail_stale_s),
    ):
        ages_ms = [age for each in statuses if (age := each["ages_ms"][key]) is not None]
        if problems[device]:
            yield problem(name, problems[device], "see to it; `softarm status --watch` shows when it is well")
        elif not ages_ms:
            yield problem(name, "no reading yet", "switch the whole robot on; readings are judged once all are there")
        else:
            figure = f"readings are {max(ages_ms):.0f} ms old at most"
            limit = f"failsafe.{key}_stale_s is {stale_s * 1e3:g} ms"
            match by(max(ages_ms), 0.6 * stale_s * 1e3, stale_s * 1e3):
                case State.OK:
                    yield ok(name, f"{figure} ({limit})")
                case State.WARNING:
                    yield warning(name, figure, f"{limit}: look for what delays them, network or load")
                case _:
                    yield problem(name, figure, f"{limit}: look for what holds them up, network or load")


def _times(statuses: Sequence[dict[str, Any]], config: Config) -> Iterator[Finding]:
    """What the rail's exchanges and the policy take of a tick."""
    cycles_ms = [cycle for each in statuses if (cycle := each["rail_cycle_max_ms"]) is not None]
    if cycles_ms:
        figure, latency_ms = f"{max(cycles_ms):.1f} ms at most", config.limits.rail.latency_s * 1e3
        match by(max(cycles_ms), min(EXCHANGES_FINE_MS, latency_ms), latency_ms):
            case State.OK:
                yield ok("rail's exchanges", figure)
            case State.WARNING:
                yield warning("rail's exchanges", figure, "a tick has 33 ms: connect the drive by a cable of its own")
            case _:
                advice = f"limits.rail.latency_s is {latency_ms:.0f} ms: a cable of its own, or raise it"
                yield problem("rail's exchanges", figure, f"{advice} (docs/limits.md)")
    policy_ms, budget_ms = max(each["policy_ns"] for each in statuses) * 1e-6, config.failsafe.policy_budget_s * 1e3
    if policy_ms > budget_ms:
        advice = f"failsafe.policy_budget_s is {budget_ms:g} ms: choose a smaller policy, or take load off"
        yield warning("policy's time", f"{policy_ms:.1f} ms", advice)


def _zero(statuses: Sequence[dict[str, Any]], config: Config) -> Iterator[Finding]:
    """How far the cart by the axis is from the cart by motion capture, in the middle of what was seen at rest."""
    name, homing = "rail's zero", "end the daemon, then `softarm rail home`; else `softarm rail centre`"
    if any(event["name"] == "rail_not_homed" for event in statuses[-1]["events"]):
        yield problem(name, "the drive says that it is not homed", homing)
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
