"""Faults that can be injected into a running twin."""

import json
import math
from collections.abc import Callable

from softarm.common.words import did_you_mean
from softarm.schemas.messages import BODY_NAMES

FOREVER_S = 1e9
CLEAR, DROP_BODY = "clear", "mocap_drop_body"
# Each happens once.
EVENTS = {
    "mocap_garbage": "Motion capture sends one invalid sample.",
    "rail_drop_connection": "The drive resets its TCP connection.",
    "rail_fault": "The drive reports E11, following error.",
    "rail_unreferenced": "The drive loses its supply: the cart's position becomes its zero until it is homed.",
}
# Each lasts for a number of seconds, or until cleared.
LASTING = {
    "mocap_freeze": "Motion capture sends no frames.",
    "mocap_stuck": "Motion capture repeats its last poses with new stamps.",
    DROP_BODY: "Motion capture loses one rigid body.",
    "serial_silence": "The regulator neither receives nor answers; its watchdog continues.",
    "serial_garbage": "Each answer of the regulator has a flipped bit.",
    "serial_unplug": "The regulator's port disappears and returns.",
    "rail_silence": "The drive neither receives nor answers telegrams; its watchdog continues.",
    "rail_keeps_going": "The drive keeps its last set-point without a master.",
    "rail_segment": "Answers of the drive arrive byte by byte.",
    "remote_low": "The drive's enable input DI7 goes low: the hardware e-stop.",
}
MEANINGS = {CLEAR: "End all faults at once."} | EVENTS | LASTING


class Faults:
    """Faults of the twin; `lost_body` is the body of the newest `mocap_drop_body`."""

    def __init__(self, clock: Callable[[], int]) -> None:
        self.lost_body: str | None = None
        self._clock = clock
        self._until_ns: dict[str, float] = {}
        self._pending: set[str] = set()

    def active(self, name: str) -> bool:
        """Return whether a lasting fault is active."""
        return self._clock() < self._until_ns.get(name, -math.inf)

    def take(self, name: str) -> bool:
        """Return whether a single event is pending, and remove it."""
        due = name in self._pending
        self._pending.discard(name)
        return due

    @property
    def lasting(self) -> tuple[str, ...]:
        """Names of the lasting faults that are active."""
        return tuple(name for name in self._until_ns if self.active(name))

    def start(self, name: str, seconds: float = math.inf, body: str | None = None) -> None:
        """Start a fault, or end all of them with `CLEAR`.

        Args:
            name: A key of `MEANINGS`.
            seconds: Duration of a lasting fault; by default until cleared.
            body: The rigid body that `DROP_BODY` loses.

        Raises:
            ValueError: The duration or the body is invalid.
        """
        if name == CLEAR:
            self._until_ns.clear()
            self._pending.clear()
        elif name in EVENTS:
            self._pending.add(name)
        else:
            if name == DROP_BODY:
                if body not in BODY_NAMES:
                    raise ValueError(f"unknown body {body!r}; allowed: {', '.join(BODY_NAMES)}")
                self.lost_body = body
            if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not seconds > 0:
                raise ValueError(f"{name}: seconds is {seconds!r}; use a positive number")
            self._until_ns[name] = self._clock() + min(seconds, FOREVER_S) * 1e9

    def apply(self, message: bytes) -> str:
        """Start the fault in a JSON object, such as {"fault": "mocap_drop_body", "body": "link3", "seconds": 0.5}.

        Returns:
            The name of the fault.

        Raises:
            ValueError: The message is invalid; with the allowed values.
        """
        try:
            arguments = json.loads(message)
            name = arguments.pop("fault")
        except (ValueError, AttributeError, KeyError, TypeError, RecursionError):
            raise ValueError('a fault must be a JSON object such as {"fault": "mocap_freeze", "seconds": 1}') from None
        if not isinstance(name, str) or name not in MEANINGS:
            hint = did_you_mean(str(name), MEANINGS)
            raise ValueError(f"unknown fault {name!r}; {hint}allowed: {', '.join(sorted(MEANINGS))}")
        allowed = {"body", "seconds"} if name == DROP_BODY else {"seconds"} if name in LASTING else set()
        for argument in arguments.keys() - allowed:
            raise ValueError(f"{name}: unexpected keyword argument {argument!r}")
        self.start(name, **arguments)
        return str(name)


def described() -> list[tuple[str, str, str]]:
    """Return the name, the allowed values of NAME=VALUE (empty without any) and the meaning of all faults, by name."""
    return [(name, _value(name), MEANINGS[name]) for name in sorted(MEANINGS)]


def _value(name: str) -> str:
    if name == DROP_BODY:
        return f"BODY or BODY,SECONDS; a body is {', '.join(BODY_NAMES)}"
    return "SECONDS above 0 (default: until cleared)" if name in LASTING else ""


def message(text: str) -> bytes:
    """Return the message for `Faults.apply` for a typed fault, such as `rail_silence=1.5` or `mocap_drop_body=link3,2`.

    Raises:
        ValueError: The text is invalid; with the allowed values.
    """
    name, equals, value = text.strip().partition("=")
    name = name.replace("-", "_")
    fields: dict[str, object] = {"fault": name}
    if name == DROP_BODY:
        fields["body"], equals, value = value.partition(",")
    if equals and name in MEANINGS:
        fields["seconds"] = _seconds(name, value)
    encoded = json.dumps(fields).encode()
    Faults(lambda: 0).apply(encoded)
    return encoded


def _seconds(name: str, text: str) -> float:
    if name not in LASTING:
        raise ValueError(f"{name}: takes no value; write {name} alone")
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name}: '{text}' is not a number; use seconds above 0, such as {name}=1.5") from None
