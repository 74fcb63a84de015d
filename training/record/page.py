"""A run as one HTML file that needs nothing else: what was trained, how it went, where the tip flew."""

from base64 import b64encode
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

from softarm.training.record.export import Settings

# Whatever a name holds, the browser fetches nothing.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
_STYLE = """
body { margin: 0 auto; padding: 1.5rem 1.25rem 4rem; max-width: 75rem; background: #fdfcfa; color: #21201d;
  font: 1rem/1.6 system-ui, sans-serif; font-variant-numeric: tabular-nums; color-scheme: light }
h1, h2 { line-height: 1.25; font-weight: 650; letter-spacing: -.01em } h1 { margin: .3rem 0 .75rem }
h2 { font-size: 1.4rem; margin: 2.5rem 0 .75rem; padding-top: 2rem; border-top: 1px solid #dcd8d0 }
.brand, .note { color: #615d56; font-size: .9rem } .lead { font-size: 1.15rem }
dl { display: grid; grid-template-columns: repeat(auto-fit, minmax(10rem, 1fr)); gap: .75rem; margin: 1.5rem 0 }
dl > div { background: #f5f3ef; border-radius: 10px; padding: .7rem 1rem .8rem }
dt { color: #615d56; font-size: .85rem } dd { margin: 0; font-size: 1.3rem; font-weight: 600; overflow-wrap: anywhere }
figure { margin: 0 } img { display: block; max-width: 100%; height: auto } .narrow img { max-width: min(100%, 56rem) }
.wide { overflow-x: auto } table { border-collapse: collapse; font-size: .92rem }
th, td { text-align: left; padding: .4rem 1.6rem .4rem 0; border-bottom: 1px solid #dcd8d0; font-weight: 400 }
thead th { color: #615d56; font-size: .85rem }
td { overflow-wrap: anywhere } code { font: .9em ui-monospace, Menlo, Consolas, monospace; white-space: nowrap }
@media print { h2 { break-after: avoid } figure, tr, dl { break-inside: avoid } }
"""


class Summary(NamedTuple):
    """What there is to say about a run."""

    title: str
    task: str
    model: str
    seed: int
    frames: int
    seconds: float
    best: float  # share of the validation set
    best_frames: int  # when that was
    chosen_by: str  # what the validation set is
    test: str  # a sentence
    changed: Sequence[tuple[str, str, str]]  # setting, its value, the usual one


def render(run: Summary, curve_png: bytes, paths_png: bytes) -> str:
    """The page; equal runs give equal pages."""
    tiles = {
        "task": run.task,
        "model": run.model,
        "seed": str(run.seed),
        "frames": f"{run.frames / 1e6:.2f} M",
        "training time": f"{run.seconds / 60:.1f} min",
        "validation set reached": f"{run.best:.1%}",
    }
    facts = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in tiles.items())
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        f"<title>{escape(run.title)} · softarm train</title><style>{_STYLE}</style></head>\n"
        f'<body><p class="brand">softarm train</p><h1>{escape(run.title)}</h1>\n'
        f'<p class="lead">{escape(run.test)}</p>\n<dl>{facts}</dl>\n'
        "<h2>The tip's paths</h2>\n"
        f"{_figure(paths_png, 'The paths of the tip at the test trials', '')}"
        "<p class='note'>Flown by the exported policy on the simulator that it was trained on, a point a control "
        "step. Nothing was chosen by these trials.</p>\n"
        "<h2>The learning curve</h2>\n"
        f"{_figure(curve_png, 'Success, reward, KL divergence and learning rate over frames', 'narrow')}"
        f'<p class="note">Exported is the checkpoint after {run.best_frames / 1e6:.2f} M frames, which did best in '
        f"validation ({run.best:.1%}): {escape(run.chosen_by)}.</p>\n"
        f"<h2>What it was trained with</h2>\n{_settings(run.changed)}</body></html>\n"
    )


def changed(settings: Settings, usual: Settings) -> list[tuple[str, str, str]]:
    """The settings that are not as usual: name, value, usual value (where there is one)."""
    # How often robots are drawn says something only of robots that differ.
    alike = not any(name.startswith("randomise.ranges.") for name in settings)
    settings = {name: value for name, value in settings.items() if not (alike and name.startswith("randomise."))}
    return [
        (name, _text(value), _text(usual[name]) if name in usual else "")
        for name, value in settings.items()
        if name not in usual or usual[name] != value
    ]


def _settings(rows: Sequence[tuple[str, str, str]]) -> str:
    if not rows:
        return "<p>Everything as usual.</p>"
    body = "".join(
        f"<tr><th scope='row'><code>{escape(name)}</code></th><td>{escape(value)}</td><td>{escape(usual)}</td></tr>\n"
        for name, value, usual in rows
    )
    head = "<tr><th scope='col'>setting</th><th scope='col'>here</th><th scope='col'>usual</th></tr>"
    return (
        "<p>All other settings are as usual; the policy's file holds every one.</p>\n"
        f'<div class="wide"><table><thead>{head}</thead><tbody>\n{body}</tbody></table></div>'
    )


def _figure(png: bytes, words: str, kind: str) -> str:
    source = f"data:image/png;base64,{b64encode(png).decode('ascii')}"
    return f'<figure class="{kind}"><img alt="{escape(words)}" src="{source}"></figure>\n'


def _text(value: object) -> str:
    if isinstance(value, list):
        return " .. ".join(map(_text, value))
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 40 else f"{text[:12]}…"  # a model's fingerprint
