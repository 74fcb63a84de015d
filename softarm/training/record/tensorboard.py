"""Learning curve for TensorBoard, over frames: `tensorboard --logdir OUT`, also during training."""

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
    "learner/action_error": "action_error",
    "speed/frames_per_s": "frames_per_s",
}  # tag -> column of the learning curve

FLUSH_S = 20  # greatest age of the points that TensorBoard shows during a run


def missing() -> str | None:
    """Return a hint if the package is not installed."""
    if find_spec("tensorboard") is not None:
        return None
    return "nothing for TensorBoard: its package is missing; pip install tensorboard"


class EventFile:
    """Writer of event files; an error is kept in `fault`, and training continues without them.

    The first row writes the whole curve so far and replaces older files, so a resumed run has each point once. That
    takes a second, later rows half a millisecond.
    """

    def __init__(self, folder: Path) -> None:
        self.fault = missing()
        self._folder = folder
        self._writer: Any = None

    def add(self, curve: Sequence[Iteration]) -> None:
        """Write the newest row, or all rows in the first call."""
        if self.fault is None:
            if self._writer is None:
                self._try(self._begin, curve)
            else:
                self._try(self._write, curve[-1], SCALARS, time.time())

    def add_validation(self, row: Iteration) -> None:
        """Write the validation of the last row."""
        if self._writer is not None:
            self._try(self._write, row, ("validation/success",), time.time())

    def close(self) -> None:
        """Close the file; later rows start a new file."""
        if self._writer is not None:
            self._try(self._writer.close)
            self._writer = None

    def _begin(self, curve: Sequence[Iteration]) -> None:
        from torch.utils.tensorboard import SummaryWriter  # takes a second

        for old in self._folder.glob("events.out.tfevents.*"):
            old.unlink()
        # purge_step: a running TensorBoard discards the points of the old files.
        self._writer = SummaryWriter(str(self._folder), purge_step=0, flush_secs=FLUSH_S)
        now = time.time()
        for row in curve:
            self._write(row, SCALARS, now - (curve[-1].seconds - row.seconds))

    def _write(self, row: Iteration, tags: Iterable[str], at_s: float) -> None:
        for tag in tags:
            value = getattr(row, SCALARS[tag])
            if value is not None:
                self._writer.add_scalar(tag, value, row.frames, walltime=at_s)

    def _try(self, action: Callable[..., None], *arguments: Any) -> None:
        try:
            action(*arguments)
        except Exception as error:  # a full disk or another version of the package must not stop a run
            self._writer = None
            reason = str(error).partition("\n")[0] or type(error).__name__
            self.fault = f"nothing more for TensorBoard in {self._folder}: {reason}"
