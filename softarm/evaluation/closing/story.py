"""Sections that `softarm close-gap` adds to the report: the retraining, and the policy before and after."""

from collections.abc import Iterator

from softarm.evaluation.closing.advice import advise
from softarm.evaluation.closing.closed import Closed, Place
from softarm.evaluation.closing.outcomes import (
    HELD_OUT,
    MANNERS,
    NEW,
    OLD,
    PATCHED,
    REPLANNED,
    REST,
    TITLES,
    Flights,
    better,
)
from softarm.evaluation.closing.wires import Wires
from softarm.reporting import charts
from softarm.reporting.markup import Html, el, join, prose, shaded, table
from softarm.reporting.numbers import number, percent
from softarm.schemas.flights import CART_STARTS_M, TEST_TARGETS
from softarm.training.run.retrain import Retrained


def sections(closed: Closed) -> list[tuple[str, str]]:
    """Return sections of the report as (title, HTML)."""
    if closed.retrained is None:
        verdict = closed.diagnosis.verdict.verdict
        why = f"The verdict is {verdict}: no effect was named, so nothing was patched or retrained."
        texts = (el("p", prose(text)) for text in (why, *_widened(closed)))
        return [("The policy", join([*texts, _shares(closed)])), ("Rail limits", _limits(closed))]
    through = [] if closed.wires is None else [("Flights on wires", _through(closed.wires))]
    return [
        ("The policy before and after", _before_and_after(closed)),
        *through,
        ("Rail limits", _limits(closed)),
        ("Retraining", _training(closed.policy.stem, closed.retrained)),
    ]


def sentences(closed: Closed) -> list[str]:
    """Return the result for the terminal: the recommended policy, the reasons, flights on wires, and mppi."""
    moved = [] if closed.wires is None else sentences_of(closed.wires)
    return [*_recommendation(closed), *moved, *_replanning(closed), *_widened(closed)]


def _recommendation(closed: Closed) -> list[str]:
    """State the policy to fly and the success of both."""
    if closed.retrained is None:
        return ["No effect was named, so nothing was patched and the policy was not retrained."]
    advice = advise(closed)
    if advice.fly == "old":
        texts = [f"Keep the old policy: {'; '.join(advice.against)}."]
    else:
        texts = ["Fly the retrained policy."]
    for key in (PATCHED, HELD_OUT):
        place, old, new = closed.place(key), closed.both(OLD, key), closed.both(NEW, key)
        texts.append(
            f"On {place.title} the old policy reaches {percent(old.share)} of {old.reached.size} goals, from rest and "
            f"in mid-swing, and the retrained one {percent(new.share)}: {closed.won(key).text}, 95 % interval."
        )
    return texts + _stops(closed)


