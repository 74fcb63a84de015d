"""Report of a finished run: report.html, tip_paths.png and the last lines of `softarm train`."""

from collections.abc import Iterator
from pathlib import Path

from softarm.training.learn.validation import Tested, chosen_by, fly_trials
from softarm.training.record import page, path_figure, tensorboard
from softarm.training.record.checkpoint import load_policy
from softarm.training.record.settings import quick_products, usual
from softarm.training.run.session import Session


def fly_test_trials(session: Session) -> Tested:
    """Fly the task's test trials with the exported policy; they do not influence the training."""
    network, _ = load_policy(session.out / "best.pt")
    return fly_trials(network, session.task, session.pool, session.model)


def write(session: Session, tested: Tested) -> Path:
    """Write report.html and tip_paths.png next to the learning curve and return the path of the page."""
    out, settings = session.out, session.settings
    path_figure.write_png(tested, session.task, out / "tip_paths.png", session.title)
    best = next(row for row in session.curve if row.validation is not None and row.validation == session.best)
    network = session.network
    expected = usual(session.task, network.shape.inputs) | {"run.matrix_products": quick_products(network.device)}
    summary = page.Summary(
        title=session.title,
        task=session.task.name,
        model=str(settings["model.name"]),
        seed=session.config.seed,
        frames=session.frames,
        seconds=session.seconds,
        best=best.validation or 0.0,
        best_frames=best.frames,
        chosen_by=chosen_by(session.task),
        test=tested.sentence,
        changed=page.changed(settings, expected),
    )
    pictures = ((out / name).read_bytes() for name in ("learning_curve.png", "tip_paths.png"))
    path = out / "report.html"
    path.write_text(page.render(summary, *pictures), encoding="utf-8")
    return path


def ending(session: Session, policy: Path) -> Iterator[str]:
    """Fly the test trials with the exported policy, write the page, and yield lines about files and next steps."""
    name = f"my-{session.task.name}"
    yield f"{session.frames / 1e6:.2f} M frames in {session.seconds / 60:.1f} min, {session.out}:"
    yield f"  {policy.name}: the checkpoint with {session.best:.1%} of the validation set reached"
    yield "  learning_curve.csv and .png, latest.pt (to resume), best.pt (`softarm export`)"
    tested = fly_test_trials(session)
    yield f"  {tested.sentence}"
    path = write(session, tested)
    yield f"  {path.name}: the curves and the tip's paths at these trials, also in tip_paths.png"
    if session.events.fault is None:
        yield f"  tensorboard/: see it with `tensorboard --logdir {session.out}`"
    # A missing package was reported before the run.
    elif session.events.fault != tensorboard.missing():
        yield f"  {session.events.fault}"
    yield "Next: fly them through the daemon's own tick:"
    yield f"  echo '{{policies: {{{name}: {{plugin: onnx, options: {{model: {policy}}}}}}}}}' > mine.yaml"
    yield f"  softarm evaluate --policy {name} --config mine.yaml"
