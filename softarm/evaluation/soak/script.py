"""Scripted operator of a soak test: arms, gives goals, injects faults, and reports unexpected stops."""

import json
import random
from collections import Counter
from typing import Any, NamedTuple

from softarm.daemon.control.failsafe import TABLE
from softarm.schemas.flights import TEST_TARGETS

AFTERMATH_S = 6.0  # a fault may stop the robot until connections are restored
ASKED_S = 5.0  # a requested stop or disarm shows in the status within this time
REQUEST_S = 0.5  # a request shows in the status within this time
POLICIES = ("reach", "reach-wide", "reach-robust", "pid")

# Faults of the twin, their shortest and longest duration in s, and the events that they may cause.
MOCAP, REGULATOR, RAIL = ("mocap_", "rail_disagrees"), ("pressure_", "regulator_"), ("rail_", "remote_off")
FAULTS: dict[str, tuple[float, float, tuple[str, ...]]] = {
    "mocap_freeze": (0.05, 2.0, MOCAP),
    "mocap_stuck": (0.05, 2.0, MOCAP),
    "mocap_drop_body": (0.05, 2.0, MOCAP),
    "mocap_garbage": (0.0, 0.0, MOCAP),
    "serial_silence": (0.05, 2.0, REGULATOR),
    "serial_garbage": (0.05, 2.0, REGULATOR),
    "serial_unplug": (0.1, 3.0, REGULATOR),
    "rail_silence": (0.05, 2.0, RAIL),
    "rail_segment": (0.1, 2.0, RAIL),
    "rail_drop_connection": (0.0, 0.0, RAIL),
    "rail_fault": (0.0, 0.0, RAIL),
    "remote_low": (0.1, 2.0, RAIL),
}


class Unexpected(NamedTuple):
    """Unexpected event of a soak test."""

    time_s: float  # since the beginning
    what: str
    log: str | None  # the recording that holds it


class Act(NamedTuple):
    """Action of the script: a fault for the twin, or a request to the daemon."""

    kind: str  # fault, or a request's method
    path: str  # or the fault's JSON
    body: dict[str, Any] | None = None


class Script:
    """Script without I/O: the same seed and statuses give the same actions."""

    def __init__(self, seed: int, fault_every_s: float = 15.0, change_every_s: float = 45.0) -> None:
        """Set the mean times between faults, and between changes of policy or stops, in s."""
        self._chance = random.Random(seed)
        self._every = {"fault": fault_every_s, "change": change_every_s}
        self._due_s = {what: self._chance.expovariate(1 / every) for what, every in self._every.items()}
        self._broken: list[tuple[float, tuple[str, ...]]] = []  # until when, which events
        self._was: dict[str, Any] = {}
        self._waiting_until_s = 0.0
        self._asked_s = -AFTERMATH_S  # when the script itself last ended a flight
        self.looks = self.armed = 0
        self.counts: Counter[str] = Counter()
        self.unexpected: list[Unexpected] = []

    def acts(self, status: dict[str, Any], now_s: float) -> list[Act]:
        """Return the actions that follow a status."""
        self._look(status, now_s)
        self._was = status
        if found := [*self._break(now_s), *self._change(now_s)]:
            return found
        if now_s < self._waiting_until_s:
            return []
        if found := self._next(status):
            self._waiting_until_s = now_s + REQUEST_S
        return found

    def _next(self, status: dict[str, Any]) -> list[Act]:
        """Return the next request of an operator."""
        if status["mode"] == "stopped":  # refused while a cause is present, but it resets a drive in fault
            return [Act("POST", "/api/acknowledge")]
        if status["mode"] == "disarmed":  # a fault of a device is acknowledged too, when its cause is gone
            return [Act("POST", "/api/acknowledge" if status["arming_refusals"] else "/api/arm")]
        if status["mode"] == "armed" and status["goal"]["state"] != "running":
            goal = self._chance.choice(TEST_TARGETS)
            self.counts["goals"] += 1
            return [Act("POST", "/api/goal", {"kind": "reach", "y_m": goal.y_m, "z_m": goal.z_m})]
        return []

    def _look(self, status: dict[str, Any], now_s: float) -> None:
        """Count events since the last status."""
        was = self._was
        self.looks += 1
        self.armed += status["mode"] == "armed"
        if not was:
            return
        if status["goal"]["number"] == was["goal"]["number"] and was["goal"]["state"] == "running":
            self.counts["reached"] += status["goal"]["state"] == "reached"
        ended = was["mode"] in ("arming", "armed") and status["mode"] not in ("arming", "armed")
        again = status["last_stop"] != was["last_stop"]
        if not (ended or again) or now_s - self._asked_s < ASKED_S:
            return
        event = _event(status["last_stop"] or "")
        self.counts[f"stop: {event}"] += 1
        if not self._foreseen(event, now_s):
            log = status["recorder"]["log"]
            self.unexpected.append(Unexpected(now_s, f"stopped: {status['last_stop']}", log))

    def _foreseen(self, event: str, now_s: float) -> bool:
        broken = [names for until_s, names in self._broken if now_s <= until_s + AFTERMATH_S]
        return any(event.startswith(name) for names in broken for name in (*names, "arming_timeout"))

    def _break(self, now_s: float) -> list[Act]:
        if not self._is_due("fault", now_s):
            return []
        name = self._chance.choice(tuple(FAULTS))
        least_s, most_s, events = FAULTS[name]
        fault: dict[str, Any] = {"fault": name}
        if most_s:
            fault["seconds"] = round(self._chance.uniform(least_s, most_s), 3)
        if name == "mocap_drop_body":
            fault["body"] = self._chance.choice(("cart", "link1", "link5"))
        self.counts[f"fault: {name}"] += 1
        self._broken = [each for each in self._broken if each[0] + AFTERMATH_S >= now_s]
        self._broken.append((now_s + fault.get("seconds", 0.0), events))
        return [Act("fault", json.dumps(fault))]

    def _change(self, now_s: float) -> list[Act]:
        if not self._is_due("change", now_s):
            return []
        what = self._chance.choice(("stop", "disarm", "policy", "policy"))
        if what == "policy":
            self.counts["asked: policy"] += 1
            return [Act("PUT", "/api/policy", {"name": self._chance.choice(POLICIES)})]
        self.counts[f"asked: {what}"] += 1
        self._asked_s = now_s
        return [Act("POST", f"/api/{what}")]

    def _is_due(self, what: str, now_s: float) -> bool:
        due = now_s >= self._due_s[what]
        if due:
            self._due_s[what] = now_s + self._chance.expovariate(1 / self._every[what])
        return due


def _event(sentence: str) -> str:
    """Return the event of the failsafe table that a stop's message begins with, or the message itself."""
    fitting = [name for name, rule in TABLE.items() if sentence.startswith(rule.meaning)]
    return max(fitting, key=lambda name: len(TABLE[name].meaning), default=sentence)
