"""A comparison as one HTML file that needs nothing else, and as lines of Markdown."""

from html import escape

from softarm.flights.table import CEILING, Comparison, Figure
from softarm.schemas.goals import TEST_TARGETS

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem; color: #222 }
table { border-collapse: collapse } th, td { padding: .35rem .6rem; text-align: right; border-bottom: 1px solid #ddd }
th:first-child, td:first-child { text-align: left } td + td { white-space: nowrap }
td small { color: #444 } .paper td { color: #555 }
sup { line-height: 0; position: absolute; font-size: .65em }
figure { display: inline-block; margin: 1rem 1.5rem 0 0 } figcaption { font-weight: 600 }
"""
_CELL_PX = 22
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
    names, notes = columns(comparison), footnotes(comparison)
    rows = [["policy", "seeds", *(comparison["columns"][name] for name in names)], ["---"] * (len(names) + 2)]
    for policy, figures in comparison["policies"].items():
        cells = (_text(figures.get(name)) + _marks(comparison, notes, policy, name, " [{}]") for name in names)
        rows.append([_title(policy), _seeds(comparison, policy), *cells])
    for policy, shares in _hardware(comparison, names):
        rows.append([policy, "", *(f"{100 * shares[name]:.0f}" if name in shares else "" for name in names)])
    lines = [f"| {' | '.join(row)} |" for row in rows]
    said = [f"- [{number}] {note}" for number, note in enumerate(notes, start=1)]
    return "\n".join([*lines, "", *said, *(f"- {line}" for line in READING)]) + "\n"


def html(comparison: Comparison, command: str) -> str:
    """The page. command: what made it, to stand on it."""
    names, notes = columns(comparison), footnotes(comparison)
    head = "".join(f"<th>{escape(comparison['columns'][name])}</th>" for name in names)
    body = ""
    for policy, figures in comparison["policies"].items():
        cells = "".join(
            _cell(figures.get(name), _marks(comparison, notes, policy, name, "<sup>{}</sup>")) for name in names
        )
        body += f"<tr><td>{escape(_title(policy))}</td><td>{_seeds(comparison, policy)}</td>{cells}</tr>\n"
    for policy, shares in _hardware(comparison, names):
        cells = "".join(f"<td>{100 * shares[name]:.0f}</td>" if name in shares else "<td></td>" for name in names)
        body += f'<tr class="paper"><td>{escape(policy)}</td><td></td>{cells}</tr>\n'
    maps = "".join(
        f"<figure><figcaption>{escape(_title(policy))}</figcaption>{_map(shares)}</figure>"
        for policy, shares in comparison["reached"].items()
    )
    said = "".join(f"<li>{escape(note)}</li>" for note in notes)
    reading = "".join(f"<p>{escape(line)}</p>" for line in READING)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Policies compared</title><style>{_STYLE}</style>'
        f"<h1>Policies compared</h1><p>Share of trials reached, in percent; mean and standard deviation over seeds. "
        f"Made by <code>{escape(command)}</code>.</p>"
        f"<table><tr><th>policy</th><th>seeds</th>{head}</tr>\n{body}</table><ol>{said}</ol>{reading}"
        f"<h2>The 54 targets</h2><p>y from -0.40 (left) to 0.00 m, z from 0.55 (below) to 0.80 m; the darker, the more "
        f"starts and seeds reach it.</p>{maps}</html>\n"
    )


def footnotes(comparison: Comparison) -> list[str]:
    """What must be known of single figures, each once, in the order of the table."""
    rows = (comparison["notes"].get(policy, {}) for policy in comparison["policies"])
    return list(dict.fromkeys(note for row in rows for name in columns(comparison) for note in row.get(name, ())))


def _hardware(comparison: Comparison, names: list[str]) -> list[tuple[str, dict[str, float]]]:
    """The paper's rows that have something to say in these columns."""
    return [(policy, shares) for policy, shares in comparison["hardware"].items() if shares.keys() & set(names)]


def _marks(comparison: Comparison, notes: list[str], policy: str, column: str, mark: str) -> str:
    """The numbers of a figure's footnotes, e.g. ` [1,2]`."""
    own = comparison["notes"].get(policy, {}).get(column, [])
    return mark.format(",".join(str(1 + notes.index(note)) for note in own)) if own else ""


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


def _cell(figure: Figure | None, marks: str) -> str:
    if figure is None:
        return "<td></td>"
    text = escape(_text(figure)).replace(" +- ", " <small>&plusmn;&thinsp;") + ("</small>" if figure["spread"] else "")
    return f'<td style="background:{_shade(figure["mean"])}">{text}{marks}</td>'


def _shade(share: float) -> str:
    return f"hsl(210 60% {96 - 36 * share:.0f}%)"


def _map(shares: list[float]) -> str:
    ys, zs = sorted({g.y_m for g in TEST_TARGETS}), sorted({g.z_m for g in TEST_TARGETS}, reverse=True)
    boxes = "".join(
        f'<rect x="{ys.index(goal.y_m) * _CELL_PX}" y="{zs.index(goal.z_m) * _CELL_PX}" width="{_CELL_PX - 1}" '
        f'height="{_CELL_PX - 1}" fill="{_shade(share)}"><title>y {goal.y_m:.2f}, z {goal.z_m:.2f} m: '
        f"{100 * share:.0f} %</title></rect>"
        for goal, share in zip(TEST_TARGETS, shares, strict=True)
    )
    return f'<svg width="{len(ys) * _CELL_PX}" height="{len(zs) * _CELL_PX}">{boxes}</svg>'
