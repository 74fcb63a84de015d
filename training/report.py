"""The learning curve as a table and a picture."""

import csv
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple


class Row(NamedTuple):
    """One iteration."""

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


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """Write the table in one piece."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    with temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(Row._fields)
        writer.writerows(rows)
    os.replace(temporary, path)


def write_png(rows: Sequence[Row], path: Path, title: str) -> None:
    """Draw success against frames, and below it what steers the learning rate."""
    from matplotlib.figure import Figure  # no pyplot: no global state, no display

    figure = Figure(figsize=(8, 6), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    millions = [row.frames / 1e6 for row in rows]
    top.plot(millions, [row.success for row in rows], color="0.7", label="training episodes, with noise")
    validated = [row for row in rows if row.validation is not None]
    top.plot(
        [row.frames / 1e6 for row in validated],
        [row.validation for row in validated],
        "o-",
        markersize=3,
        color="tab:blue",
        label="validation set, no noise",
    )
    top.set(ylabel="share reached", ylim=(0, 1), title=title)
    top.legend(loc="lower right")
    top.grid(alpha=0.3)
    bottom.semilogy(millions, [row.learning_rate for row in rows], color="tab:green", label="learning rate")
    bottom.semilogy(millions, [row.kl for row in rows], color="tab:red", alpha=0.6, label="KL")
    bottom.set(xlabel="million frames")
    bottom.legend(loc="lower right")
    bottom.grid(alpha=0.3)
    figure.savefig(path, dpi=120)
