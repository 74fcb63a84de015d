"""Thresholds of the engine, grouped by the decision that they serve.

Energies are mean squares of a view's residual over its noise floor's: 1 is noise. Losses are weighted squares, about
four per second and view. `tests/diagnosis/engine/test_thresholds.py` fails if a threshold moves by a factor of two.
"""

from dataclasses import dataclass, field, replace
from math import inf
from typing import Final, Literal


@dataclass(frozen=True, slots=True)
class SearchBudget:
    """Extent and cost of the search for a set of effects."""

    rounds: int = 4  # Gauss-Newton rounds of a full fit
    rounds_rough: int = 2  # Gauss-Newton rounds of a first, rough fit
    candidates_max: int = 10  # candidates that get a full fit
    # A candidate whose rough gain is smaller than the best by more than this share gets no full fit.
    lag_share: float = 1.0
    # The loss has many small minima: fit few effects from their own starts as well, and all with wide differences.
    refit: bool = False
    restarts: int = 3  # repeats of a backward search, each without one more effect that ended at its bound
    # Held-out data of the search: the verdict's own (kinds, else trials), whole trials, or every fifth block.
    folds: Literal["held_out", "trial", "block"] = "held_out"


@dataclass(frozen=True, slots=True)
class GainRule:
    """Conditions on an effect that is added to the others."""

    ignored: float = 0.0  # energy of a gap that needs no effect
    loss_min: float = 8.0  # held-out gain
    # In one of its views: share of the residual's energy, energy, and lower end of the gain. A change within the floor
    # must be a visible part of the residual and beyond doubt.
    visible: tuple[tuple[float, float, float], ...] = ((0.10, 0.30, 0.0), (0.20, 0.10, 0.0), (0.10, 0.05, 10.0))
    # Held-out gain from which a visible share is enough, whatever its energy, and from which an effect that the model
    # lacks is named within its tolerance. Sixty healthy robots reach 29, by the lag of a tube.
    resolved_min: float = 40.0
    # Next to another effect: share of the whole gap's energy, or share of the energy that the other leaves. A
    # correction to another effect's law is no effect.
    further_min: float = 0.06
    further_share: float = 0.4

    def is_visible(self, share: float, energy: float, low: float) -> bool:
        """Return whether a share of a residual, its energy and the lower end of its gain are large enough to matter."""
        return any(share > s and energy > e and low > at_least for s, e, at_least in self.visible)


@dataclass(frozen=True, slots=True)
class RivalRule:
    """Conditions on a rival that may be the cause as well."""

    lack_max: float = 10.0  # held-out loss by which the rival may be worse
    # The same as a share of the effect's gain: laws of the robot differ from the model's. Wrong names lack 2.3 %, true
    # effects lead by 6 % and more.
    lack_share: float = 0.04
    share_max: float = 0.12  # share of the effect's gain by which a rival may be worse at most, however close its loss
    misfit_share: float = 0.0  # the same as a share of the loss that the best fit leaves


@dataclass(frozen=True, slots=True)
class CauseRule:
    """Conditions on an effect that is named as a cause."""

    explained_min: float = 0.85  # share of the explainable energy of its stage
    answer_min: float = 0.1  # share of all explainable energy that the named effects explain together
    # Next to a rest that is this share of the removed energy, but at most `floor_most`, the strength may vary.
    floor_share: float = 0.0
    floor_most: float = inf
    # Energy that may remain next to a name, and the share of the removed energy that linearisation errors may add.
    # With more, each effect must explain more than the rest, and `explained_over` of its stage.
    rest_most: float = inf
    bent_share: float = 0.01
    explained_over: float = 0.96
    # Largest relative difference of the strength between excitations, and half of that between halves of the trials.
    # Chance adds its share over the root of the explained energy.
    scatter_max: float = 0.06
    chance: float = 0.10
    # The same, both together and without chance, for a parameter that the model has already. Wrong parameters of 52
    # robots show up to 0.046; an arm that softens and a muscle that tires, taken for constants, 0.15 and more.
    constant_max: float = 0.08
    # The same for an effect next to an unexplained rest in its stage: a stiction, taken for dry friction, varies more.
    beside_rest_max: float = 0.04


@dataclass(frozen=True, slots=True)
class GapRule:
    """Conditions on a residual that needs a cause."""

    unknown_min: float = 0.5  # explainable energy
    # Explainable share of a residual, at least: no model finds changes that are random from tick to tick.
    random_share: float = 0.5
    # Structure: energy of its strongest finding, and share of the energy that effects and nuisances remove.
    structure_min: float = 1.0
    structure_share: float = 0.15
    # Share of the energy removed by nuisances and effects that may remain without a cause, up to `rest_most`.
    tolerated_share: float = 0.0


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Thresholds of one kind of system; a rig overrides only what was measured to be necessary."""

    search: SearchBudget = field(default_factory=SearchBudget)
    gain: GainRule = field(default_factory=GainRule)
    rival: RivalRule = field(default_factory=RivalRule)
    cause: CauseRule = field(default_factory=CauseRule)
    gap: GapRule = field(default_factory=GapRule)
    # The model's laws only approximate the system and have kinks: search backwards from all effects, simulate
    # held-out losses, temper large ones, do not whiten, widen the intervals, and judge all effects together.
    approximate: bool = False


ROBOT: Final = Thresholds()

# Next to an effect that was measured from stamps and noise, the search's own effect is not the only one: a change
# within tolerance may correct the sampling's law.
NEXT_TO_ANOTHER: Final = replace(ROBOT, gain=replace(ROBOT.gain, resolved_min=inf))

# A rig is cheap to simulate and has few candidates, so the search starts from all of them: dry friction and drag only
# replace a viscous fit together. Its floor is the step of its encoder, so what may remain is a share of what the best
# fit leaves. Blocks are held out, since one fast part of a sweep may be the only one that shows a torque limit.
RIG: Final = Thresholds(
    SearchBudget(rounds=12, rounds_rough=3, candidates_max=6, lag_share=0.5, folds="block"),
    GainRule(ignored=4.0, visible=((0.10, 0.30, 0.0),), resolved_min=inf, further_min=0.0),
    RivalRule(lack_share=0.0, misfit_share=0.25),
    # A tiring motor, taken for a weak one, leaves an energy of 27 and varies; an unlisted spring leaves 196 or more.
    CauseRule(floor_share=0.07, floor_most=225.0, rest_most=15.0),
    # Healthy rigs show 1.4 to 3.4 floors (a driven mass 6, a chain 9), unknown causes ten and more.
    GapRule(unknown_min=4.0, structure_min=16.0, structure_share=0.25, tolerated_share=0.15),
    approximate=True,
)

# If each window's start is fitted, parts of a trial are not independent.
WINDOWED: Final = replace(RIG, search=replace(RIG.search, folds="trial"))
