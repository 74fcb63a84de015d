"""Tests of the thresholds: each fails if its threshold moves by a factor of two either way."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from softarm.diagnosis.engine.candidates import Candidate, FittedParameter
from softarm.diagnosis.engine.decision import Evidence, decide, is_cause, remainder
from softarm.diagnosis.engine.fits import Fit
from softarm.diagnosis.engine.search import Choice, Gain, Search, SelectedEffect
from softarm.diagnosis.engine.structure import Structure
from softarm.diagnosis.engine.thresholds import NEXT_TO_ANOTHER, RIG, ROBOT

PARAMETER = FittedParameter("arm.payload.mass", "kg", 0.0, 0.0, 10.0, 1.0, 0.0)
PAYLOAD = Candidate("arm.payload", "arm", (PARAMETER,), ((1.0,),))
CONSTANT = replace(PAYLOAD, constant=True)


def fit(*effects, scatter=0.0, drift=0.0):
    """Return a fit with the given scatter and drift of its effect's strength."""
    u = tuple((1.0,) for _ in effects)
    spread = scatter * np.sqrt(3 / 4)  # jackknife error of three folds
    folds = np.outer([1 - spread, 1.0, 1 + spread], np.ones(len(effects)))
    halves = np.outer([1 - drift / 2, 1 + drift / 2], np.ones(len(effects)))
    return Fit(effects, u, np.zeros(0), 0.0, np.zeros(1), folds, np.concatenate((folds, halves)))


def choice(before, after, effect=None, explained=0.0, scatter=0.0, drift=0.0):
    """Return the result of a search in one stage, with one chosen effect or none."""
    energies = {"arm": before}, {"arm": after}
    if effect is None:
        return Choice(fit(), (), fit(), (), energies)
    gain = Gain(100.0, 50.0, 150.0, {"arm": 0.9}, {"arm": explained})
    chosen = SelectedEffect(effect, fit(), gain, (), ())
    return Choice(fit(), (), fit(effect, scatter=scatter, drift=drift), (chosen,), energies)


def kind(t, before, after, flexible=1.0, explained=None, **evidence):
    """Return the verdict on one stage, with one steady effect or none."""
    found = choice(before, after) if explained is None else choice(before, after, PAYLOAD, explained)
    return decide(found, Evidence({"arm": flexible}, **evidence), t).kind


def named(t, before, after, flexible=0.0, effect=PAYLOAD, explained=None, bent=0.0, **steadiness):
    """Return whether an effect is a cause."""
    found = choice(before, after, effect, before - after if explained is None else explained, **steadiness)
    rest = remainder(found, Evidence({"arm": flexible}, bent={"arm": bent}), t)
    return is_cause(found.selected[0], found, rest, t)


def structure(energy):
    return {"structures": {"arm": Structure(energy, "near a reversal")}}


class Energies(Search):
    """Search without data: the energies of its fits are given."""

    def __init__(self, t, first=100.0, left=100.0):
        self.thresholds, self.stages = t, ("arm",)
        self.problem, self.left = SimpleNamespace(fit=lambda sets: [fit()]), {"arm": first}
        self.null_model()
        self.left = {"arm": left}
        acts = {"arm.payload.mass"}, {"rail.lag.time"}
        self.plain = SimpleNamespace(
            whitened=[SimpleNamespace(gaps=SimpleNamespace(view=SimpleNamespace(acts=each))) for each in acts]
        )

    def energies(self, fit):
        return self.left


def is_gain(t, value=1000.0, low=100.0, share=0.5, energy=50.0, first=100.0):
    return Energies(t, first).is_gain(Gain(value, low, 2 * value, {"arm": share}, {"arm": energy}))


def is_equivalent(t, lack, gain=1e6, rest=0.0):
    """Return whether a rival is an equivalent that is worse by a significant `lack` of held-out loss."""
    search = Energies(t)
    own = Gain(gain, gain / 2, 2 * gain, {"arm": 0.9}, {"arm": 90.0})
    search.gain = lambda less, more: own
    search.loss = lambda fit: rest + lack
    return search.is_equivalent(fit(), fit(PAYLOAD), replace(own, value=lack, low=0.9 * lack), own)


