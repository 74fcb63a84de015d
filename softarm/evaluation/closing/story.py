"""Results of `softarm close-gap` as text for the terminal and the report, and as the content of summary.json."""

from typing import Any

from softarm.evaluation.closing.closed import Closed, advise
from softarm.evaluation.closing.outcomes import MANNERS, NEW, OLD, REPLANNED, TITLES, WORTH, Flights
from softarm.evaluation.closing.wires import Wires
from softarm.reporting import charts
from softarm.reporting.markup import Html, el, join, prose, table
from softarm.reporting.numbers import number, percent
from softarm.simulator.model_file import differences
from softarm.training.run.retrain import Retrained

HEAD = ("way", "at rest", "in mid-swing", "flights", "gain, 95 %", "stops", "ready after, wall", "processor")


def sections(closed: Closed) -> list[tuple[str, str]]:
    """Return sections of the report as (title, HTML)."""
    through = [] if closed.wires is None else [("Flights on wires", _through(closed.wires))]
    training = [] if closed.retrained is None else [("Retraining", _training(closed.policy.stem, closed.retrained))]
    return [("The ways to fly", _ways(closed)), *through, ("Rail limits", _limits(closed)), *training]


def sentences(closed: Closed) -> list[str]:
    """Return the result for the terminal: the recommended policy, the reasons, and flights on wires."""
    advice = advise(closed)
    texts = ["Keep the old policy." if advice.fly == OLD else f"Fly the {_policy(advice.fly)}."]
    if closed.diagnosis.patched is None:
        texts.append("No effect was named, so nothing was patched and the policy was not retrained.")
    texts += [f"{TITLES[name].capitalize()}: {'; '.join(why)}." for name, why in advice.against.items() if why]
    return texts + ([] if closed.wires is None else sentences_of(closed.wires))


def sentence(closed: Closed, name: str) -> str:
    """Return the result of one way."""
    new = closed.flown[name, closed.judged.key]
    wall_s, cpu_s = closed.seconds(name)
    old = closed.flown[OLD, closed.judged.key].chosen(slice(new.reached.size))
    return (
        f"{TITLES[name].capitalize()}: {percent(new.share)} of {new.reached.size} flights on {closed.judged.title}, "
        f"old policy {percent(old.share)}, gain {closed.won(name).text}, after {wall_s:.0f} s ({cpu_s:.0f} s of CPU)."
    )


