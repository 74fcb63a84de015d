"""What `softarm close-gap` adds to the diagnosis' report: the retraining, and the policy before and after."""

from collections.abc import Mapping, Sequence

from softarm.diagnosis.gap.result import Diagnosis
from softarm.flights.closing.summary import HELD_BACK, NEW, OLD, PATCHED, changed
from softarm.flights.many import Place, Reached, shares
from softarm.pages import charts
from softarm.pages.markup import Html, bar, el, join, prose, table
from softarm.pages.numbers import number, percent
from softarm.schemas.goals import TEST_TARGETS, Goal
from softarm.training.run.retrain import Retrained

Flown = Mapping[tuple[str, str], Reached]


def story(
    diagnosis: Diagnosis,
    policy: str,
    places: Sequence[Place],
    flown: Flown,
    retrained: Retrained | None,
    targets: Sequence[Goal] = TEST_TARGETS,
) -> list[tuple[str, str]]:
    """Sections for the report, (title, HTML)."""
    if retrained is None:
        why = f"The verdict is {diagnosis.verdict.verdict}: nothing was named, so nothing was patched or retrained."
        return [("The policy", join([el("p", why), _shares(places, flown, targets)]))]
    return [
        ("The policy before and after", _before_and_after(policy, places, flown, retrained, targets)),
        ("Retraining", _training(policy, retrained)),
    ]


def sentence(places: Sequence[Place], flown: Flown, retrained: Retrained | None) -> str:
    """What came of it, for the terminal and the top of the section."""
    if retrained is None:
        return "Nothing was named, so nothing was patched and the policy was not retrained."
    last = next(place for key in (HELD_BACK, PATCHED) for place in places if place.key == key)
    old, new = flown[OLD, last.key], flown[NEW, last.key]
    both = changed(old, new)
    told = (
        f"On {last.title} the old policy reaches {percent(float(old.mean()))} of the targets and the retrained one "
        f"{percent(float(new.mean()))}: of {old.size} flights {both['gained']} gained, {both['lost']} lost."
    )
    if retrained.better:
        return told
    return told + " In validation the retrained one is no better: keep the old one, or train on with more --seconds."


def _before_and_after(
    policy: str, places: Sequence[Place], flown: Flown, retrained: Retrained, targets: Sequence[Goal]
) -> Html:
    parts = [el("p", prose(sentence(places, flown, retrained))), _shares(places, flown, targets)]
    for place in places:
        if place.key in (HELD_BACK, PATCHED):
            pictures = [_map(flown[name, place.key], targets, f"{label} policy, {place.title}")
                        for name, label in ((OLD, "old"), (NEW, "retrained"))]  # fmt: skip
            parts.append(el("div", *pictures, class_="multiples maps"))
    note = (
        f"The paper's {len(targets)} targets from {next(iter(flown.values())).shape[1]} cart positions each, the "
        "daemon's own tick in every flight. A disc's ink is the share of its flights that reached; targets above "
        f"z = 0.70 m lie outside the training range. The old policy is {policy}."
    )
    return join([*parts, el("p", note, class_="hint")])


def _shares(places: Sequence[Place], flown: Flown, targets: Sequence[Goal]) -> Html:
    names = [name for name in (OLD, NEW) if any(key[0] == name for key in flown)]
    rows = []
    for place in places:
        row: list[Html | str] = [place.title]
        for name, kind in zip(names, ("nominal", "patched"), strict=False):
            share = shares(flown[name, place.key], targets)
            row.append(bar(share.all, kind, percent(share.all)))
            row.append("–" if share.in_range is None else percent(share.in_range))
        if NEW in names:
            both = changed(flown[OLD, place.key], flown[NEW, place.key])
            row.append(f"+{both['gained']} −{both['lost']}")
        rows.append(row)
    head = ["flown on", *(title for n in names for title in (f"{n} policy", f"{n}, z to 0.70 m"))]
    if NEW in names:
        head.append("flights gained, lost")
    return table(head, rows, "How often the policy reaches its target", numbers=(2, 4, 5)) if rows else Html("")


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
    use = "echo '{policies: {retrained: {plugin: onnx, options: {model: retrained.onnx}}}}' > retrained.yaml\n" \
          "softarm evaluate --policy retrained --config retrained.yaml --model patched-model.yaml"  # fmt: skip
    rows = [
        (f"{row.frames / 1e6:.2f} M", f"{row.seconds:.0f} s", percent(row.validation))
        for row in retrained.curve
        if row.validation is not None
    ]
    parts = [el("p", told), table(("frames", "time", "validation"), rows, "Validation while it learned", (1, 2))]
    return join([*parts, el("p", "Fly it yourself, from the folder of this report:"), el("pre", use)])