@pytest.mark.parametrize("removed", [0.08, 0.5, 90.0])
def test_a_rival_that_removes_as_little_energy_may_be_the_cause_as_well(removed):
    search = Energies(ROBOT)
    own = Gain(45.0, 35.0, 55.0, {"arm": 0.9}, {"arm": removed})
    search.gain = lambda less, more: own
    search.loss = lambda fit: 0.0
    same = replace(own, value=0.0, low=-0.1)
    assert search.is_equivalent(fit(), fit(PAYLOAD), same, own)
    search.gain = lambda less, more: replace(own, energies={"arm": 0.1 * removed})
    assert not search.is_equivalent(fit(), fit(PAYLOAD), same, own)


def is_correction(t, left):
    return Energies(t, left=left).is_correction(fit(), Gain(10.0, 5.0, 15.0, {"arm": 0.01}, {"arm": 0.5}))


def answered(t, explained):
    """Return the verdict on a small effect next to a large unexplained gap of another stage."""
    found = choice(1 + explained, 1.0, PAYLOAD, explained)
    energies = {"arm": 1 + explained, "rail": 101.0}, {"arm": 1.0, "rail": 101.0}
    return decide(replace(found, energies=energies), Evidence({"rail": 1.0}), t).kind


def beside_a_rest(t, scatter):
    """Return the verdict on an effect in a stage with a structure that nothing explains."""
    found = choice(1e6, 1e4, PAYLOAD, 1e6, scatter=scatter)
    return decide(found, Evidence(signs={"arm": Structure(1e4, "near a reversal")}), t).kind


def swinging(t, after):
    """Return the verdict on a swing with large linearisation errors."""
    return kind(t, 3000.0 + after, after, 0.0, 3000.0, bent={"arm": 1e9})


# Name -> threshold set, probe, and its arguments below and above the threshold, which give different answers.
PROBES = {
    "gain.ignored": (RIG, is_correction, 2.5, 6.0),
    "gain.loss_min": (ROBOT, lambda t, x: is_gain(t, x, x - 1), 6.0, 12.0),
    "gain.resolved_min": (ROBOT, lambda t, x: is_gain(t, x, x / 2, energy=0.01, first=0.02), 30.0, 60.0),
    "gain.further_min": (ROBOT, lambda t, x: is_gain(t, share=0.15, energy=x), 4.0, 9.0),
    "gain.further_share": (ROBOT, lambda t, x: is_gain(t, share=x, energy=1.0), 0.3, 0.6),
    "rival.lack_max": (ROBOT, lambda t, x: is_equivalent(t, x, gain=130.0), 7.0, 14.0),
    "rival.lack_share": (ROBOT, lambda t, x: is_equivalent(t, x, gain=1000.0), 30.0, 60.0),
    "rival.share_max": (ROBOT, lambda t, x: is_equivalent(t, 7.0, gain=x), 80.0, 40.0),
    "rival.misfit_share": (RIG, lambda t, x: is_equivalent(t, x, rest=1000.0), 180.0, 350.0),
    "cause.explained_min": (ROBOT, lambda t, x: named(t, 101.0, x, 1.0), 31.0, 8.0),
    "cause.answer_min": (ROBOT, answered, 7.0, 15.0),
    "cause.floor_share": (RIG, lambda t, x: named(t, 101.0, x, scatter=1.0), 6.0, 11.0),
    "cause.floor_most": (RIG, lambda t, x: named(t, 12000.0, x, scatter=1.0), 170.0, 320.0),
    "cause.rest_most": (RIG, lambda t, x: kind(t, 3000.0, x, 0.0, 3000.0 - x), 22.0, 42.0),
    "cause.bent_share": (RIG, swinging, 75.0, 110.0),
    "cause.explained_over": (RIG, lambda t, x: named(t, 1000.0, x), 71.0, 91.0),
    "cause.scatter_max": (ROBOT, lambda t, x: named(t, 1e6, 1e4, scatter=x), 0.045, 0.085),
    "cause.chance": (ROBOT, lambda t, x: named(t, 5.0, 1.1, scatter=x), 0.09, 0.14),
    "cause.constant_max": (ROBOT, lambda t, x: named(t, 1e6, 1e4, effect=CONSTANT, drift=x), 0.055, 0.1),
    "cause.beside_rest_max": (ROBOT, beside_a_rest, 0.03, 0.055),
    "gap.unknown_min": (ROBOT, lambda t, x: kind(t, x, x), 1.35, 1.7),
    "gap.random_share": (ROBOT, lambda t, x: kind(t, x, x, 0.0), 1.7, 2.5),
    "gap.structure_min": (ROBOT, lambda t, x: kind(t, 0.9, 0.9, **structure(x)), 0.7, 1.4),
    "gap.structure_share": (ROBOT, lambda t, x: kind(t, 101.0, 1.0, 0.0, 100.0, **structure(x)), 11.0, 21.0),
    "gap.tolerated_share": (RIG, lambda t, x: kind(t, 8.0, 8.0, tolerated={"arm": x}), 65.0, 34.0),
}


