"""Report of a finished run: report.html, tip_paths.png and the last lines of `softarm train`."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from softarm.policies.base import MODELS
from softarm.reporting.document import Section, document
from softarm.reporting.markup import Html, el, join, picture, table, tiles
from softarm.training.learn.validation import Tested, chosen_by, fly_trials
from softarm.training.record import path_figure, tensorboard
from softarm.training.record.checkpoint import load_policy
from softarm.training.record.settings import Settings, quick_products, usual
from softarm.training.run.session import Session
from softarm.training.task.shelf import ShelfTask


def fly_test_trials(session: Session) -> Tested:
    """Fly the task's test trials with the exported policy; they do not influence the training."""
    network, _ = load_policy(session.out / "best.pt")
    return fly_trials(network, session.task, session.pool, session.model)


def write(session: Session, tested: Tested) -> Path:
    """Write report.html and tip_paths.png next to the learning curve and return the path of the page."""
    path_figure.write_png(tested, session.task, session.out / "tip_paths.png", session.title)
    path = session.out / "report.html"
    path.write_text(_page(session, tested), encoding="utf-8")
    return path


def _page(session: Session, tested: Tested) -> str:
    """Return the self-contained page; equal runs give equal pages."""
    best = session.exported
    share = f"{session.best or 0.0:.1%}"
    facts = (
        ("task", session.task.name),
        ("model", str(session.settings["model.name"])),
        ("seed", str(session.config.seed)),
        ("frames", f"{session.frames / 1e6:.2f} M"),
        ("training time", f"{session.seconds / 60:.1f} min"),
        ("validation set reached", share),
    )
    lead = join([el("h1", session.title), el("div", el("p", tested.sentence), class_="lead"), tiles(facts)])
    flown = (
        "Flown by the exported policy on its training simulator, one point per control step. These trials did not "
        "influence the training."
    )
    chosen = (
        f"The exported checkpoint, after {best.frames / 1e6:.2f} M frames, has the best validation "
        f"({share}): {chosen_by(session.task)}."
    )
    curve_png, paths_png = ((session.out / name).read_bytes() for name in ("learning_curve.png", "tip_paths.png"))
    paths = picture(paths_png, "Tip paths in the test trials")
    curve = picture(curve_png, "Success, reward, KL divergence and learning rate over frames", "narrow")
    network = session.network
    expected = usual(session.task, network.shape.inputs) | {"run.matrix_products": quick_products(network.device)}
    sections = (
        Section("Tip paths", "paths", join([paths, el("p", flown, class_="hint")])),
        Section("Learning curve", "curve", join([curve, el("p", chosen, class_="hint")])),
        Section("Settings", "settings", _settings(changed(session.settings, expected))),
    )
    return document(session.title, "softarm train", lead, sections)


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


def ending(session: Session, policy: Path) -> Iterator[str]:
    """Fly the test trials with the exported policy, write the page, and yield lines about files and next steps."""
    yield f"{session.frames / 1e6:.2f} M frames in {session.seconds / 60:.1f} min, {session.out}:"
    yield f"  {policy.name}: the checkpoint with {session.best:.1%} of the validation set reached"
    yield "  learning_curve.csv and .png, latest.pt (to resume), best.pt (`softarm dev export`)"
    if (error := session.exported.action_error) is not None:
        yield f"  action error on the held-out episodes: {error:.3f}, root mean square; actions span -1 to 1"
    tested = fly_test_trials(session)
    yield f"  {tested.sentence}"
    path = write(session, tested)
    yield f"  {path.name}: the curves and the tip's paths at these trials, also in tip_paths.png"
    if session.events.fault is None:
        yield f"  tensorboard/: see it with `tensorboard --logdir {session.out}`"
    # A missing package was reported before the run.
    elif session.events.fault != tensorboard.missing():
        yield f"  {session.events.fault}"
    name = session.task.name
    shipped = f" {name}" if (MODELS / f"{name}.onnx").is_file() else ""
    test = " --test shelf" if isinstance(session.task, ShelfTask) else ""
    yield "Next: fly it through the daemon's own tick, and give it a name for the daemon:"
    yield f"  softarm evaluate {session.out}{shipped}{test}"
    yield f"  echo '{{policies: {{my-{name}: {{plugin: onnx, options: {{model: {policy}}}}}}}}}' > mine.yaml"
