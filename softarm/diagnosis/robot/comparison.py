"""Comparison of the robot's trials with a nominal model: grid, views, and the tip simulated from commands."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.engine.whitened import Cache
from softarm.diagnosis.engine.work import Progress
from softarm.diagnosis.robot.candidates import nuisances
from softarm.diagnosis.robot.chain import tip_gap
from softarm.diagnosis.robot.drive import with_identified_drive
from softarm.diagnosis.robot.trial_grid import TrialGrid, on_grid
from softarm.diagnosis.robot.views import RobotView, robot_views
from softarm.schemas.model import Model

Gap = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Trials of the robot next to a nominal model."""

    trials: tuple[Trial, ...]
    nominal: Model
    model: Model  # the nominal model, with the drive that the trials show
    grid: TrialGrid
    views: tuple[RobotView, ...]
    setup: Setup
    tips: Cache[Gap]

    @property
    def stages(self) -> tuple[str, ...]:
        """Return the stages that the trials show."""
        return tuple(view.stage for view in self.views)

    def held_out(self, gaps: NDArray[np.floating]) -> Gap:
        """Return each sample's gap [M, S] from gaps by fold [F, M, S]: the one whose fit did not use the sample."""
        own = self.setup.by_sample(self.views[0], np.unique(self.setup.fold, return_inverse=True)[1])
        return np.asarray(gaps[own, np.arange(len(own))])

    def tip_gaps(self, points: Sequence[Point]) -> Gap:
        """Return measured minus simulated tip (y, z), from commands alone, at each point, m, [P, M, 2]."""
        return np.stack(self.tips.fetch([tuple(sorted(point.items())) for point in points]))

    def squares(self, gap: NDArray[np.floating]) -> Array:
        """Return the squares of a gap [M, S] by trial, [K], or by block if there is only one trial."""
        part, count = self.grid.sample[1], len(self.trials)
        if count < 2:
            count = len(self.setup.blocks)
            part = self.setup.by_sample(self.views[0], np.arange(count))
        return np.array([np.nansum(gap[part == k].astype(float) ** 2) for k in range(count)])


def compare(trials: Sequence[Trial], nominal: Model, progress: Progress) -> Comparison:
    """Prepare the comparison of trials with a nominal model; raise TrialError if no stage can be compared."""
    progress("resampling the trials", 0.02)
    grid = on_grid(trials, nominal)
    kinds = [trial.kind for trial in trials]
    model = with_identified_drive(grid, nominal, kinds)
    views = robot_views(grid, model)
    if not views:
        raise TrialError(f"{trials[0].source}: no stage can be compared; record pressure, rail or mocap as well")
    progress("simulating each stage alone", 0.08)
    setup = Setup(views, nuisances(model), kinds)
    if len(setup.blocks) < 2:
        raise TrialError(
            f"{trials[0].source}: is one trial of 2 s, which leaves no held-out part; longer than that is needed; "
            "record longer, or add a second trial"
        )
    tips = Cache(lambda keys: tip_gap(grid, model, [dict(key) for key in keys]))
    return Comparison(tuple(trials), nominal, model, grid, views, setup, tips)