def moved(t, name, factor):
    group, _, field = name.partition(".")
    rule = getattr(t, group)
    return replace(t, **{group: replace(rule, **{field: factor * getattr(rule, field)})})


def test_an_effect_that_the_model_lacks_is_named_within_its_tolerance_if_noise_resolves_it():
    search, clear = Energies(ROBOT), Gain(60.0, 30.0, 90.0, {}, {})
    tolerated = replace(PARAMETER, tolerance=2.0)
    missing, calibrated = (replace(effect, parameters=(tolerated,)) for effect in (PAYLOAD, CONSTANT))
    assert search.is_nameable(fit(missing), clear)
    assert not search.is_nameable(fit(missing), replace(clear, value=20.0))
    assert not search.is_nameable(fit(calibrated), clear)
    assert search.is_nameable(fit(PAYLOAD), replace(clear, value=20.0))
    assert not Energies(RIG).is_nameable(fit(missing), clear)
    assert not Energies(NEXT_TO_ANOTHER).is_nameable(fit(missing), clear)
    assert Energies(NEXT_TO_ANOTHER).is_nameable(fit(PAYLOAD), clear)
    assert not search.is_nameable(fit(PAYLOAD, missing), clear)  # next to another effect on the same view
    other = replace(PAYLOAD, parameters=(replace(PARAMETER, path="rail.lag.time"),))
    assert search.is_nameable(fit(other, missing), clear)
    assert search.is_nameable(fit(missing, other), clear)
    assert not search.is_nameable(fit(other, calibrated), clear)


def test_a_change_within_tolerance_contests_only_effects_on_its_own_views():
    search, clear, larger = Energies(ROBOT), Gain(60.0, 30.0, 90.0, {}, {}), Gain(90.0, 60.0, 120.0, {}, {})
    calibrated = fit(replace(CONSTANT, parameters=(replace(PARAMETER, tolerance=2.0),)))
    on_rail = fit(replace(PAYLOAD, parameters=(replace(PARAMETER, path="rail.lag.time"),)))
    assert search.is_contested(fit(PAYLOAD), clear, [(calibrated, larger)])
    assert not search.is_contested(fit(PAYLOAD), larger, [(calibrated, clear)])
    assert not search.is_contested(on_rail, clear, [(calibrated, larger)])


def test_a_change_of_exactly_the_tolerance_is_within_it():
    assert not replace(PAYLOAD, parameters=(replace(PARAMETER, tolerance=1.0),)).exceeds_tolerance((1.0,))
    assert replace(PAYLOAD, parameters=(replace(PARAMETER, tolerance=1.0),)).exceeds_tolerance((1.001,))


@pytest.mark.parametrize("name", PROBES)
def test_a_threshold_lies_between_its_two_probes(name):
    t, probe, below, above = PROBES[name]
    assert probe(t, below) != probe(t, above)
    for factor in (0.5, 2.0):
        other = moved(t, name, factor)
        assert [probe(other, x) for x in (below, above)] != [probe(t, x) for x in (below, above)], factor


def test_every_threshold_has_probes():
    groups = ("gain", "rival", "cause", "gap")
    known = {f"{group}.{field}" for group in groups for field in type(getattr(ROBOT, group)).__slots__}
    assert known - {"gain.visible"} == set(PROBES)


@pytest.mark.parametrize("column", ["share", "energy", "low"])
@pytest.mark.parametrize(("row", "limits"), [(0, (0.10, 0.30, 0.0)), (1, (0.20, 0.10, 0.0)), (2, (0.10, 0.05, 10.0))])
def test_a_gain_must_be_visible_in_its_stage(row, limits, column):
    """Values above one row of limits are a gain; with one value below its limit they are not, unless noise does."""
    alone = replace(ROBOT, gain=replace(ROBOT.gain, visible=(ROBOT.gain.visible[row],), further_min=0.0))
    limits = dict(zip(("share", "energy", "low"), limits, strict=True))
    values = {name: max(1.2 * limit, 0.1) for name, limit in limits.items()}
    assert is_gain(alone, 30.0, **values)
    assert not is_gain(alone, 30.0, **values | {column: 0.8 * limits[column]})
