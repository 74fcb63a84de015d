"""Playback of an excitation by the daemon, from arming to disarming, recorded in a log."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from softarm.common import realtime
from softarm.daemon.assembly import Daemon
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.runtime.devices import Devices
from softarm.daemon.runtime.offline import Lockstep
from softarm.drivers.bodies.base import Body
from softarm.policies.excite import Excite
from softarm.policies.registry import EXCITE
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.model import Model

_POLL_S = 0.1
_ARMING_S = 10.0  # drivers connect, mocap arrives, drive and regulator arm


class Played(NamedTuple):
    """Result of an excitation: `reached` if played to its end; the log is None without recording."""

    status: GoalStatus
    log: Path | None


def length_s(config: Config, excitation: str) -> float:
    """Return the duration of an excitation including its lead-in, s, or raise PolicyError for an unknown name."""
    return (Excite.describe(excitation).episode_steps or 0) / config.control.rate_hz


def play(config: Config, excitation: str, devices: Devices, on_time: Callable[[float], None]) -> Played:
    """Play an excitation in real time; always leaves the devices braked and vented.

    Calls `on_time` with the time played so far, s. Also raises the errors of `Daemon`.

    Raises:
        RuntimeError: The robot did not arm or the goal was refused; the message has the reasons.
    """
    config = _with_excitation(config, excitation)
    realtime.outrank_other_programs(config.control.realtime_priority)
    with Daemon(config, devices) as daemon:  # at the end it brakes, vents and switches off
        _arm(daemon)
        number = daemon.inbox.post("goal", goal=Goal("run"), who="softarm excite")
        deadline_s = time.monotonic() + length_s(config, excitation) + _ARMING_S
        while (status := _goal(daemon, number)) is None or status.state == "running":
            on_time(0.0 if status is None else status.time_s)
            if time.monotonic() > deadline_s:
                raise RuntimeError("the control loop has stalled; see its own output")
            time.sleep(_POLL_S)
        return Played(status, daemon.recorder.path)


def play_simulated(
    config: Config,
    excitation: str,
    model: Model | None,
    on_time: Callable[[float], None],
    body: Body | None = None,
) -> Played:
    """Play an excitation in lockstep with a robot in this process; repeatable and without waiting.

    Calls `on_time` with the time played so far, s. `body` replaces the simulated robot made from `model`.

    Raises:
        RuntimeError: The robot did not arm; the message has the reasons.
        RecorderError: The log cannot be written.
        PolicyError: There is no excitation of this name.
    """
    config = _with_excitation(config, excitation)
    policy = Excite(excitation)
    policy.spec = replace(policy.spec, name=config.control.policy)
    recorder = Recorder(config, policy.spec)
    recorder.start()
    try:
        lockstep = Lockstep(config, policy, model, recorder.tick, body)
        lockstep.arm()
        outputs = lockstep.tick(lockstep.request("goal", Goal("run")))
        while outputs.goal.state == "running":
            outputs = lockstep.tick()
            on_time(outputs.goal.time_s)
        lockstep.tick(lockstep.request("disarm"))
    finally:
        recorder.stop()
    return Played(outputs.goal, recorder.path)


def _with_excitation(config: Config, excitation: str) -> Config:
    """Return the configuration with the excitation as its policy."""
    control = config.control.model_copy(update={"policy": f"{EXCITE}{excitation}"})
    return config.model_copy(update={"control": control})


def _arm(daemon: Daemon) -> None:
    """Wait until arming is possible, arm, and wait until the robot is armed."""
    deadline_s = time.monotonic() + _ARMING_S
    asked = False
    reasons: tuple[str, ...] = ("no control tick yet",)
    while time.monotonic() < deadline_s:
        if (snapshot := daemon.loop.snapshot) is not None:
            if snapshot.mode == "armed":
                return
            reasons = snapshot.arming_refusals or reasons
            if not snapshot.arming_refusals and not asked:
                daemon.inbox.post("arm", who="softarm excite")
                asked = True
        time.sleep(_POLL_S)
    raise RuntimeError(f"did not arm within {_ARMING_S:.0f} s: {'; '.join(reasons)}; then try again")


def _goal(daemon: Daemon, number: int) -> GoalStatus | None:
    """Return the state of the goal, or None until the loop has accepted the request; raise if it is refused."""
    snapshot = daemon.loop.snapshot
    answer = next((r for r in snapshot.results if r.number == number), None) if snapshot else None
    if snapshot is None or answer is None:
        # Requests are answered in order: a running goal is ours even if its answer is no longer kept.
        return snapshot.goal if snapshot and snapshot.goal.number else None
    if not answer.accepted:
        raise RuntimeError("; ".join(answer.reasons))
    return snapshot.goal
