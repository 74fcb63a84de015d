"""Recordings of a robot that is commanded by positions, as arrays in the order of a MuJoCo model's joints."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.data.trials import Trial

Array = NDArray[np.float64]


class Recording(NamedTuple):
    """Commands and positions of all joints, in the model's order."""

    name: str
    command_s: Array
    command: Array  # [C, J], rad
    measured_s: Array
    measured: Array  # [M, J], rad

    def held(self, times_s: Array) -> Array:
        """Return the command that is in force at times [T], [T, J]."""
        last = np.searchsorted(self.command_s, times_s, side="right") - 1
        return self.command[np.maximum(last, 0)]

    def part(self, start_s: float, seconds: float) -> "Recording":
        """Return a part of the recording, whose clock starts with its first measured sample."""
        keep = (self.measured_s >= start_s) & (self.measured_s < start_s + seconds)
        first_s = self.measured_s[keep][0]
        return Recording(
            self.name, self.command_s - first_s, self.command, self.measured_s[keep] - first_s, self.measured[keep]
        )


def recordings(trials: Sequence[Trial], joints: Sequence[str]) -> Iterator[Recording]:
    """Yield each recording of the trials once; its clock starts with the first measured sample."""
    for trial in {recording_of(trial): trial for trial in trials}.values():
        command, measured = trial.channel("command"), trial.channel("measured")
        start_s = measured.t_s[0]
        yield Recording(
            recording_of(trial),
            command.t_s - start_s,
            np.stack([command[name] for name in joints], axis=1),
            measured.t_s - start_s,
            np.stack([measured[name] for name in joints], axis=1),
        )


def joints_of(model: Any) -> list[str]:
    """Return the names of a model's joints in its order."""
    return [model.joint(i).name for i in range(model.njnt)]


def recording_of(trial: Trial) -> str:
    """Return the recording of a joint's trial."""
    return trial.name.partition("/")[0]
