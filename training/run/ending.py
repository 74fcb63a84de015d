"""The end of a run: the test trials flown, the page written, and a line on each thing that it leaves."""

from collections.abc import Iterator
from pathlib import Path

from softarm.training.record import report, tensorboard
from softarm.training.run.session import Session


def ending(session: Session, policy: Path) -> Iterator[str]:
    """Fly the test trials with the exported policy and write the page; line by line, what there is and what is next."""
    name = f"my-{session.task.name}"
    yield f"{session.frames / 1e6:.2f} M frames in {session.seconds / 60:.1f} min, {session.out}:"
    yield f"  {policy.name}: the checkpoint with {session.best:.1%} of the validation set reached"
    yield "  learning_curve.csv and .png, latest.pt (to resume), best.pt (`softarm export`)"
    tested = report.fly_test_trials(session)
    yield f"  {tested.sentence}"
    page = report.write(session, tested)
    yield f"  {page.name}: the curves and the tip's paths at these trials, also in tip_paths.png"
    if session.events.fault is None:
        yield f"  tensorboard/: see it with `tensorboard --logdir {session.out}`"
    elif session.events.fault != tensorboard.missing():  # that was said before the run
        yield f"  {session.events.fault}"
    yield "Next: fly them through the daemon's own tick:"
    yield f"  echo '{{policies: {{{name}: {{plugin: onnx, options: {{model: {policy}}}}}}}}}' > mine.yaml"
    yield f"  softarm evaluate --policy {name} --config mine.yaml"
