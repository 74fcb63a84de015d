"""What a finished run leaves for people: report.html and tip_paths.png, from its test trials and its curve."""

from pathlib import Path

from softarm.training.record import page, path_figure
from softarm.training.run.checkpoint import load_policy
from softarm.training.run.session import Session
from softarm.training.run.settings import quick_products, usual
from softarm.training.run.validation import Tested, chosen_by, test


def fly_test_trials(session: Session) -> Tested:
    """Fly the task's test trials with the exported policy, for the record; nothing is chosen by it."""
    network, _ = load_policy(session.out / "best.pt")
    return test(network, session.task, session.pool, session.model)


def write(session: Session, tested: Tested) -> Path:
    """Leave report.html and tip_paths.png beside the curve that the run drew; returns the page's path."""
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
