"""Parts of the report's sentences: effects, sets, changes, shares and intervals."""

import math

from softarm.diagnosis.engine.result import Diagnosis, HeldOut
from softarm.reporting.numbers import listed, number, percent, quantity, scaled
from softarm.schemas.verdict import CalibratedParameter, Estimate, Interval, NamedEffect, Quantity
from softarm.simulator.effect_table import Parameter
from softarm.simulator.effects import REGISTRY, Effect

SHOWN_MIN = 0.005  # least shrink that printed sizes show
HELD_OUT: dict[HeldOut | None, str] = {
    "kind": "on held-out excitations",
    "trial": "on held-out trials",
    "block": "on held-out stretches of the same trials",
    None: "on held-out data",
}


def change(before: Quantity, after: Quantity, arrow: str = " → ") -> str:
    """Return two root mean squares in one unit, such as `0.98 → 0.034 kPa`."""
    shown, factor = scaled(before.unit, max(before.value, after.value))
    return f"{number(before.value * factor, 2)}{arrow}{number(after.value * factor, 2)} {shown}".strip()


def corrected(diagnosis: Diagnosis, place: str) -> str:
    """Return a stage's gap before and after the correction, or without named effects the gap alone."""
    gap = diagnosis.verdict.gap
    before = gap.before[place]
    return change(before, gap.after[place]) if diagnosis.verdict.effects else quantity(before.value, before.unit)


def interval(of: Interval, unit: str = "") -> str:
    """Return an estimate with its bounds, such as `61 ms (55 to 68)`, with as many digits as the interval deserves."""
    if math.isinf(of.high) or math.isinf(of.low):
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
    shown, factor = scaled(unit, of.value if math.isfinite(of.value) else of.low)
    low, value, high = (number(v * factor) if math.isfinite(v) else "" for v in (of.low, of.value, of.high))
    if math.isinf(of.value):
        return f"{low} {shown}".strip() + " or more"
    tail = f"{low} or more" if low else f"{high} or less" if high else "any"
    return f"{value} {shown}".strip() + f" ({tail})"


def tolerance(of: CalibratedParameter) -> str:
    """Return the ends of a parameter's tolerance, such as `2 to 8 ms, at the edge`."""
    shown, factor = scaled(of.unit, max(abs(of.tolerance_low), abs(of.tolerance_high)))
    ends = " to ".join(number(end * factor) for end in (of.tolerance_low, of.tolerance_high))
    return f"{ends} {shown}".strip() + (", at the edge" if of.at_edge else "")


def size(of: Estimate) -> str:
    """Return an estimate without its interval, such as `61 ms`, or `20 N or more` for one without an upper bound."""
    return _open(of, of.unit) if math.isinf(of.value) else quantity(of.value, of.unit)


def percents(of: Interval) -> str:
    """Return a share with its interval, such as `74 % (70 to 78)`."""
    return f"{percent(of.value)} ({round(100 * of.low)} to {round(100 * of.high)})"


def known(diagnosis: Diagnosis, name: str) -> Effect | None:
    """Return an effect of the diagnosis's vocabulary, else of the registry, or None."""
    return diagnosis.vocabulary.get(name) or REGISTRY.get(name)


def meaning(diagnosis: Diagnosis, name: str) -> str:
    """Return an effect's meaning in words, or an empty string for an unknown effect."""
    effect = known(diagnosis, name)
    return effect.meaning if effect else ""


def unit_of(diagnosis: Diagnosis, path: str) -> str:
    """Return the unit of `stage.effect.parameter`, or an empty string if it is unknown."""
    if path in diagnosis.units:
        return diagnosis.units[path]
    name, _, parameter = path.rpartition(".")
    effect = REGISTRY.get(name)
    return next((p.unit for p in effect.parameters if p.name == parameter), "") if effect else ""


def of_stage(diagnosis: Diagnosis, stage: str) -> list[NamedEffect]:
    """Return the named effects of a stage."""
    return [effect for effect in diagnosis.verdict.effects if effect.name.startswith(f"{stage}.")]