def lines(closed: Closed) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the table: its head, and a row per way."""
    return HEAD, [_row(closed, name) for name in (OLD, *closed.ways)]


def _row(closed: Closed, name: str) -> tuple[str, ...]:
    flown = closed.flown[name, closed.judged.key]
    reached = (_share(closed.of(name, manner)) for manner in MANNERS)
    gain = "" if name == OLD else closed.won(name).text
    seconds = ("0 s", "0 s") if name == OLD else (f"{each:.0f} s" for each in closed.seconds(name))
    return (TITLES[name], *reached, str(flown.reached.size), gain, str(int(flown.stopped.sum())), *seconds)


def _share(flown: Flights) -> str:
    """Return a share with its always-valid interval."""
    low, high = flown.interval
    return f"{percent(flown.share)} ({100 * low:.0f} to {100 * high:.0f})" if flown.reached.size else "-"


def _policy(name: str) -> str:
    return {REPLANNED: "policy mppi on patched-model.yaml", NEW: "retrained policy"}.get(name, TITLES[name])


def sentences_of(wires: Wires) -> list[str]:
    """State the success on wires and why flights ended early."""
    if wires.log is None and not wires.flights:
        return [f"No flight on the wires of {wires.title}: {wires.ended}."]
    texts = []
    if (won := wires.won) is not None:
        old, new = wires.both(OLD), wires.both(NEW)
        stops = ", ".join(f"{TITLES[name]} {int(wires.both(name).stopped.sum())}" for name in (OLD, NEW))
        texts.append(
            f"On the wires of {wires.title}: the old policy reaches {percent(old.share)} of {wires.flights} "
            f"goals, the retrained one {percent(new.share)} of the same ({won.text}); unrequested stops: {stops}."
        )
    if wires.ended is not None:
        texts.append(f"On the wires of {wires.title}: the flights ended early: {wires.ended}.")
    return texts


def _through(wires: Wires) -> Html:
    if not wires.flights:
        return join(el("p", prose(text)) for text in sentences_of(wires))
    flown = []
    for manner, title in MANNERS.items():
        old, new = wires.flown[OLD, manner], wires.flown[NEW, manner]
        if old.reached.size:
            stops = (str(int(each.stopped.sum())) for each in (old, new))
            flown.append((title, str(old.reached.size), percent(old.share), percent(new.share), *stops))
    head = ("start", "goals each", "old policy", "retrained", "stops: old", "stops: retrained")
    log = "" if wires.log is None else f" {wires.log} holds every tick."
    note = (
        "Flown in real time by the daemon with the drivers of the configuration and the limits below, old and "
        f"retrained policy in turns. In mid-swing: goals follow each other without rest.{log}"
    )
    texts = [el("p", prose(text)) for text in sentences_of(wires)]
    return join([*texts, table(head, flown, "Success on wires", (1, 2, 3, 4, 5)), el("p", note, class_="hint")])


def _ways(closed: Closed) -> Html:
    head, rows = lines(closed)
    known = [(place, closed.flown.get((OLD, place.key))) for place in closed.places]
    robots = [(place.title, _share(each), str(each.reached.size)) for place, each in known if each is not None]
    note = (
        f"On {closed.judged.title}. Each flight is a draw: one of the paper's 54 targets, from rest or in mid-swing, "
        "the same for every policy. The real control loop flies; an unrequested stop is a failure. Flights end when a "
        f"policy is better, stops more often, or gains less than {percent(WORTH)}. The 95 % intervals are always "
        "valid: looking at them after each flight does not raise the error rate. "
        f"The old policy is {closed.policy.stem}."
    )
    maps = el("div", *(_map(closed, name) for name in (OLD, *closed.ways)), class_="multiples maps")
    texts = (el("p", prose(text)) for text in sentences(closed))
    old = table(("robot", "old policy", "flights"), robots, "Success of the old policy", (1, 2))
    return join(
        [*texts, table(head, rows, "The ways to fly", range(1, len(head))), el("p", note, class_="hint"), old, maps]
    )


def _limits(closed: Closed) -> Html:
    rows = []
    for row in closed.rail.rows:
        flown = getattr(closed.rail.patched.limits.rail, row.key)
        rows.append((row.key, f"{row.configured:.3g}", row.measured, f"{flown:.3g}", row.why))
    note = (
        "Rail limits that the campaign shows, and the limits of training and flights. Where the configuration was less "
        "strict than the robot, it is patched (limits-patch.yaml)."
    )
    head = ("limits.rail", "configured", "measured", "flown with", "recordings")
    return join([el("p", note), table(head, rows, "Rail limits")])


def _map(closed: Closed, policy: str) -> Html:
    """Draw the targets with the share of flights that reach each."""
    found: dict[tuple[float, float], list[bool]] = {}
    reached = closed.flown[policy, closed.judged.key].reached.tolist()
    for goal, hit in zip(closed.goals(policy), reached, strict=True):
        found.setdefault((goal.y_m, goal.z_m), []).append(hit)
    y, z = ([place[axis] for place in found] for axis in (0, 1))
    return charts.disc_map(y, z, [sum(hits) / len(hits) for hits in found.values()], TITLES[policy])


def _training(policy: str, retrained: Retrained) -> Html:
    text = (
        f"Training continued with the weights of {policy} and a critic fitted to them, in the patched simulator, for "
        f"{number(retrained.frames / 1e6, 2)} million control steps in {number(retrained.seconds, 2)} s. Success in "
        f"the validation set (random targets, none of the test's): {percent(retrained.before)} before, "
        f"{percent(retrained.after)} after."
    )
    use = (
        "echo 'policies: {retrained: {plugin: onnx, options: {model: retrained.onnx}}, "
        "replanned: {plugin: mppi, options: {model: patched-model.yaml}}}' > closed.yaml\n"
        "cat limits-patch.yaml >> closed.yaml\n"
        "softarm evaluate retrained --config closed.yaml --model patched-model.yaml\n"
        "softarm evaluate replanned --config closed.yaml --model patched-model.yaml"
    )
    rows = [
        (f"{row.frames / 1e6:.2f} M", f"{row.seconds:.0f} s", percent(row.validation))
        for row in retrained.curve
        if row.validation is not None
    ]
    parts = [el("p", text), table(("frames", "time", "validation"), rows, "Validation during retraining", (1, 2))]
    return join([*parts, el("p", "To fly the policies, run this in the folder of the report:"), el("pre", use)])


def summary(closed: Closed) -> dict[str, Any]:
    """Return the results as plain values."""
    diagnosis, advice = closed.diagnosis, advise(closed)
    patch = differences(diagnosis.nominal, diagnosis.patched) if diagnosis.nominal and diagnosis.patched else []
    return {
        "verdict": diagnosis.verdict.verdict,
        "effects": [effect.name for effect in diagnosis.verdict.effects],
        "patch": [row._asdict() for row in patch],
        "limits": closed.rail.summary(),
        "policy": str(closed.policy),
        "judged_on": closed.judged.title,
        "old": {place: _flights(flown) for (name, place), flown in closed.flown.items() if name == OLD},
        "ways": {name: _way(closed, name) for name in (OLD, *closed.ways)},
        "fly": advice.fly,
        "against": {name: list(reasons) for name, reasons in advice.against.items()},
        "wires": None if closed.wires is None else _wires(closed.wires),
        "retrained": None if closed.retrained is None else _retrained(closed.retrained),
        "spent": closed.spent,
    }


def _way(closed: Closed, name: str) -> dict[str, Any]:
    """Return a policy's success on the judging robot, and its difference to the old one over the same draws."""
    wall_s, cpu_s = closed.seconds(name)
    own = {
        **{manner: _flights(closed.of(name, manner)) for manner in MANNERS},
        "wall_s": round(wall_s, 1),
        "cpu_s": round(cpu_s, 1),
    }
    if name == OLD:
        return own
    return own | {"difference": closed.won(name)._asdict(), "stops_difference": closed.stops_more(name)._asdict()}


def _flights(flown: Flights) -> dict[str, Any]:
    stops = [stop for stop in flown.stops if stop is not None]
    low, high = flown.interval
    return {
        "flights": int(flown.reached.size),
        "reached": int(flown.reached.sum()),
        "low": round(low, 3),
        "high": round(high, 3),
        "stops": {why: stops.count(why) for why in dict.fromkeys(stops)},
    }


def _wires(wires: Wires) -> dict[str, Any]:
    return {
        "flown_on": wires.title,
        "is_the_robot": wires.is_the_robot,
        **{name: {manner: _flights(wires.flown[name, manner]) for manner in MANNERS} for name in (OLD, NEW)},
        "difference": None if wires.won is None else wires.won._asdict(),
        "ended": wires.ended,
        "log": wires.log,
    }


def _retrained(retrained: Retrained) -> dict[str, Any]:
    return {
        "policy": retrained.policy.name,
        "frames": retrained.frames,
        "seconds": round(retrained.seconds, 1),
        "validation_before": retrained.before,
        "validation_after": retrained.after,
        "better": retrained.better,
    }
