"""Report of a training run as a self-contained HTML page."""

from collections.abc import Sequence
from typing import NamedTuple

from softarm.reporting.document import Section, document
from softarm.reporting.markup import Html, el, join, picture, table, tiles
from softarm.training.record.settings import Settings


class Summary(NamedTuple):
    """Facts about a run, for its page."""

    title: str
    task: str
    model: str
    seed: int
    frames: int
    seconds: float
    best: float  # share of the validation set
    best_frames: int  # frames at the best validation
    chosen_by: str  # what the validation set is
    test: str  # a sentence
    changed: Sequence[tuple[str, str, str]]  # setting, its value, the usual one


def render(run: Summary, curve_png: bytes, paths_png: bytes) -> str:
    """Return the page; equal runs give equal pages."""
    facts = (
        ("task", run.task),
        ("model", run.model),
        ("seed", str(run.seed)),
        ("frames", f"{run.frames / 1e6:.2f} M"),
        ("training time", f"{run.seconds / 60:.1f} min"),
        ("validation set reached", f"{run.best:.1%}"),
    )
    lead = join([el("h1", run.title), el("div", el("p", run.test), class_="lead"), tiles(facts)])
    flown = (
        "Flown by the exported policy on its training simulator, one point per control step. These trials did not "
        "influence the training."
    )
    chosen = (
        f"The exported checkpoint, after {run.best_frames / 1e6:.2f} M frames, has the best validation "
        f"({run.best:.1%}): {run.chosen_by}."
    )
    paths = picture(paths_png, "Tip paths in the test trials")
    curve = picture(curve_png, "Success, reward, KL divergence and learning rate over frames", "narrow")
    sections = (
        Section("Tip paths", "paths", join([paths, el("p", flown, class_="hint")])),
        Section("Learning curve", "curve", join([curve, el("p", chosen, class_="hint")])),
        Section("Settings", "settings", _settings(run.changed)),
    )
    return document(run.title, "softarm train", lead, sections)


def changed(settings: Settings, usual: Settings) -> list[tuple[str, str, str]]:
    """Return settings that differ from the default: name, value and default (if there is one)."""
    # The frequency of drawing matters only if the robots vary.
    alike = not any(name.startswith("randomise.ranges.") for name in settings)
    settings = {name: value for name, value in settings.items() if not (alike and name.startswith("randomise."))}
    return [
        (name, _text(value), _text(usual[name]) if name in usual else "")
        for name, value in settings.items()
        if name not in usual or usual[name] != value
    ]


def _settings(rows: Sequence[tuple[str, str, str]]) -> Html:
    if not rows:
        return el("p", "All settings have their default values.")
    text = el("p", "All other settings have their default values; the policy's file lists every setting.")
    body = ((el("code", name), value, usual) for name, value, usual in rows)
    return join([text, table(("setting", "value", "default"), body, "Settings that differ from the default")])


def _text(value: object) -> str:
    if isinstance(value, list):
        return " .. ".join(map(_text, value))
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 40 else f"{text[:12]}…"  # a model's fingerprint
