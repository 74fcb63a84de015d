"""What can be made to go wrong with the twin while it runs."""

import inspect
import json
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from softarm.common.words import did_you_mean
from softarm.schemas.messages import BODY_NAMES

FOREVER_S = 1e9


class Faults:
    """Each method starts one fault, for `seconds` or until `clear`. The parts of the twin ask `active`."""

    def __init__(self, clock: Callable[[], int]) -> None:
        self.lost_body: str | None = None
        self._clock = clock
        self._until_ns: dict[str, float] = {}
        self._pending: set[str] = set()

    def active(self, name: str) -> bool:
        """Whether a lasting fault is on."""
        return self._clock() < self._until_ns.get(name, -math.inf)

    def take(self, name: str) -> bool:
        """Whether a single event is due; asking uses it up."""
        due = name in self._pending
        self._pending.discard(name)
        return due

    def clear(self) -> None:
        """End all of them."""
        self._until_ns.clear()
        self._pending.clear()

    def mocap_freeze(self, seconds: float = math.inf) -> None:
        """No frames come."""
        self._last("mocap_freeze", seconds)

    def mocap_stuck(self, seconds: float = math.inf) -> None:
        """Frames come with running stamps and the poses of the moment when this began."""
        self._last("mocap_stuck", seconds)

    def mocap_drop_body(self, body: str, seconds: float = math.inf) -> None:
        """One rigid body is not tracked."""
        if body not in BODY_NAMES:
            raise ValueError(f"there is no body {body!r}; choose one of {', '.join(BODY_NAMES)}")
        self.lost_body = body
        self._last("mocap_drop_body", seconds)

    def mocap_garbage(self) -> None:
        """One sample is no frame."""
        self._pending.add("mocap_garbage")

    def serial_silence(self, seconds: float = math.inf) -> None:
        """The device neither hears nor answers; its watchdog runs on."""
        self._last("serial_silence", seconds)

    def serial_garbage(self, seconds: float = math.inf) -> None:
        """Each answer has a flipped bit."""
        self._last("serial_garbage", seconds)

    def serial_unplug(self, seconds: float = math.inf) -> None:
        """The port vanishes and comes back."""
        self._last("serial_unplug", seconds)

    def rail_silence(self, seconds: float = math.inf) -> None:
        """The drive neither hears nor answers telegrams; its watchdog runs on."""
        self._last("rail_silence", seconds)

    def rail_keeps_going(self, seconds: float = math.inf) -> None:
        """The drive obeys its last set-point also when its master is silent or gone."""
        self._last("rail_keeps_going", seconds)

    def rail_segment(self, seconds: float = math.inf) -> None:
        """Answers arrive byte by byte."""
        self._last("rail_segment", seconds)

    def rail_drop_connection(self) -> None:
        """The drive resets its TCP connection."""
        self._pending.add("rail_drop_connection")

    def rail_fault(self) -> None:
        """The drive reports E11, following error."""
        self._pending.add("rail_fault")

    def rail_unreferenced(self) -> None:
        """The drive is switched off and on: its zero is where the cart stands, until it is homed."""
        self._pending.add("rail_unreferenced")

    def remote_low(self, seconds: float = math.inf) -> None:
        """The drive's enable input DI7 goes low: the hardware e-stop."""
        self._last("remote_low", seconds)

    @property
    def lasting(self) -> tuple[str, ...]:
        """Those that are on now."""
        return tuple(name for name in self._until_ns if self.active(name))

    def apply(self, message: bytes) -> str:
        """Start what a JSON object asks for: {"fault": "mocap_drop_body", "body": "link3", "seconds": 0.5}.

        Returns its name. Raises ValueError with what is allowed.
        """
        try:
            arguments = json.loads(message)
            name = arguments.pop("fault")
        except (ValueError, AttributeError, KeyError, TypeError, RecursionError):
            raise ValueError('a fault is a JSON object like {"fault": "mocap_freeze", "seconds": 1}') from None
        if not isinstance(name, str) or name not in _NAMES:
            hint = did_you_mean(str(name), _NAMES)
            raise ValueError(f"there is no fault {name!r}; {hint}choose one of {', '.join(sorted(_NAMES))}")
        try:
            getattr(self, name)(**arguments)
        except TypeError as error:
            raise ValueError(f"{name}: {error}") from None
        return name

    def _last(self, name: str, seconds: float) -> None:
        if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not seconds > 0:
            raise ValueError(f"{name}: seconds is {seconds!r}; give a positive number")
        self._until_ns[name] = self._clock() + min(seconds, FOREVER_S) * 1e9


_NAMES = {name for name, part in vars(Faults).items() if name[0] != "_" and callable(part)} - {
    "active",
    "take",
    "apply",
}


class Described(NamedTuple):
    """A fault as people name it: NAME or NAME=VALUE."""

    name: str
    value: str  # what VALUE may be; empty: it takes none
    meaning: str


def described() -> list[Described]:
    """All of them, by name."""
    return [Described(name, _value(name), (getattr(Faults, name).__doc__ or "").strip()) for name in sorted(_NAMES)]


def _value(name: str) -> str:
    takes = inspect.signature(getattr(Faults, name)).parameters
    if "body" in takes:
        return f"BODY or BODY,SECONDS; a body is {', '.join(BODY_NAMES)}"
    return "SECONDS above 0; without, until cleared" if "seconds" in takes else ""


def message(text: str) -> bytes:
    """What `Faults.apply` takes, of what a person typed: `mocap_freeze`, `rail_silence=1.5`, `mocap_drop_body=link3,2`.

    Raises ValueError with what is allowed.
    """
    name, equals, value = text.strip().partition("=")
    name = name.replace("-", "_")
    asked: dict[str, object] = {"fault": name}
    takes = inspect.signature(getattr(Faults, name)).parameters if name in _NAMES else {}
    body, comma, seconds = value.partition(",") if "body" in takes else ("", equals, value)
    if "body" in takes:
        asked["body"] = body
    if comma and takes:
        asked["seconds"] = _seconds(name, seconds, takes)
    Faults(lambda: 0).apply(said := json.dumps(asked).encode())  # says what is wrong here and now
    return said


def _seconds(name: str, text: str, takes: Mapping[str, object]) -> float:
    if "seconds" not in takes:
        raise ValueError(f"{name}: happens once and takes no value; write {name} alone")
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name}: '{text}' is no number; give seconds above 0, such as {name}=1.5") from None
