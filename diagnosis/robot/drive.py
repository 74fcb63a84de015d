"""Which law moves the cart, the model's tracker or a servo: the one that leaves clearly less of what the axis did.

They differ in any motion, by about what no simulator is blamed for (`views.FLOOR_M_S`); to take one for the other makes
of a lag a slower ramp, and of friction what nobody can explain.
"""

from collections.abc import Sequence

import numpy as np

from softarm.diagnosis.engine.candidates import Set, U
from softarm.diagnosis.engine.fits import ROUNDS
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.robot.candidates import candidates, nuisances
from softarm.diagnosis.robot.trial_grid import TrialGrid
from softarm.diagnosis.robot.views import RailView
from softarm.schemas.model import Model

SERVO = "rail.servo"
# RMS: what a servo must leave at the most of what the tracker leaves, everything else of the rail fitted beside either.
CLEARLY = 0.7
# What the motion itself shows: the rail's, but for what says where an encoder sits, and what pushes the cart.
_FREE = (
    "rail.acceleration_limit",
    "rail.force_limit",
    "rail.delay",
    "rail.lag",
    "rail.coulomb_friction",
    "arm.payload",
    "arm.tilt",
)


def driven(grid: TrialGrid, model: Model, kinds: Sequence[str]) -> Model:
    """The model, with `rail.servo` where the axis was moved by one; kinds: excitations of the trials."""
    view = RailView(grid, model)
    if SERVO in model.effects or not np.isfinite(view.measured).any():
        return model
    served = with_servo(model)
    tracked, following = (_left(each, kinds) for each in (view, RailView(grid, served)))
    return served if following < CLEARLY**2 * tracked else model


def with_servo(model: Model) -> Model:
    """The model, its cart driven by a servo."""
    return model.model_copy(update={"effects": model.effects | {SERVO: {}}})


def _left(view: RailView, kinds: Sequence[str]) -> float:
    """Squares that a law leaves at its best: each effect fitted alone, then all from each of those."""
    free = tuple(c for c in candidates(view.model) if c.name in _FREE)
    problem = Setup((view,), nuisances(view.model), kinds).plain()
    alone = problem.fit([((c,), (start,)) for c in free for start in c.starts])
    nominal = tuple(tuple(p.nominal for p in c.parameters) for c in free)
    begun: list[tuple[Set, U]] = [(free, nominal)]
    for i, c in enumerate(free):
        best = min((fit for fit in alone if fit.names == (c.name,)), key=lambda fit: fit.loss)
        begun.append((free, (*nominal[:i], best.u[0], *nominal[i + 1 :])))
    return min(fit.loss for fit in (*alone, *problem.fit(begun, rounds=2 * ROUNDS)))
