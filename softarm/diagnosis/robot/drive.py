"""Identification of the cart's drive: the model's tracker or a servo, by the smaller residual of the axis.

The two laws differ by about the noise floor (`views.FLOOR_M_S`) in any motion. The wrong law turns a lag into a slower
ramp, and friction into an unknown effect.
"""

from collections.abc import Sequence

import numpy as np

from softarm.diagnosis.engine.candidates import Coordinates, EffectSet
from softarm.diagnosis.engine.fits import ROUNDS
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.robot.candidates import candidates, nuisances
from softarm.diagnosis.robot.trial_grid import TrialGrid
from softarm.diagnosis.robot.views import RailView
from softarm.schemas.model import Model

SERVO = "rail.servo"
# Largest RMS residual of a servo, relative to the tracker's; all other effects of the rail are fitted with either.
CLEARLY = 0.7
# Effects that the motion itself shows: those of the rail without assumptions on its encoder, and loads on the cart.
_FREE = (
    "rail.acceleration_limit",
    "rail.force_limit",
    "rail.delay",
    "rail.lag",
    "rail.coulomb_friction",
    "arm.payload",
    "arm.tilt",
)


def with_identified_drive(grid: TrialGrid, model: Model, kinds: Sequence[str]) -> Model:
    """Return the model, with `rail.servo` if the trials show a servo; kinds: excitation of each trial."""
    view = RailView(grid, model)
    if SERVO in model.effects or not np.isfinite(view.measured).any():
        return model
    served = with_servo(model)
    tracked, following = (_left(each, kinds) for each in (view, RailView(grid, served)))
    return served if following < CLEARLY**2 * tracked else model


def with_servo(model: Model) -> Model:
    """Return the model with a servo on its cart."""
    return model.model_copy(update={"effects": model.effects | {SERVO: {}}})


def _left(view: RailView, kinds: Sequence[str]) -> float:
    """Return the smallest loss of a law, with each effect fitted alone and all from each of those."""
    free = tuple(c for c in candidates(view.model) if c.name in _FREE)
    problem = Setup((view,), nuisances(view.model), kinds).plain()
    alone = problem.fit([((c,), (start,)) for c in free for start in c.starts])
    nominal = tuple(tuple(p.nominal for p in c.parameters) for c in free)
    begun: list[tuple[EffectSet, Coordinates]] = [(free, nominal)]
    for i, c in enumerate(free):
        best = min((fit for fit in alone if fit.names == (c.name,)), key=lambda fit: fit.loss)
        begun.append((free, (*nominal[:i], best.u[0], *nominal[i + 1 :])))
    return min(fit.loss for fit in (*alone, *problem.fit(begun, rounds=2 * ROUNDS)))
