"""The comparison of policies as a self-contained HTML page and as Markdown."""

from collections.abc import Callable, Iterator

from softarm.evaluation.entries import CEILING
from softarm.evaluation.table import Comparison, Figure
from softarm.reporting import charts
from softarm.reporting.document import Section, document
from softarm.reporting.markup import Child, Html, el, join, shaded, table
from softarm.schemas.flights import TEST_TARGETS

_LISTED = 3  # flights whose distances are listed one by one

# Remarks below a table: the row that one is about (None: every table), and the text.
READING = (
    (None, "Empty: not measured. - = not applicable: the policy refused every one of these trials."),
    (
        CEILING,
        "Ceiling: a cross-entropy search over open-loop commands for each trial, on the simulator itself and with the "
        "same braking clamp. It is a lower bound of what can be reached from rest.",
    ),
    ("mppi", "mppi plans for a fixed time per tick: on a busy computer it reaches less."),
    (None, "Seeds: training seeds. A shipped policy is one file of one seed; the folder of a sweep shows the spread."),
    (
        None,
        "The paper's figures were measured on its hardware. All other flights are simulated and flown by the real "
        "control loop. The independent robot shares no code with the simulator; where its change has no figure, the "
        "change is the effect registry's example.",
    ),
)


def columns(comparison: Comparison) -> list[str]:
    """Return the columns that hold a figure, in the order of the table."""
    used = {name for figures in comparison["policies"].values() for name in figures}
    return [name for name in comparison["columns"] if name in used]


def markdown(comparison: Comparison) -> str:
    """Return the table in percent, `mean +- standard deviation` over seeds, with its footnotes."""
    names = columns(comparison)
    head = ["policy", "seeds", *(comparison["columns"][name] for name in names)]
    rows = _rows(comparison, names, lambda figure, marks: _text(figure) + (f" [{marks}]" if marks else ""))
    lines = [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]
    notes = [f"- [{number}] {note}" for number, note in enumerate(footnotes(comparison), start=1)]
    return "\n".join([*lines, "", *notes, *(f"- {line}" for line in _remarks(comparison))]) + "\n"


def html(comparison: Comparison, command: str) -> str:
    """Return the comparison as a page that shows the command that made it."""
    names = columns(comparison)
    figures = [figure for row in comparison["policies"].values() for figure in row.values()]
    has_spread = any(figure["spread"] is not None for figure in figures)
    subtitle = "Share of trials reached, in percent" + (
        "; mean and standard deviation over seeds." if has_spread else "."
    )
    lead = [el("h1", "Policies compared"), el("div", el("p", subtitle), class_="lead")]
    made = el("p", "Made by ", el("code", command), ".", class_="hint")
    head = ("policy", "seeds", *(comparison["columns"][name] for name in names))
    caption = "Each policy in each test; darker = more targets reached"
    whole = table(head, _rows(comparison, names, _cell), caption, numbers=range(1, len(head)))
    notes = el("ol", *(el("li", note) for note in footnotes(comparison)))
    reading = [el("p", line, class_="hint") for line in _remarks(comparison)]
    sections = [Section("Success by test", "table", join([whole, notes, *reading]))]
    if comparison["reached"]:
        sections += [_maps(comparison), _distances(comparison)]
    return document("Policies compared", "softarm evaluate", join([*lead, made]), sections)


def _maps(comparison: Comparison) -> Section:
    """Return a map of the 54 targets for each policy, all on one scale."""
    y, z = [goal.y_m for goal in TEST_TARGETS], [goal.z_m for goal in TEST_TARGETS]
    maps = []
    for policy, shares in comparison["reached"].items():
        notes = [_note(*each) for each in zip(shares, comparison["closest_m"][policy], strict=True)]
        maps.append(charts.disc_map(y, z, shares, _title(policy), notes))
    legend = charts.map_legend("reached in every flight", "reached in this share of the flights", "missed")
    text = el("p", f"Test: {comparison['mapped']}. The pointer on a target shows the closest distance of its flights.")
    return Section("The 54 targets", "targets", join([text, legend, el("div", *maps, class_="multiples maps")]))


