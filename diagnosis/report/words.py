"""Parts of sentences: effects, sets, changes, shares and intervals as people read them."""

import math

from softarm.diagnosis.engine.result import Diagnosis, HeldOut
from softarm.pages.numbers import listed, number, percent, scaled
from softarm.schemas.verdict import Interval, NamedEffect, Quantity
from softarm.simulator.effects import REGISTRY, Effect

UNSEEN: dict[HeldOut | None, str] = {
    "kind": "on kinds of excitation that no fit had seen",
    "trial": "on trials that no fit had seen",
    "block": "on stretches of the same trials that no fit had seen",
    None: "on data that no fit had seen",
}
_OPEN = 1e11  # from here on an end of an interval is no end: a limit that may as well not be there


def change(before: Quantity, after: Quantity, arrow: str = " → ") -> str:
    """Two root mean squares of one unit: `0.98 → 0.034 kPa`."""
    shown, factor = scaled(before.unit, max(before.value, after.value))
    return f"{number(before.value * factor, 2)}{arrow}{number(after.value * factor, 2)} {shown}".strip()


def interval(of: Interval, unit: str = "") -> str:
    """An estimate with its bounds: `61 ms (55 to 68)`; as many digits as the bounds' distance deserves."""
    if of.high >= _OPEN or of.low <= -_OPEN:
        return _open(of, unit)
    all_three = (of.value, of.low, of.high)
    finite = [abs(v) for v in all_three if math.isfinite(v)]
    shown, factor = scaled(unit, max(finite, default=0.0))
    half = (of.high - of.low) / 2 * factor
    if 1e-4 <= half < math.inf:
        decimals = max(0, -math.floor(math.log10(half / 3)))  # a half width of 3 to 29 units of the last digit
        value, low, high = (f"{v * factor:.{decimals}f}" for v in all_three)
    else:
        value, low, high = (number(v * factor) for v in all_three)
    return f"{value} {shown}".strip() + f" ({low} to {high})"


def _open(of: Interval, unit: str) -> str:
    """An interval with an end so far away that it says nothing."""
    shown, factor = scaled(unit, of.value if abs(of.value) < _OPEN else of.low)
    low, value, high = (number(v * factor) for v in (of.low, of.value, of.high))
    if of.value >= _OPEN:
        return f"{low} {shown}".strip() + " or more"
    tail = f"{low} or more" if of.low > -_OPEN else f"{high} or less" if of.high < _OPEN else "any"
    return f"{value} {shown}".strip() + f" ({tail})"


def percents(of: Interval) -> str:
    """An interval of a share: `74 % (70 to 78)`."""
    return f"{percent(of.value)} ({round(100 * of.low)} to {round(100 * of.high)})"


def known(diagnosis: Diagnosis, name: str) -> Effect | None:
    """An effect of the diagnosis's vocabulary, else of the registry."""
    return diagnosis.vocabulary.get(name) or REGISTRY.get(name)


def meaning(diagnosis: Diagnosis, name: str) -> str:
    """What an effect is; empty for one that nobody knows."""
    effect = known(diagnosis, name)
    return effect.meaning if effect else ""


def unit_of(diagnosis: Diagnosis, path: str) -> str:
    """Unit of `stage.effect.parameter`, of another rig by its own; empty where nobody knows it."""
    if path in diagnosis.units:
        return diagnosis.units[path]
    name, _, parameter = path.rpartition(".")
    effect = REGISTRY.get(name)
    return next((p.unit for p in effect.parameters if p.name == parameter), "") if effect else ""


def of_stage(diagnosis: Diagnosis, stage: str) -> list[NamedEffect]:
    """The named effects of a stage."""
    return [effect for effect in diagnosis.verdict.effects if effect.name.startswith(f"{stage}.")]


def stages_of(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Every stage with a gap or an effect; the whole chain last."""
    gaps = diagnosis.verdict.gap.before
    named = (effect.name.rpartition(".")[0] for effect in diagnosis.verdict.effects)
    found = dict.fromkeys((*(stage for stage in gaps if stage != "chain"), *named))
    return (*found, *(stage for stage in gaps if stage == "chain"))


def lacking(diagnosis: Diagnosis) -> str:
    """Who lacks an effect: another rig has no simulator but a nominal model."""
    return "model" if diagnosis.nominal is None else "simulator"


def one_of(effect: NamedEffect) -> str:
    """The set that an effect cannot be told from; its name where it stands alone."""
    names = (effect.name, *effect.equivalents)
    return f"one of {listed(names, 'or')} (this recording cannot tell which)" if effect.equivalents else effect.name


def sizes(effect: NamedEffect) -> str:
    """Its parameters with their intervals."""
    return ", ".join(f"{name} {interval(of, of.unit)}" for name, of in effect.parameters.items())


def times(before: Quantity, floor: Quantity | None) -> float | None:
    """How many floors a gap is; None where there is no floor."""
    return before.value / floor.value if floor is not None and floor.value > 0 else None


def reduction(before: Quantity | None, after: Quantity | None) -> float | None:
    """The share of a root mean square that went; None where one of the two is not known."""
    if before is None or after is None or before.value <= 0:
        return None
    return 1 - after.value / before.value


def less(diagnosis: Diagnosis, place: str) -> str:
    """How much of a stage's gap goes with all that is named: `74 % less, 95 % interval 70 to 78`; empty: not known."""
    gap, of = diagnosis.verdict.gap, shrink(diagnosis, place)
    share = reduction(gap.before.get(place), gap.after.get(place))
    if share is None or not diagnosis.verdict.effects:
        return ""
    share = share if of is None else of.value
    text = f"{percent(abs(share))} {'less' if share >= 0 else 'more'}"
    if of is None:
        return f"{text}, interval not known"
    low, high = (of.low, of.high) if share >= 0 else (-of.high, -of.low)
    digits = 0 if round(100 * low) < round(100 * high) else 1
    return f"{text}, 95 % interval {100 * low:.{digits}f} to {100 * high:.{digits}f}"


def shrink(diagnosis: Diagnosis, place: str) -> Interval | None:
    """The share of a stage's gap that goes with all named effects; held out."""
    if place in diagnosis.together:
        return diagnosis.together[place]
    effects = diagnosis.verdict.effects  # of one effect alone its own share is the share of all
    if len(effects) != 1:
        return None
    return effects[0].shrink.chain if place == "chain" else effects[0].shrink.stage
