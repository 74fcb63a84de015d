"""What `softarm close-gap` adds to the diagnosis' report: the retraining, and the policy before and after."""

from collections.abc import Sequence

import numpy as np

from softarm.flights.closing.closed import HELD_BACK, NEW, OLD, PATCHED, Closed
from softarm.flights.many import Reached, shares
from softarm.pages import charts
from softarm.pages.markup import Html, bar, el, join, prose, table
from softarm.pages.numbers import number, percent
from softarm.schemas.goals import Goal
from softarm.training.run.retrain import Retrained


def sections(closed: Closed) -> list[tuple[str, str]]:
    """Sections for the report, (title, HTML)."""
    if closed.retrained is None:
        verdict = closed.diagnosis.verdict.verdict
        why = f"The verdict is {verdict}: nothing was named, so nothing was patched or retrained."
        return [("The policy", join([el("p", why), _shares(closed)])), ("The rail's limits", _limits(closed))]
    return [
        ("The policy before and after", _before_and_after(closed)),
        ("The rail's limits", _limits(closed)),
        ("Retraining", _training(closed.policy.stem, closed.retrained)),
    ]


def sentence(closed: Closed) -> str:
    """What came of it, for the terminal and the top of the section."""
    if closed.retrained is None:
        return "Nothing was named, so nothing was patched and the policy was not retrained."
    last = next(place for key in (HELD_BACK, PATCHED) for place in closed.places if place.key == key)
    old, new = closed.flown[OLD, last.key], closed.flown[NEW, last.key]
    both = closed.changed(last.key)
    told = (
        f"On {last.title} the old policy reaches {percent(float(old.mean()))} of the targets and the retrained one "
        f"{percent(float(new.mean()))}: of {old.size} flights {both['gained']} gained, {both['lost']} lost."
    )
    if closed.retrained.better:
        return told
    return told + " In validation the retrained one is no better: keep the old one, or train on with more --seconds."


def _before_and_after(closed: Closed) -> Html:
    parts = [el("p", prose(sentence(closed))), _shares(closed)]
    for place in closed.places:
        if place.key in (HELD_BACK, PATCHED):
            pictures = [
                _map(closed.flown[name, place.key], closed.targets, f"{label} policy, {place.title}")
                for name, label in ((OLD, "old"), (NEW, "retrained"))
            ]
            parts.append(el("div", *pictures, class_="multiples maps"))
    targets = len(closed.targets)
    note = (
        f"The paper's {targets} targets from {closed.flights // targets} cart positions each, the "
        "daemon's own tick in every flight. A disc's ink is the share of its flights that reached; targets above "
        f"z = 0.70 m lie outside the training range. The old policy is {closed.policy.stem}."
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
    rows = []
    for place in closed.places:
        row: list[Html | str] = [place.title]
        for name in closed.policies:
            share = shares(closed.flown[name, place.key], closed.targets)
            row.append(bar(share.all, "nominal" if name == OLD else "patched", percent(share.all)))
            row.append("–" if np.isnan(share.in_range) else percent(share.in_range))
        if NEW in closed.policies:
            both = closed.changed(place.key)
            row.append(f"+{both['gained']} −{both['lost']}")
        rows.append(row)
    head = ["flown on", *(title for n in closed.policies for title in (f"{n} policy", f"{n}, z to 0.70 m"))]
    if NEW in closed.policies:
        head.append("flights gained, lost")
    return table(head, rows, "How often the policy reaches its target", numbers=(2, 4, 5))


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
        "echo 'policies: {retrained: {plugin: onnx, options: {model: retrained.onnx}}}' > retrained.yaml\n"
        "cat limits-patch.yaml >> retrained.yaml\n"
        "softarm evaluate --policy retrained --config retrained.yaml --model patched-model.yaml"
    )
    rows = [
        (f"{row.frames / 1e6:.2f} M", f"{row.seconds:.0f} s", percent(row.validation))
        for row in retrained.curve
        if row.validation is not None
    ]
    parts = [el("p", told), table(("frames", "time", "validation"), rows, "Validation while it learned", (1, 2))]
    return join([*parts, el("p", "Fly it yourself, from the folder of this report:"), el("pre", use)])