def _distances(comparison: Comparison) -> Section:
    """Return the table of the closest distances, which needs no pointer."""
    names = list(comparison["reached"])
    rows = []
    for number, goal in enumerate(TEST_TARGETS):
        cells = [
            shaded(comparison["reached"][name][number], _farthest(comparison["closest_m"][name][number]))
            for name in names
        ]
        rows.append((f"{goal.y_m:.2f}, {goal.z_m:.2f}", *cells))
    caption = "Closest distance of the tip in the worst flight to each target, mm; darker = more flights reach it"
    head = ("target y, z (m)", *map(_title, names))
    return Section("Closest distances", "distances", table(head, rows, caption, range(1, len(head))), folded=True)


def _note(share: float, closest_m: list[float | None]) -> str:
    """Return the flights that reach a target, and the closest distance of each or their range."""
    mm = [f"{1e3 * each:.0f}" for each in sorted(each for each in closest_m if each is not None)]
    some = ", ".join(mm) if len(mm) <= _LISTED else f"{mm[0]} to {mm[-1]}"
    reached = f"reached in {round(share * len(closest_m))} of {len(closest_m)} flights"
    return f"{reached}; closest distance {some} mm" if mm else reached


def _farthest(closest_m: list[float | None]) -> str:
    known = [each for each in closest_m if each is not None]
    return f"{1e3 * max(known):.0f}" if len(known) == len(closest_m) else "not known"


def _remarks(comparison: Comparison) -> list[str]:
    """Return the remarks on every table and on the rows of this one."""
    return [text for row, text in READING if row is None or row in comparison["policies"]]


def _rows(
    comparison: Comparison, names: list[str], cell: Callable[[Figure | None, str], Child]
) -> Iterator[list[Child]]:
    """Yield a row for each policy, then the paper's; `cell` gets a figure and the numbers of its footnotes."""
    notes = footnotes(comparison)
    for policy, figures in comparison["policies"].items():
        cells = (cell(figures.get(name), _marks(comparison, notes, policy, name)) for name in names)
        # Empty for a policy without training.
        seeds = str(len(comparison["seeds"][policy]) or "")
        yield [_title(policy), seeds, *cells]
    for policy, shares in comparison["hardware"].items():
        if shares.keys() & set(names):
            yield [policy, "", *(f"{100 * shares[name]:.0f}" if name in shares else "" for name in names)]


def footnotes(comparison: Comparison) -> list[str]:
    """Return the remarks on single figures, each once, in the order of the table."""
    rows = (comparison["notes"].get(policy, {}) for policy in comparison["policies"])
    return list(dict.fromkeys(note for row in rows for name in columns(comparison) for note in row.get(name, ())))


def _marks(comparison: Comparison, notes: list[str], policy: str, column: str) -> str:
    """Return the numbers of a figure's footnotes, e.g. `1,2`."""
    return ",".join(str(1 + notes.index(note)) for note in comparison["notes"].get(policy, {}).get(column, []))


def _title(policy: str) -> str:
    return "ceiling (open-loop search)" if policy == CEILING else policy


def _text(figure: Figure | None) -> str:
    if figure is None:
        return ""
    if figure["refused"] == 1.0:
        return "-"
    spread = "" if figure["spread"] is None else f" +- {100 * figure['spread']:.1f}"
    return f"{100 * figure['mean']:.1f}{spread}"


def _cell(figure: Figure | None, marks: str) -> Html:
    if figure is None:
        return Html("")
    mean, _, spread = _text(figure).partition(" +- ")
    parts = [mean, el("small", f" ±\N{THIN SPACE}{spread}") if spread else "", el("sup", marks) if marks else ""]
    return shaded(figure["mean"], join(parts))
