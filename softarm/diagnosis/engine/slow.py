"""Slow changes: a fitted strength that drifts within the trials or from trial to trial.

Warming, wear and fatigue change a parameter that the model holds constant. Each fitted parameter gets a linear change
over time, or one that settles exponentially in every trial. The change is judged like a further effect, on the
linearisation of the fit, without any simulation.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from softarm.diagnosis.engine.candidates import parameters_of
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.search import Search
from softarm.diagnosis.engine.structure import Structure
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.engine.whitened import blocks_of

TRIALS_LEAST = 4  # recordings that can show a trend from trial to trial
SETTLING = (0.06, 0.2)  # time constants of a settling change, in lengths of the longest trial
RIDGE = 1e-9  # of the largest diagonal entry


@dataclass(frozen=True, slots=True)
class Slow:
    """Change of a fit's unknowns in proportion to a clock that goes from -1 to 1."""

    name: str  # of the parameter
    nuisance: bool
    direction: Array  # [n]
    clock: Array  # [B]
    when: str  # time over which the parameter changes, in words


class Linear:
    """Linearisation of a problem at a fit; a nuisance is known to about the edges of its box."""

    def __init__(self, problem: FitProblem, fit: Fit) -> None:
        self.fold, count = problem.fold, len(problem.nuisance_low)
        self.normal, self.slope, low, high = problem.linear(fit)
        self.squares = problem.block_squares(fit.point)
        self.free = np.append(high > low, True)
        self.held = np.append(np.zeros(len(low) - count), np.ones(count))

    def grown(self, slow: Slow | None) -> tuple[Array, Array]:
        """Return normal matrices [B, n + 1, n + 1] and slopes [B, n + 1]; the last unknown is the slow change."""
        change = np.zeros_like(self.slope) if slow is None else slow.clock[:, None] * slow.direction
        across = np.einsum("bij,bj->bi", self.normal, change)
        normal = np.pad(self.normal, ((0, 0), (0, 1), (0, 1)))
        normal[:, :-1, -1] = normal[:, -1, :-1] = across
        normal[:, -1, -1] = np.einsum("bi,bi->b", across, change)
        return normal, np.append(self.slope, np.einsum("bi,bi->b", self.slope, change)[:, None], axis=1)

    def solve(self, normal: Array, slope: Array) -> Array:
        """Return the unknowns [n + 1] that fit the blocks with these sums best."""
        kept = self.free & (normal.diagonal() > 0)
        matrix = normal[np.ix_(kept, kept)] + np.diag(np.append(self.held, 0.0)[kept])
        matrix += RIDGE * matrix.diagonal().max(initial=0.0) * np.eye(len(matrix))
        solution = np.zeros(len(kept))
        solution[kept] = np.linalg.solve(matrix, -slope[kept])
        return solution

    def loss(self, slow: Slow | None, x: Array | None = None) -> tuple[float, Array]:
        """Return the loss of all blocks at the unknowns x [n + 1], by default those that fit best, and the unknowns."""
        normal, slope = (sums.sum(axis=0) for sums in self.grown(slow))
        x = self.solve(normal, slope) if x is None else x
        return float(self.squares.sum() + (2 * slope + normal @ x) @ x), x

    def held_out(self, slow: Slow | None) -> Array:
        """Return each block's loss after a fit without its fold, [B]."""
        normal, slope = self.grown(slow)
        lost = np.empty(len(self.fold))
        for fold in np.unique(self.fold):
            out = self.fold == fold
            x = self.solve(normal[~out].sum(axis=0), slope[~out].sum(axis=0))
            lost[out] = self.squares[out] + (2 * slope[out] + normal[out] @ x) @ x
        return lost


