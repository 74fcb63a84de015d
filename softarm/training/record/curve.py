"""Learning curve of a run: as a table, as a picture, and for TensorBoard (`tensorboard --logdir OUT`)."""

import csv
import io
import time
from collections.abc import Callable, Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from softarm.common import files
from softarm.reporting.colours import LIGHT

BLUE, ORANGE, GREEN, PAPER = (LIGHT[name] for name in ("accent", "warning", "good", "paper"))  # as on the pages


class Iteration(NamedTuple):
    """Figures of one iteration."""

    iteration: int
    frames: int
    seconds: float
    frames_per_s: float
    reward: float  # mean per step, scaled
    success: float  # of the episodes that ended in the roll-out, with exploration noise
    kl: float
    learning_rate: float
    std: float
    value_loss: float
    validation: float | None = None  # success on the validation set, where one was flown
    action_error: float | None = None  # root mean square on held-out episodes; None without episodes


def validated(rows: Sequence[Iteration]) -> list[float]:
    """Return the success of each validation, in order."""
    return [row.validation for row in rows if row.validation is not None]


def fruitless(rows: Sequence[Iteration]) -> int:
    """Return the number of validations since the best one."""
    shares = validated(rows)
    return len(shares) - 1 - shares.index(max(shares)) if shares else 0


def write_csv(rows: Sequence[Iteration], path: Path) -> None:
    """Write the table atomically."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(Iteration._fields)
    writer.writerows(rows)
    files.write_text(path, text.getvalue())


def write_png(rows: Sequence[Iteration], path: Path, title: str) -> None:
    """Draw success, reward, KL divergence and learning rate over frames."""
    from matplotlib.figure import Figure  # no pyplot: no global state, no display

    figure = Figure(figsize=(9, 7.5), layout="constrained", facecolor=PAPER)
    success, reward, steering = figure.subplots(3, 1, sharex=True, height_ratios=(2, 1, 1))
    millions = [row.frames / 1e6 for row in rows]
    success.plot(millions, [row.success for row in rows], color="0.7", label="training episodes, with noise")
    validated = [row for row in rows if row.validation is not None]
    success.plot(
        [row.frames / 1e6 for row in validated],
        [row.validation for row in validated],
        "o-",
        markersize=3,
        color=BLUE,
        label="validation set, no noise",
    )
    success.set(ylabel="share reached", ylim=(0, 1))
    errors = [row.action_error for row in rows]
    if None in errors:
        reward.plot(millions, [row.reward for row in rows], color=BLUE, label="mean reward of a step, scaled")
        reward.set(ylabel="reward")
    else:
        reward.plot(millions, errors, color=BLUE, label="action error on held-out episodes, root mean square")
        reward.set(ylabel="error")
    steering.semilogy(millions, [row.learning_rate for row in rows], color=GREEN, label="learning rate")
    steering.semilogy(millions, [row.kl for row in rows], color=ORANGE, alpha=0.7, label="KL divergence")
    steering.set(ylabel="learner", xlabel="million frames")
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    for axes in (success, reward, steering):
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, frameon=False, borderaxespad=0.2)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=120)


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


def tensorboard_missing() -> str | None:
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
        self.fault = tensorboard_missing()
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
