"""Faults that can be injected into a running twin."""

import inspect
import json
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from softarm.common.words import did_you_mean
from softarm.schemas.messages import BODY_NAMES

FOREVER_S = 1e9


class Faults:
    """Faults of the twin. Each method starts one, for `seconds` or until `clear`."""

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

    def clear(self) -> None:
        """End all faults at once."""
        self._until_ns.clear()
        self._pending.clear()

    def mocap_freeze(self, seconds: float = math.inf) -> None:
        """Motion capture sends no frames."""
        self._last("mocap_freeze", seconds)

    def mocap_stuck(self, seconds: float = math.inf) -> None:
        """Motion capture repeats its last poses with new stamps."""
        self._last("mocap_stuck", seconds)

    def mocap_drop_body(self, body: str, seconds: float = math.inf) -> None:
        """Motion capture loses one rigid body."""
        if body not in BODY_NAMES:
            raise ValueError(f"unknown body {body!r}; allowed: {', '.join(BODY_NAMES)}")
        self.lost_body = body
        self._last("mocap_drop_body", seconds)

    def mocap_garbage(self) -> None:
        """Motion capture sends one invalid sample."""
        self._pending.add("mocap_garbage")

    def serial_silence(self, seconds: float = math.inf) -> None:
        """The regulator neither receives nor answers; its watchdog continues."""
        self._last("serial_silence", seconds)

    def serial_garbage(self, seconds: float = math.inf) -> None:
        """Each answer of the regulator has a flipped bit."""
        self._last("serial_garbage", seconds)

    def serial_unplug(self, seconds: float = math.inf) -> None:
        """The regulator's port disappears and returns."""
        self._last("serial_unplug", seconds)

    def rail_silence(self, seconds: float = math.inf) -> None:
        """The drive neither receives nor answers telegrams; its watchdog continues."""
        self._last("rail_silence", seconds)

    def rail_keeps_going(self, seconds: float = math.inf) -> None:
        """The drive keeps its last set-point without a master."""
        self._last("rail_keeps_going", seconds)

    def rail_segment(self, seconds: float = math.inf) -> None:
        """Answers of the drive arrive byte by byte."""
        self._last("rail_segment", seconds)

    def rail_drop_connection(self) -> None:
        """The drive resets its TCP connection."""
        self._pending.add("rail_drop_connection")

    def rail_fault(self) -> None:
        """The drive reports E11, following error."""
        self._pending.add("rail_fault")

    def rail_unreferenced(self) -> None:
        """The drive loses its supply: the cart's position becomes its zero until it is homed."""
        self._pending.add("rail_unreferenced")

    def remote_low(self, seconds: float = math.inf) -> None:
        """The drive's enable input DI7 goes low: the hardware e-stop."""
        self._last("remote_low", seconds)

    @property
    def lasting(self) -> tuple[str, ...]:
        """Names of the lasting faults that are active."""
        return tuple(name for name in self._until_ns if self.active(name))

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
        if not isinstance(name, str) or name not in _NAMES:
            hint = did_you_mean(str(name), _NAMES)
            raise ValueError(f"unknown fault {name!r}; {hint}allowed: {', '.join(sorted(_NAMES))}")
        try:
            getattr(self, name)(**arguments)
        except TypeError as error:
            raise ValueError(f"{name}: {error}") from None
        return name

    def _last(self, name: str, seconds: float) -> None:
        if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not seconds > 0:
            raise ValueError(f"{name}: seconds is {seconds!r}; use a positive number")
        self._until_ns[name] = self._clock() + min(seconds, FOREVER_S) * 1e9


_NAMES = {name for name, part in vars(Faults).items() if name[0] != "_" and callable(part)} - {
    "active",
    "take",
    "apply",
}


class Described(NamedTuple):
    """Description of a fault, written as NAME or NAME=VALUE; `value` states the allowed values, empty without any."""

    name: str
    value: str
    meaning: str


def described() -> list[Described]:
    """Return the descriptions of all faults, sorted by name."""
    return [Described(name, _value(name), (getattr(Faults, name).__doc__ or "").strip()) for name in sorted(_NAMES)]


def _value(name: str) -> str:
    takes = inspect.signature(getattr(Faults, name)).parameters
    if "body" in takes:
        return f"BODY or BODY,SECONDS; a body is {', '.join(BODY_NAMES)}"
    return "SECONDS above 0 (default: until cleared)" if "seconds" in takes else ""


def message(text: str) -> bytes:
    """Return the message for `Faults.apply` for a typed fault.

    Args:
        text: For example `mocap_freeze`, `rail_silence=1.5` or `mocap_drop_body=link3,2`.

    Raises:
        ValueError: The text is invalid; with the allowed values.
    """
    name, equals, value = text.strip().partition("=")
    name = name.replace("-", "_")
    fields: dict[str, object] = {"fault": name}
    takes = inspect.signature(getattr(Faults, name)).parameters if name in _NAMES else {}
    body, comma, seconds = value.partition(",") if "body" in takes else ("", equals, value)
    if "body" in takes:
        fields["body"] = body
    if comma and takes:
        fields["seconds"] = _seconds(name, seconds, takes)
    encoded = json.dumps(fields).encode()
    Faults(lambda: 0).apply(encoded)
    return encoded


def _seconds(name: str, text: str, takes: Mapping[str, object]) -> float:
    if "seconds" not in takes:
        raise ValueError(f"{name}: takes no value; write {name} alone")
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name}: '{text}' is not a number; use seconds above 0, such as {name}=1.5") from None
