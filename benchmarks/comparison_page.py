"""A comparison as one HTML file that needs nothing else, and as lines of Markdown."""

from html import escape

from benchmarks.comparison import Comparison, Figure
from schemas.goals import TEST_TARGETS

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem; color: #222 }
table { border-collapse: collapse } th, td { padding: .35rem .6rem; text-align: right; border-bottom: 1px solid #ddd }
th:first-child, td:first-child { text-align: left } td small { color: #444 } .paper td { color: #555 }
figure { display: inline-block; margin: 1rem 1.5rem 0 0 } figcaption { font-weight: 600 }
"""
_CELL_PX = 22


def columns(comparison: Comparison) -> list[str]:
    """Those that anything was measured in, in order."""
    used = {name for figures in comparison["policies"].values() for name in figures}
    return [name for name in comparison["columns"] if name in used]


def markdown(comparison: Comparison) -> str:
    """The table: shares in percent, mean and spread (standard deviation) over seeds."""
    names = columns(comparison)
    rows = [["policy", "seeds", *(comparison["columns"][name] for name in names)], ["---"] * (len(names) + 2)]
    for policy, figures in comparison["policies"].items():
        seeds = str(len(comparison["seeds"][policy]) or 1)
        rows.append([policy, seeds, *(_text(figures.get(name)) for name in names)])
    for policy, shares in comparison["hardware"].items():
        rows.append([policy, "", *(f"{100 * shares[name]:.0f}" if name in shares else "" for name in names)])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows) + "\n"


def html(comparison: Comparison, command: str) -> str:
    """The page. command: what made it, to stand on it."""
    names = columns(comparison)
    head = "".join(f"<th>{escape(comparison['columns'][name])}</th>" for name in names)
    body = ""
    for policy, figures in comparison["policies"].items():
        cells = "".join(_cell(figures.get(name)) for name in names)
        body += f"<tr><td>{escape(policy)}</td><td>{len(comparison['seeds'][policy]) or 1}</td>{cells}</tr>\n"
    for policy, shares in comparison["hardware"].items():
        cells = "".join(f"<td>{100 * shares[name]:.0f}</td>" if name in shares else "<td></td>" for name in names)
        body += f'<tr class="paper"><td>{escape(policy)}</td><td></td>{cells}</tr>\n'
    maps = "".join(
        f"<figure><figcaption>{escape(policy)}</figcaption>{_map(shares)}</figure>"
        for policy, shares in comparison["reached"].items()
    )
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Policies compared</title><style>{_STYLE}</style>'
        f"<h1>Policies compared</h1><p>Share of trials reached, in percent; mean and standard deviation over seeds. "
        f"Made by <code>{escape(command)}</code>.</p>"
        f"<table><tr><th>policy</th><th>seeds</th>{head}</tr>\n{body}</table>"
        "<p>The paper's figures are its hardware, ours are simulated flights of the daemon's own tick; "
        "&lsquo;held-back&rsquo; is the independent robot, whose changes are the strong examples of "
        "the effect registry.</p>"
        f"<h2>The 54 targets</h2><p>y from -0.40 (left) to 0.00 m, z from 0.55 (below) to 0.80 m; the darker, the more "
        f"starts and seeds reach it.</p>{maps}</html>\n"
    )


def _text(figure: Figure | None) -> str:
    if figure is None:
        return ""
    spread = "" if figure["spread"] is None else f" +- {100 * figure['spread']:.1f}"
    return f"{100 * figure['mean']:.1f}{spread}"


def _cell(figure: Figure | None) -> str:
    if figure is None:
        return "<td></td>"
    spread = "" if figure["spread"] is None else f" <small>&plusmn;&thinsp;{100 * figure['spread']:.1f}</small>"
    return f'<td style="background:{_shade(figure["mean"])}">{100 * figure["mean"]:.1f}{spread}</td>'


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