def stages_of(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return every stage with a gap or an effect, the whole chain last."""
    gaps = diagnosis.verdict.gap.before
    named = (effect.name.rpartition(".")[0] for effect in diagnosis.verdict.effects)
    found = dict.fromkeys((*(stage for stage in gaps if stage != "chain"), *named))
    return (*found, *(stage for stage in gaps if stage == "chain"))


def model_word(diagnosis: Diagnosis) -> str:
    """Return `simulator` for the robot and `model` for another rig, which has a nominal model only."""
    return "model" if diagnosis.nominal is None else "simulator"


def relation(diagnosis: Diagnosis, effect: NamedEffect) -> str:
    """Return how simulator and robot differ in an effect, such as `missing in the simulator`."""
    it = model_word(diagnosis)
    if diagnosis.nominal is None or diagnosis.patched is None or effect.name not in diagnosis.nominal.effects:
        return f"missing in the {it}"
    if effect.name not in diagnosis.patched.effects:
        return f"in the {it} but not on the robot"
    return f"wrong size in the {it}"


def stages_with(effect: NamedEffect) -> tuple[str, ...]:
    """Return the stages that share an effect, or its own stage."""
    return effect.shared_by or (effect.name.rpartition(".")[0],)


def name_of(effect: NamedEffect) -> str:
    """Return an effect's name, such as `pan.payload`, or `payload of pan and tilt` for one that stages share."""
    return _shared(effect, effect.name)


def alternatives(effect: NamedEffect) -> list[str]:
    """Return the names of the effects that no data separate from an effect, as `name_of` has them."""
    return [_shared(effect, other) for other in effect.equivalents]


def _shared(effect: NamedEffect, name: str) -> str:
    """Return the name of an effect or of its equivalent, with all stages that share it."""
    return f"{name.rpartition('.')[2]} of {listed(effect.shared_by)}" if effect.shared_by else name


def described(diagnosis: Diagnosis, effect: NamedEffect) -> str:
    """Return an effect with its meaning and the size of its parameters; equivalents are left out."""
    text, size = meaning(diagnosis, effect.name), sizes(effect)
    return f"{name_of(effect)}{f' ({text})' if text else ''}{f', {size}' if size else ''}"


def entries(diagnosis: Diagnosis, effect: NamedEffect) -> list[NamedEffect]:
    """Return the entries of all stages that share an effect, or the effect alone."""
    names = {f"{stage}.{effect.name.rpartition('.')[2]}" for stage in effect.shared_by} or {effect.name}
    return [each for each in diagnosis.verdict.effects if each.name in names]


def plain(diagnosis: Diagnosis, effect: NamedEffect) -> str:
    """Return a named effect in a technician's words with its size, such as `the regulator reacts 68 ms late`."""
    of = known(diagnosis, effect.name)
    if of is None:
        return sized(effect)
    if relation(diagnosis, effect).startswith("in the "):
        return f"the simulator has {of.name}, the robot has not"
    declared = {parameter.name: parameter for parameter in of.parameters}
    shown = {name: _plain_size(each, declared.get(name)) for name, each in effect.parameters.items()}
    try:
        text = of.plain.format(stage=listed(stages_with(effect)), **shown)
    except KeyError:  # a parameter stays neutral
        text = of.meaning
    return f"either {text}, or {listed(alternatives(effect), 'or')} looks the same" if effect.equivalents else text


def sentence(text: str) -> str:
    """Return a text that begins with a capital, except where it begins with an effect's name."""
    return text if "." in text.split()[0] else f"{text[0].upper()}{text[1:]}"


def _plain_size(of: Estimate, declared: Parameter | None) -> str:
    """Return a size with degrees for radians, percent for shares, and a sign where either one is possible.

    A positive time has none, though the search of a delay begins half a sample below zero.
    """
    if math.isinf(of.value):
        return size(of)
    value, unit = (math.degrees(of.value), "°") if of.unit == "rad" else (of.value, of.unit)
    text = f"{number(100 * value, 2)} %" if unit == "-" else quantity(value, unit)
    either = declared is not None and declared.low < declared.neutral < declared.high
    return f"+{text}" if either and value > 0 and unit != "s" else text


def shrinks(diagnosis: Diagnosis, place: str) -> str:
    """Return how a stage's gap changes, such as `shrinks from 1.2 to 0.3 kPa RMS (74 % less, ...)`."""
    gap = diagnosis.verdict.gap
    before, after, calibrated = gap.before[place], gap.after[place], gap.calibrated.get(place)
    if calibrated and (reduction(before, after) or 0.0) <= 0 and (reduction(before, calibrated) or 0.0) > SHOWN_MIN:
        return f"shrinks from {change(before, calibrated, ' to ')} RMS with the calibration (not without it)"
    verb = "shrinks" if (reduction(before, after) or 0.0) >= 0 else "grows"
    return f"{verb} from {change(before, after, ' to ')} RMS ({shrinks_by(diagnosis, place)})"


def one_of(effect: NamedEffect) -> str:
    """Return an effect's name, or its set of indistinguishable effects."""
    if not effect.equivalents:
        return effect.name
    return f"either {listed((name_of(effect), *alternatives(effect)), 'or')} (this data cannot separate them)"


def sizes(effect: NamedEffect) -> str:
    """Return an effect's parameters with their intervals."""
    return ", ".join(f"{name} {interval(of, of.unit)}" for name, of in effect.parameters.items())


def sized(effect: NamedEffect) -> str:
    """Return an effect's name and the size of its parameters, without intervals."""
    of = ", ".join(f"{name} {size(each)}" for name, each in effect.parameters.items())
    return f"{name_of(effect)} ({of})" if of else name_of(effect)


def reduction(before: Quantity | None, after: Quantity | None) -> float | None:
    """Return the share by which a root mean square shrank, or None if either value is unknown."""
    if before is None or after is None or before.value <= 0:
        return None
    return 1 - after.value / before.value


def calibration_in_words(diagnosis: Diagnosis) -> str:
    """Return how many of the model's own parameters are off within tolerance, and what their correction takes."""
    verdict = diagnosis.verdict
    count = len(verdict.calibration)
    if not count:
        return f"The data show no error in the {model_word(diagnosis)}'s own parameters."
    place = next((each for each in ("chain", verdict.where.stage) if each in verdict.gap.calibrated), None)
    place = place or max(verdict.gap.calibrated, key=lambda stage: verdict.gap.before[stage].value)
    before = verdict.gap.after[place] if verdict.effects else verdict.gap.before[place]
    whose = "the gap at the tip" if place == "chain" else f"the gap of the {place} stage"
    several = "parameters are" if count > 1 else "parameter is"
    return (
        f"Calibration: {count} {several} off within tolerance; corrected, {whose} goes from "
        f"{change(before, verdict.gap.calibrated[place], ' to ')} RMS, held out."
    )


def noise_level(floor: Quantity) -> str:
    """Return the clause that states a stage's noise floor."""
    return f"differences below {quantity(floor.value, floor.unit)} count as noise"


def shrinks_by(diagnosis: Diagnosis, place: str) -> str:
    """Return the shrink of a stage's gap, such as `74 % less, 95 % interval 70 to 78`, or an empty string."""
    gap, of = diagnosis.verdict.gap, diagnosis.total_shrink.get(place)
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
