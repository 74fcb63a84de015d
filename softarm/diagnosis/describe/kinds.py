"""Kind of mechanism that the quantities of its recordings suggest."""

from collections.abc import Callable, Sequence

from softarm.diagnosis.describe.survey import Signal
from softarm.schemas.stage_model import StageKind

_PUSHES = ("N", "N m", "A", "V")
_PLACES = ("m", "rad", "counts")


def guess(
    signals: Sequence[Signal],
    standard: Callable[[Signal], str],
    role: Callable[[Signal], str],
    is_led: Callable[[], bool],
) -> tuple[StageKind, str, bool]:
    """Return the likeliest kind of mechanism, the reason, and whether there is no doubt.

    Args:
        signals: columns that move, without time.
        standard: the standard unit of a signal, maybe empty.
        role: the role of a signal: command, measured or empty.
        is_led: returns whether one signal leads the others; called where it decides.
    """
    found = {s.label: standard(s) for s in signals}
    commands = [s for s in signals if role(s) == "command" and found[s.label] not in ("N", "N m", "A")]
    others = [s for s in signals if role(s) != "command"]
    for command in commands:
        for other in others:
            if found[command.label] == found[other.label] != "":
                return "tracking", f"{command.label} is commanded and {other.label} measured, in one quantity", True
    if (pressure := _first(others, found, "kPa")) and len(signals) > 1:
        return "tracking", f"{pressure.label} is a pressure", True
    angles = [s for s in others if found[s.label] == "rad"]
    torque, place = _first(signals, found, "N m"), _first(others, found, *_PLACES, *(f"{p}/s" for p in _PLACES))
    if torque and len(angles) > 1:
        return "chain", f"{torque.label} is a torque, and there are {len(angles)} angles", True
    if torque and angles:
        return "driven_mass", f"{torque.label} is a torque, and there is one angle", True
    if place and (push := _first(signals, found, "N", "A")) and not commands:
        return "driven_mass", f"{push.label} moves {place.label}", True
    if place and (push := _first(signals, found, *_PUSHES)):
        return "driven_mass", f"{push.label} moves {place.label}", False
    if angles and not commands and all(found[s.label] in ("rad", "rad/s") for s in signals):
        one = len(angles) == 1
        return "tracking" if not one and is_led() else "pendulum", "only angles move", one
    if len(commands) == 1 and len(others) == 1 and role(others[0]) == "measured":
        return "tracking", f"{commands[0].label} is commanded, {others[0].label} is measured", True
    return "tracking", "the headers do not show it", False


def _first(signals: Sequence[Signal], found: dict[str, str], *standards: str) -> Signal | None:
    return next((s for s in signals if found[s.label] in standards), None)
