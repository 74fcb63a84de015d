"""A run's learning curve for TensorBoard, over frames: `tensorboard --logdir OUT`, also while it trains."""

import time
from collections.abc import Callable, Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from softarm.training.record.curve import Iteration

SCALARS = {
    "episodes/success": "success",
    "episodes/reward": "reward",
    "validation/success": "validation",
    "learner/kl": "kl",
    "learner/learning_rate": "learning_rate",
    "learner/std": "std",
    "learner/value_loss": "value_loss",
    "speed/frames_per_s": "frames_per_s",
}  # tag -> column of the learning curve

FLUSH_S = 20  # what a run shows to those who watch is at most so old


def missing() -> str | None:
    """What to say where the package is not installed."""
    if find_spec("tensorboard") is not None:
        return None
    return "nothing for TensorBoard: its package is missing; pip install tensorboard"


class EventFile:
    """Writes into a folder; whatever goes wrong there stands in `fault`, and training goes on without.

    What is opened begins with the whole curve so far, in place of older files: a run that was killed and goes on
    has no point twice and none missing. What opens it takes a second, a row then half a millisecond.
    """

    def __init__(self, folder: Path) -> None:
        self.fault = missing()
        self._folder = folder
        self._writer: Any = None

    def add(self, curve: Sequence[Iteration]) -> None:
        """Write the newest row; all of them, the first time."""
        if self.fault is None:
            self._try(self._begin if self._writer is None else self._go_on, curve)

    def add_validation(self, row: Iteration) -> None:
        """Write what validation said of the row that was added last."""
        if self._writer is not None:
            self._try(self._write, row, ("validation/success",), time.time())

    def close(self) -> None:
        """Have everything on disk; what is added later begins anew."""
        if self._writer is not None:
            self._try(self._writer.close)
            self._writer = None

    def _begin(self, curve: Sequence[Iteration]) -> None:
        from torch.utils.tensorboard import SummaryWriter  # takes a second

        for old in self._folder.glob("events.out.tfevents.*"):
            old.unlink()
        # A TensorBoard that has read the old files forgets what it read.
        self._writer = SummaryWriter(str(self._folder), purge_step=0, flush_secs=FLUSH_S)
        now = time.time()
        for row in curve:
            self._write(row, SCALARS, now - (curve[-1].seconds - row.seconds))

    def _go_on(self, curve: Sequence[Iteration]) -> None:
        self._write(curve[-1], SCALARS, time.time())

    def _write(self, row: Iteration, tags: Iterable[str], at_s: float) -> None:
        for tag in tags:
            value = getattr(row, SCALARS[tag])
            if value is not None:
                self._writer.add_scalar(tag, value, row.frames, walltime=at_s)

    def _try(self, action: Callable[..., None], *arguments: Any) -> None:
        try:
            action(*arguments)
        except Exception as error:  # a full disk, a package that does not fit: nothing to stop a run for
            self._writer = None
            reason = str(error).partition("\n")[0] or type(error).__name__
            self.fault = f"nothing more for TensorBoard in {self._folder}: {reason}"
