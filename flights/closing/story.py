"""What `softarm close-gap` adds to the diagnosis' report: the retraining, and the policy before and after."""

from collections.abc import Sequence

from softarm.flights.closing.closed import Closed
from softarm.flights.closing.outcomes import (
    HELD_BACK,
    MANNERS,
    NEW,
    OLD,
    PATCHED,
    REPLANNED,
    REST,
    TITLES,
    better,
)
from softarm.flights.closing.wires import Wires
from softarm.flights.many import Reached
from softarm.pages import charts
from softarm.pages.markup import Html, el, join, prose, shaded, table
from softarm.pages.numbers import number, percent
from softarm.schemas.flights import CART_STARTS_M
from softarm.schemas.goals import Goal
from softarm.training.run.retrain import Retrained


def sections(closed: Closed) -> list[tuple[str, str]]:
    """Sections for the report, (title, HTML)."""
    if closed.retrained is None:
        verdict = closed.diagnosis.verdict.verdict
        why = f"The verdict is {verdict}: nothing was named, so nothing was patched or retrained."
        return [("The policy", join([el("p", why), _shares(closed)])), ("The rail's limits", _limits(closed))]
    through = [] if closed.wires is None else [("Through the wires", _through(closed.wires))]
    return [
        ("The policy before and after", _before_and_after(closed)),
        *through,
        ("The rail's limits", _limits(closed)),
        ("Retraining", _training(closed.policy.stem, closed.retrained)),
    ]


def sentences(closed: Closed) -> list[str]:
    """What came of it, for the terminal: what to fly, why, what moved, and what needs no training."""
    moved = [] if closed.wires is None else sentences_of(closed.wires)
    return [*_judged(closed), *moved, *_replanning(closed)]


def _judged(closed: Closed) -> list[str]:
    """What to fly, and what old and retrained have reached."""
    if closed.retrained is None:
        return ["Nothing was named, so nothing was patched and the policy was not retrained."]
    advice, told = closed.advice, []
    if advice.fly == "old":
        told.append(f"Keep the old one: {'; '.join(advice.against)}.")
    else:
        told.append("Fly the retrained one.")
    for key in (PATCHED, HELD_BACK):
        place, old, new = closed.place(key), closed.both(OLD, key), closed.both(NEW, key)
        told.append(
            f"On {place.title} the old policy reaches {percent(old.share)} of {old.reached.size} goals, from rest and "
            f"in mid-swing, and the retrained one {percent(new.share)}: {closed.won(key).text}, 95 % sure."
        )
    return told + _stops(closed)


def lines(closed: Closed) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """The table on the terminal: its head, and a row a robot and manner."""
    names = closed.policies
    won = ("retrained - old, 95 %",) if NEW in names else ()
    head = ("flown on", "from", *(TITLES[name] for name in names), *won, "stops unasked")
    rows = []
    for place in closed.places:
        for manner, title in MANNERS.items():
            flown = [closed.flown.get((name, place.key, manner)) for name in names]
            reached = ("-" if each is None else percent(each.share) for each in flown)
            more = (_won(closed, place.key, manner),) if won else ()
            stops = ", ".join("-" if each is None else str(int(each.stopped.sum())) for each in flown)
            rows.append((place.title, title, *reached, *more, stops))
    return head, rows


def _stops(closed: Closed) -> list[str]:
    """Said apart: they are failures in the shares already."""
    told = []
    for key in (PATCHED, HELD_BACK):
        counted = {name: closed.both(name, key) for name in closed.policies if (name, key, REST) in closed.flown}
        if not any(each.stopped.any() for each in counted.values()):
            continue
        numbers = ", ".join(f"{TITLES[name]} {int(each.stopped.sum())}" for name, each in counted.items())
        first = next(stop for each in counted.values() for stop in each.stops if stop is not None)
        told.append(f"Stops that nobody asked for, on {closed.place(key).title}: {numbers} (the first: {first}).")
    return told or ["No arm stopped unasked on these two."]


def _replanning(closed: Closed) -> list[str]:
    """The answer that needs no training, beside what is advised."""
    if REPLANNED not in closed.policies:
        return []
    best = OLD if closed.advice.fly == "old" else NEW
    home, away = (closed.both(REPLANNED, key).share for key in (PATCHED, HELD_BACK))
    won = closed.won(HELD_BACK, REPLANNED, best)
    how = "clearly more often than" if won.above else "clearly less often than" if won.below else "about as often as"
    return [
        f"Without any training: mppi, planning on patched-model.yaml, reaches {percent(home)} on the patched "
        f"simulator, which is the model it plans on, and {percent(away)} on {closed.place(HELD_BACK).title}, "
        f"where it reaches {how} the {TITLES[best].removesuffix(' policy')} one ({won.text})."
    ]


def sentences_of(wires: Wires) -> list[str]:
    """What moved, and what came of it."""
    if wires.log is None and not wires.flights:
        return [f"Nothing moved through the wires of {wires.title}: {wires.ended}."]
    told = []
    if (won := wires.won) is not None:
        old, new = wires.both(OLD), wires.both(NEW)
        stops = ", ".join(f"{TITLES[name]} {int(wires.both(name).stopped.sum())}" for name in (OLD, NEW))
        told.append(
            f"Through the wires, on {wires.title}: the old policy reaches {percent(old.share)} of {wires.flights} "
            f"goals, the retrained one {percent(new.share)} of the same ({won.text}); stops unasked: {stops}."
        )
    if wires.ended is not None:
        told.append(f"Through the wires, on {wires.title}: ended before all was flown, {wires.ended}.")
    return told


