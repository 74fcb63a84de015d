"""A comparison as one HTML file that needs nothing else, and as lines of Markdown."""

from collections.abc import Callable, Iterator

from softarm.flights.table import CEILING, Comparison, Figure
from softarm.pages import charts
from softarm.pages.document import Section, document
from softarm.pages.markup import Child, Html, el, join, shaded, table
from softarm.schemas.flights import TEST_TARGETS

READING = (  # below every table
    "Empty: not measured, or no test of it. A dash: the policy had an answer to none of these trials.",
    "Ceiling: a cross-entropy search over open-loop commands, trial by trial, on the simulator itself and behind the "
    "same braking clamp; a lower bound of what can be reached from rest.",
    "mppi plans against the clock: on a machine that is busy elsewhere it gets less done.",
    "Seeds: of the training. A shipped policy is one file of one seed; --runs flies a sweep's, with their spread.",
    "The paper's figures are its hardware's, all others simulated flights of the daemon's own tick; 'held-back' is the "
    "independent robot, its changes the strong examples of the effect registry where no figure is named.",
)


def columns(comparison: Comparison) -> list[str]:
    """Those that anything was measured in, in order."""
    used = {name for figures in comparison["policies"].values() for name in figures}
    return [name for name in comparison["columns"] if name in used]


def markdown(comparison: Comparison) -> str:
    """The table: shares in percent, mean and spread (standard deviation) over seeds; below it its footnotes."""
    names = columns(comparison)
    head = ["policy", "seeds", *(comparison["columns"][name] for name in names)]
    rows = _rows(comparison, names, lambda figure, marks: _text(figure) + (f" [{marks}]" if marks else ""))
    lines = [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]
    said = [f"- [{number}] {note}" for number, note in enumerate(footnotes(comparison), start=1)]
    return "\n".join([*lines, "", *said, *(f"- {line}" for line in READING)]) + "\n"


def html(comparison: Comparison, command: str) -> str:
    """The page. command: what made it, to stand on it."""
    names = columns(comparison)
    told = "Share of trials reached, in percent; mean and standard deviation over seeds."
    lead = [el("h1", "Policies compared"), el("div", el("p", told), class_="lead")]
    made = el("p", "Made by ", el("code", command), ".", class_="hint")
    head = ("policy", "seeds", *(comparison["columns"][name] for name in names))
    caption = "Each policy at each test; the stronger the ground, the more was reached"
    whole = table(head, _rows(comparison, names, _cell), caption, numbers=range(1, len(head)))
    notes = el("ol", *(el("li", note) for note in footnotes(comparison)))
    reading = [el("p", line, class_="hint") for line in READING]
    y, z = [goal.y_m for goal in TEST_TARGETS], [goal.z_m for goal in TEST_TARGETS]
    maps = (charts.disc_map(y, z, shares, _title(policy)) for policy, shares in comparison["reached"].items())
    inked = el("p", "A disc's ink is the share of starts and seeds that reach the target.")
    sections = (
        Section("All policies at all tests", "table", join([whole, notes, *reading])),
        Section("The 54 targets", "targets", join([inked, el("div", *maps, class_="multiples maps")])),
    )
    return document("Policies compared", "softarm evaluate", join([*lead, made]), sections)


def _rows(
    comparison: Comparison, names: list[str], cell: Callable[[Figure | None, str], Child]
) -> Iterator[list[Child]]:
    """A row a policy, then the paper's. cell(a figure, the numbers of its footnotes)."""
    notes = footnotes(comparison)
    for policy, figures in comparison["policies"].items():
        cells = (cell(figures.get(name), _marks(comparison, notes, policy, name)) for name in names)
        yield [_title(policy), _seeds(comparison, policy), *cells]
    for policy, shares in comparison["hardware"].items():
        if shares.keys() & set(names):
            yield [policy, "", *(f"{100 * shares[name]:.0f}" if name in shares else "" for name in names)]


def footnotes(comparison: Comparison) -> list[str]:
    """What must be known of single figures, each once, in the order of the table."""
    rows = (comparison["notes"].get(policy, {}) for policy in comparison["policies"])
    return list(dict.fromkeys(note for row in rows for name in columns(comparison) for note in row.get(name, ())))


def _marks(comparison: Comparison, notes: list[str], policy: str, column: str) -> str:
    """The numbers of a figure's footnotes, e.g. `1,2`."""
    return ",".join(str(1 + notes.index(note)) for note in comparison["notes"].get(policy, {}).get(column, []))


def _title(policy: str) -> str:
    return "ceiling (open-loop search)" if policy == CEILING else policy


def _seeds(comparison: Comparison, policy: str) -> str:
    """How many training seeds; nothing for what was not trained here."""
    return str(len(comparison["seeds"][policy]) or "")


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