def slow_changes(setup: Setup, search: Search, fit: Fit) -> dict[str, Structure]:
    """Return the strongest slow change next to a fit, by the stage that shows it; empty if it may be chance.

    The rules of the search for a further effect hold here.
    """
    linear = Linear(search.problem, fit)
    before, constant = linear.loss(None)
    options = [(slow, *linear.loss(slow)) for slow in _options(setup, linear, fit)]
    if not options:
        return {}
    slow, _, moved = max(options, key=lambda each: before - each[1])
    less, more = (replace(fit, held_out=linear.held_out(each)) for each in (None, slow))
    gain, rule = search.gain(less, more), search.thresholds.gain
    energies = {}
    for stage, residual in zip(search.stages, search.plain.whitened, strict=True):
        view = Linear(replace(search.plain, whitened=(residual,)), fit)
        squares = view.loss(None, constant)[0], view.loss(slow, moved)[0]
        energies[stage] = [each / max(residual.kept, 1.0) for each in squares]
    stage, (left, rest) = max(energies.items(), key=lambda each: each[1][0] - each[1][1])
    tolerated = slow.nuisance and 2 * abs(moved[-1]) < 1  # from the start to the end less than the edge of a box
    # Next to a large rest, a slow change of an approximate law may stand in for any other error of the law.
    least = max(rule.ignored, rule.further_share * left) if search.thresholds.approximate else rule.ignored
    if tolerated or gain.value <= rule.loss_min or left - rest <= least:
        return {}
    if not rule.is_visible(1 - rest / left, left - rest, gain.low):
        return {}
    return {stage: Structure(left - rest, _in_words(setup, fit, slow, moved))}


def _options(setup: Setup, linear: Linear, fit: Fit) -> Iterator[Slow]:
    """Yield a change of every fitted parameter, and of all joints together, over every clock."""
    effects = [d.path for d in parameters_of(fit.effects)]
    names = [*effects, *(path for path, *_ in setup.nuisance_scales())]
    directions: dict[tuple[str, bool], Array] = {}
    for i, row in enumerate(np.eye(len(names))):
        if not linear.free[i]:
            continue
        together, joint, _ = names[i].partition("[")
        directions[names[i], i >= len(effects)] = row
        if joint:
            directions[together, True] = directions.get((together, True), np.zeros(len(names))) + row
    for when, clock in _clocks(setup).items():
        for (name, nuisance), direction in directions.items():
            yield Slow(name, nuisance, direction, clock, when)


def _clocks(setup: Setup) -> dict[str, Array]:
    """Return clocks, by their words: each block's time from -1 to 1, [B], in its recording or over all recordings."""
    origins, at = setup.origins, {}
    for view in setup.views:
        for name, a, b in blocks_of(view, setup.block_s):
            at[name] = float(view.t_s[a] + view.t_s[b - 1]) / 2
    number = np.array([origins[trial] for trial, _ in setup.blocks])
    time_s = np.array([at[name] for name in setup.blocks])
    for origin in set(origins):
        time_s[number == origin] -= time_s[number == origin].min()
    time = time_s / max(time_s.max(), 1e-9)
    found = {"within the trials": 2 * time - 1}
    for share in SETTLING:
        settled = np.expm1(-time / share) / np.expm1(-1 / share)
        found[f"within the trials, mostly in their first {2 * share * time_s.max():.2g} s"] = 2 * settled - 1
    if len(set(origins)) >= TRIALS_LEAST:
        found["from the first trial to the last"] = 2 * number / number.max() - 1
    return found


def _in_words(setup: Setup, fit: Fit, slow: Slow, moved: Array) -> str:
    """Return which parameter changes from what to what, in the registry's unit; of joints, the relative change."""
    change = float(moved[-1])
    i = int(np.flatnonzero(slow.direction)[0])
    parameters = parameters_of(fit.effects)
    if i < len(parameters):
        ends = [parameters[i].value(float(fit.x[i]) + float(moved[i]) + sign * change) for sign in (-1, 1)]
    else:
        path, nominal, scale = setup.nuisance_scales()[i - len(parameters)]
        if "[" in path:
            return f"{slow.name} changes by {200 * change * scale:+.2g} % {slow.when}"
        ends = [nominal + (float(moved[i]) + sign * change) * scale for sign in (-1, 1)]
    return f"{slow.name} changes from {ends[0]:.3g} to {ends[1]:.3g} {slow.when}"