def _through(wires: Wires) -> Html:
    if not wires.flights:
        return join(el("p", prose(text)) for text in sentences_of(wires))
    flown = []
    for manner, title in MANNERS.items():
        old, new = wires.flown[OLD, manner], wires.flown[NEW, manner]
        if old.reached.size:
            stops = (str(int(each.stopped.sum())) for each in (old, new))
            flown.append((title, str(old.reached.size), percent(old.share), percent(new.share), *stops))
    head = ("from", "goals of each", "old policy", "retrained", "its stops: old", "retrained")
    log = "" if wires.log is None else f" Every tick stands in {wires.log}."
    note = (
        "The daemon as a service would run it, in real time, by the configuration's drivers and with the limits below; "
        f"old and retrained in turns. In mid-swing: the goals follow each other without a rest.{log}"
    )
    said = [el("p", prose(text)) for text in sentences_of(wires)]
    return join([*said, table(head, flown, "Reached through the wires", (1, 2, 3, 4, 5)), el("p", note, class_="hint")])


def _before_and_after(closed: Closed) -> Html:
    parts = [el("p", prose(text)) for text in (*_judged(closed), *_replanning(closed))] + [_shares(closed)]
    for key in (HELD_BACK, PATCHED):
        pictures = [
            _map(_by_target(closed, name, key), closed.targets, f"{TITLES[name]} from rest, {closed.place(key).title}")
            for name in closed.policies
        ]
        parts.append(el("div", *pictures, class_="multiples maps"))
    targets = len(closed.targets)
    note = (
        f"The paper's {targets} targets from {closed.flights // targets} cart positions at rest, and as often in "
        "chains: the first goal of a chain finds a swung arm, each other one the arm as the goal before left it. The "
        "daemon's own tick in every flight; a stop that nobody asked for is a failure. Differences are of the same "
        "goals, with the interval of 95 % over targets and chains drawn anew. A disc's ink is the share of its flights "
        f"from rest that reached; targets above z = 0.70 m lie outside the training range. The old "
        f"policy is {closed.policy.stem}."
    )
    return join([*parts, el("p", note, class_="hint")])


def _limits(closed: Closed) -> Html:
    rows = []
    for row in closed.rail.rows:
        flown = getattr(closed.rail.patched.limits.rail, row.key)
        rows.append((row.key, f"{row.configured:.3g}", row.measured, f"{flown:.3g}", row.why))
    note = (
        "What the campaign shows of the rail, and what the policies were trained and flown by: where the configuration "
        "was milder than the robot, it is patched (limits-patch.yaml)."
    )
    head = ("limits.rail", "configured", "measured", "flown with", "what the recordings show")
    return join([el("p", note), table(head, rows, "The rail's limits")])


def _shares(closed: Closed) -> Html:
    found = []
    for place in closed.places:
        for manner, title in MANNERS.items():
            row: list[Html | str] = [place.title, title]
            for name in closed.policies:
                flown = closed.flown.get((name, place.key, manner))
                row.append("–" if flown is None else shaded(flown.share, percent(flown.share)))
            if NEW in closed.policies:
                both = closed.changed(place.key, manner)
                row += [f"+{both['gained']} −{both['lost']}", _won(closed, place.key, manner)]
            stops = (closed.flown.get((name, place.key, manner)) for name in closed.policies)
            row.append(", ".join("–" if each is None else str(int(each.stopped.sum())) for each in stops))
            found.append(row)
    head = ["flown on", "from", *(TITLES[name] for name in closed.policies)]
    if NEW in closed.policies:
        head += ["gained, lost", "retrained − old, 95 %"]
    head.append("stops unasked")
    return table(head, found, "How often the policy reaches its target", numbers=range(2, len(head)))


def _won(closed: Closed, place: str, manner: str) -> str:
    return better(closed.flown[OLD, place, manner], closed.flown[NEW, place, manner]).text


def _by_target(closed: Closed, policy: str, place: str) -> Reached:
    """[targets, starts], from rest."""
    return closed.flown[policy, place, REST].reached.reshape(len(closed.targets), len(CART_STARTS_M))


def _map(reached: Reached, targets: Sequence[Goal], title: str) -> Html:
    """Targets where they are, inked by how many of their flights reached."""
    y, z = [goal.y_m for goal in targets], [goal.z_m for goal in targets]
    return charts.disc_map(y, z, reached.mean(axis=1).tolist(), title)


def _training(policy: str, retrained: Retrained) -> Html:
    told = (
        f"The weights of {policy} were read back from its file, the critic was fitted to them, and the policy learned "
        f"on in the patched simulator for {number(retrained.frames / 1e6, 2)} million control steps, "
        f"{number(retrained.seconds, 2)} s. Of the validation set (random targets, none of the test's) it reached "
        f"{percent(retrained.before)} before and {percent(retrained.after)} after."
    )
    use = (
        "echo 'policies: {retrained: {plugin: onnx, options: {model: retrained.onnx}}, "
        "replanned: {plugin: mppi, options: {model: patched-model.yaml}}}' > closed.yaml\n"
        "cat limits-patch.yaml >> closed.yaml\n"
        "softarm evaluate --policy retrained --config closed.yaml --model patched-model.yaml\n"
        "softarm evaluate --policy replanned --config closed.yaml --model patched-model.yaml"
    )
    rows = [
        (f"{row.frames / 1e6:.2f} M", f"{row.seconds:.0f} s", percent(row.validation))
        for row in retrained.curve
        if row.validation is not None
    ]
    parts = [el("p", told), table(("frames", "time", "validation"), rows, "Validation while it learned", (1, 2))]
    return join([*parts, el("p", "Fly it yourself, from the folder of this report:"), el("pre", use)])
