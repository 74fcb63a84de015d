"""The next recording of a rig: the motion that separates effects which fit the data equally well."""

from collections.abc import Sequence
from itertools import combinations

from softarm.diagnosis.rigs.views import RigView
from softarm.schemas.verdict import NextExperiment

NOTHING = "no experiment in the list separates these"


def splitting(view: RigView, answers: Sequence[Sequence[str]]) -> NextExperiment | None:
    """Return the experiment for the first answer whose names a motion can separate, or None without such answers.

    Only answers with several names need an experiment.
    """
    proposals = [between(view, names) for names in answers if len(names) > 1]
    return next((each for each in proposals if each.expect), proposals[0] if proposals else None)


def between(view: RigView, names: Sequence[str]) -> NextExperiment:
    """Return the experiment that separates the first separable pair of these effects."""
    effects = {effect.name: effect for effect in view.effects}
    for one, other in combinations(names, 2):
        experiment = effects[one].separated_by.get(other, "") if one in effects else ""
        if experiment:
            motion, _, sign = experiment.partition(": ")
            expect = dict.fromkeys((one, other), sign or "the two answer it differently")
            return NextExperiment(excitation=motion, separates=(one, other), expect=expect)
    return NextExperiment(excitation=NOTHING, separates=tuple(names), expect={})
