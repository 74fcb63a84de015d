"""A run as one HTML file that needs nothing else: what was trained, how it went, where the tip flew."""

from collections.abc import Sequence
from typing import NamedTuple

from softarm.pages.document import Section, document
from softarm.pages.markup import Html, el, join, picture, table, tiles
from softarm.training.run.settings import Settings


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
        "Flown by the exported policy on the simulator that it was trained on, a point a control step. Nothing was "
        "chosen by these trials."
    )
    chosen = (
        f"Exported is the checkpoint after {run.best_frames / 1e6:.2f} M frames, which did best in validation "
        f"({run.best:.1%}): {run.chosen_by}."
    )
    paths = picture(paths_png, "The paths of the tip at the test trials")
    curve = picture(curve_png, "Success, reward, KL divergence and learning rate over frames", "narrow")
    sections = (
        Section("The tip's paths", "paths", join([paths, el("p", flown, class_="hint")])),
        Section("The learning curve", "curve", join([curve, el("p", chosen, class_="hint")])),
        Section("What it was trained with", "settings", _settings(run.changed)),
    )
    return document(run.title, "softarm train", lead, sections)


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


def _settings(rows: Sequence[tuple[str, str, str]]) -> Html:
    if not rows:
        return el("p", "Everything as usual.")
    told = el("p", "All other settings are as usual; the policy's file holds every one.")
    body = ((el("code", name), value, usual) for name, value, usual in rows)
    return join([told, table(("setting", "here", "usual"), body, "Settings that are not as usual")])


def _text(value: object) -> str:
    if isinstance(value, list):
        return " .. ".join(map(_text, value))
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 40 else f"{text[:12]}…"  # a model's fingerprint