def lines(closed: Closed) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the table for the terminal: its head, and a row per robot and start condition."""
    names = closed.policies
    won = ("retrained - old, 95 %",) if NEW in names else ()
    head = ("robot", "start", *(TITLES[name] for name in names), *won, "unrequested stops")
    rows = []
    for place, manner, flown in _flown(closed):
        reached = ("-" if each is None else percent(each.share) for each in flown)
        more = (_won(closed, place.key, manner),) if won else ()
        rows.append((place.title, MANNERS[manner], *reached, *more, _stopped(flown, "-")))
    return head, rows


def _flown(closed: Closed) -> Iterator[tuple[Place, str, list[Flights | None]]]:
    """Yield each place and start condition with the flights of every policy; None: not flown."""
    for place in closed.places:
        for manner in MANNERS:
            yield place, manner, [closed.flown.get((name, place.key, manner)) for name in closed.policies]


def _stopped(flown: list[Flights | None], none: str) -> str:
    """Return the numbers of unrequested stops."""
    return ", ".join(none if each is None else str(int(each.stopped.sum())) for each in flown)


def _stops(closed: Closed) -> list[str]:
    """Count the unrequested stops, which are failures in the shares already."""
    texts = []
    for key in (PATCHED, HELD_OUT):
        counted = {name: closed.both(name, key) for name in closed.policies if (name, key, REST) in closed.flown}
        if not any(each.stopped.any() for each in counted.values()):
            continue
        numbers = ", ".join(f"{TITLES[name]} {int(each.stopped.sum())}" for name, each in counted.items())
        first = next(stop for each in counted.values() for stop in each.stops if stop is not None)
        texts.append(f"Unrequested stops on {closed.place(key).title}: {numbers} (the first: {first}).")
    return texts or ["No unrequested stop on these two robots."]


def _replanning(closed: Closed) -> list[str]:
    """Compare mppi, which needs no training, with the recommended policy."""
    if REPLANNED not in closed.policies:
        return []
    best = OLD if advise(closed).fly == "old" else NEW
    home, away = (closed.both(REPLANNED, key).share for key in (PATCHED, HELD_OUT))
    won = closed.won(HELD_OUT, REPLANNED, best)
    how = "significantly more than" if won.above else "significantly less than" if won.below else "about as much as"
    return [
        f"Without training: mppi, planning on patched-model.yaml, reaches {percent(home)} on the patched simulator, "
        f"which is its own model, and {percent(away)} on {closed.place(HELD_OUT).title}: {how} the "
        f"{TITLES[best].removesuffix(' policy')} policy ({won.text})."
    ]


def _widened(closed: Closed) -> list[str]:
    """State that fewer targets than the paper's were flown, and the effect on the intervals."""
    part, whole = len(closed.targets), len(TEST_TARGETS)
    if part >= whole:
        return []
    wider = number((whole / part) ** 0.5, 2)
    return [
        f"Only {part} of the paper's {whole} targets were flown, so the intervals are about {wider} times as wide. "
        "Repeat without --quick before you decide."
    ]


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


def _before_and_after(closed: Closed) -> Html:
    texts = (*_recommendation(closed), *_replanning(closed), *_widened(closed))
    parts = [*(el("p", prose(text)) for text in texts), _shares(closed)]
    for key in (HELD_OUT, PATCHED):
        parts.append(el("div", *(_map(closed, name, key) for name in closed.policies), class_="multiples maps"))
    targets = len(closed.targets)
    note = (
        f"{targets} targets of the paper from {closed.flights // targets} cart positions at rest, and as often in "
        "chains: the first goal of a chain starts with a swinging arm, each later one where the previous flight ended. "
        "The real control loop flies every goal; an unrequested stop is a failure. Differences are paired by goal, "
        "with a 95 % bootstrap interval over targets and chains. The disc in a ring = share of flights from rest "
        "that reach the target, a cross = none; targets above z = 0.70 m lie outside the training range. "
        f"The old policy is {closed.policy.stem}."
    )
    return join([*parts, el("p", note, class_="hint")])


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


def _shares(closed: Closed) -> Html:
    found = []
    for place, manner, flown in _flown(closed):
        row: list[Html | str] = [place.title, MANNERS[manner]]
        row += ["–" if each is None else shaded(each.share, percent(each.share)) for each in flown]
        if NEW in closed.policies:
            both = closed.changed(place.key, manner)
            row += [f"+{both['gained']} −{both['lost']}", _won(closed, place.key, manner)]
        found.append([*row, _stopped(flown, "–")])
    head = ["robot", "start", *(TITLES[name] for name in closed.policies)]
    if NEW in closed.policies:
        head += ["gained, lost", "retrained − old, 95 %"]
    head.append("unrequested stops")
    return table(head, found, "Targets reached; darker = more, – = not applicable", numbers=range(2, len(head)))


def _won(closed: Closed, place: str, manner: str) -> str:
    return better(closed.flown[OLD, place, manner], closed.flown[NEW, place, manner]).text


def _map(closed: Closed, policy: str, place: str) -> Html:
    """Draw the targets with the share of flights from rest that reach each."""
    reached = closed.flown[policy, place, REST].reached.reshape(len(closed.targets), len(CART_STARTS_M))
    y, z = [goal.y_m for goal in closed.targets], [goal.z_m for goal in closed.targets]
    title = f"{TITLES[policy]} from rest, {closed.place(place).title}"
    return charts.disc_map(y, z, reached.mean(axis=1).tolist(), title)


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
