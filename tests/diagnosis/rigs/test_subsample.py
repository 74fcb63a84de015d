"""Stretches of long recordings that hold the most information."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine import work
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.rigs import subsample
from softarm.diagnosis.rigs.candidates import candidates, nuisances
from softarm.diagnosis.rigs.diagnose import diagnose_table
from softarm.diagnosis.rigs.grid import windows
from softarm.diagnosis.rigs.stage import view_of
from softarm.diagnosis.rigs.subsample import KIND_LEAST, Stretches, most_informative, within
from softarm.diagnosis.rigs.tracking import TrackingView
from tests.diagnosis.rigs.test_rigs import servo, tone

T = np.arange(0, 40, 0.02)


def recordings(quiet_s: float = 0.0) -> list[Trial]:
    """Return three kinds of healthy recordings of a servo; until `quiet_s` its command stands."""
    found, random = [], np.random.default_rng(1)
    for i, kind in enumerate(("multisine", "steps", "slow")):
        steps, slow = 0.15 * np.sign(np.sin(3 * T)), 0.2 * np.sin(2 * T)
        moved = {"multisine": tone(4 * T, i), "steps": steps, "slow": slow}[kind]
        command = np.where(quiet_s > T, 0.0, moved)
        seen = np.concatenate((command[:1], command[:-1])) + 1e-3 * random.normal(size=len(T))
        found.append(servo(command, seen, T, kind, kind))
    return found


def reduced(trials: list[Trial], share: float) -> tuple[Stretches, str] | None:
    """Return what a budget keeps that pays for a share of the data."""
    view, whole = view_of(trials)
    budget_s = share * subsample.planned_s(view, candidates(view)) / subsample.PLANNED
    return within(budget_s, view, whole)


def test_a_rare_effect_outweighs_more_of_the_same():
    found = np.array([[9.0, 0.0], [8.0, 0.0], [7.0, 0.0], [0.0, 1.0], [6.0, 0.0], [5.0, 0.0]])
    assert most_informative(found, np.ones(6), ["any"] * 6, 0.5) == [0, 1, 3]
    assert most_informative(found, np.ones(6), ["any"] * 6, 1.0) == list(range(6))


def test_every_kind_of_excitation_stays_for_the_held_out_data():
    found = np.array([[9.0], [8.0], [7.0], [6.0], [0.1], [0.2], [0.3]])
    kinds = ["fast"] * 4 + ["slow"] * 3
    kept = most_informative(found, np.ones(7), kinds, 0.01)
    assert [kinds[i] for i in kept] == ["fast"] * KIND_LEAST + ["slow"] * KIND_LEAST


def test_stretches_hold_every_sample_once_and_the_whole_input():
    trial = recordings()[0]
    parts = windows(trial, 6.0)
    assert len(parts) == len({part.name for part in parts}) == 7  # stretches of four blocks
    np.testing.assert_array_equal(np.concatenate([part.channels["measured"].t_s for part in parts]), T)
    assert all(part.channels["command"] is trial.channels["command"] for part in parts)


def test_a_budget_keeps_the_stretches_that_move():
    assert reduced(recordings(), 1.1) is None
    used, note = reduced(recordings(quiet_s=20.0), 0.4)
    late = [trial.channels["measured"].t_s[-1] > 20.0 for trial in used.trials]
    assert np.mean(late) > 0.9
    assert {used.origins[i] for i in range(len(late))} == {0, 1, 2}
    assert f"the {len(late)} most informative of " in note
    view = TrackingView(used.trials)
    setup = Setup([view], nuisances(view), [trial.kind for trial in used.trials], used.origins)
    assert setup.held_out == "kind"


def test_stretches_lie_in_both_halves_of_the_recordings_so_that_slow_changes_show():
    random = np.random.default_rng(2)
    found = []
    for i in range(3):
        command = np.where(T < 20, 1.0, 0.8) * tone(4 * T, i)  # the first half shows more of every effect
        seen = np.concatenate((command[:1], command[:-1])) + 1e-3 * random.normal(size=len(T))
        found.append(servo(command, seen, T, "multisine", f"multisine {i}"))
    kept, _ = reduced(found, 0.4)
    late = [part.channels["measured"].t_s.mean() > 20 for part in kept.trials]
    assert 0 < sum(late) < len(late)


def test_a_small_budget_takes_shorter_stretches_of_every_kind():
    used, note = reduced(recordings(), 0.15)
    samples = sum(len(trial.channels["measured"].t_s) for trial in used.trials)
    assert samples < 1.3 * 0.15 * 3 * len(T)
    assert "the fewest" not in note
    fewest, note = reduced(recordings(), 0.001)
    assert len(fewest.trials) == 3 * KIND_LEAST
    assert "these are the fewest of which some can be held out, and take about" in note


def test_the_chosen_effects_are_fitted_to_all_samples_that_the_budget_pays_for():
    view, whole = view_of(recordings())
    chosen = candidates(view)[:1]
    rollouts = work.full(len(chosen[0].parameters)) + work.reduced(1, len(chosen[0].parameters))
    assert subsample.for_sizes(1.1 * rollouts * view.rollout_s, view, whole, chosen) is whole
    some = subsample.for_sizes(0.4 * rollouts * view.rollout_s, view, whole, chosen)
    assert 0.25 < sum(len(trial.channels["measured"].t_s) for trial in some.trials) / (3 * len(T)) <= 0.4


def test_the_report_says_which_part_was_used():
    whole, part = (diagnose_table(recordings(), budget_s=budget_s).verdict for budget_s in (math.inf, 1.0))
    assert whole.verdict == part.verdict == "none"
    assert not whole.warnings
    (note,) = part.warnings
    assert "to keep its budget of 1 s" in note
    assert "--budget sets another" in note
    assert part.gap.before["servo"].value == pytest.approx(whole.gap.before["servo"].value, rel=1e-6)


# Over a minute of processor time: two searches next to a fault.
@pytest.mark.prove
def test_sizes_and_figures_come_from_all_samples():
    trials = []
    for trial in recordings():
        command = trial.channels["command"]["command"]
        follows = lfilter([0.0, 0.33], [1.0, -0.67], command - command[0]) + command[0]
        noise = 1e-3 * np.random.default_rng(2).normal(size=len(T))
        trials.append(servo(command, follows + noise, T, trial.kind, trial.kind))
    whole, part = (diagnose_table(trials, budget_s=budget_s).verdict for budget_s in (math.inf, 1.0))
    assert any("to keep its budget of 1 s" in note for note in part.warnings)
    assert part.gap.before["servo"].value == pytest.approx(whole.gap.before["servo"].value, rel=1e-6)
    (every,), (lag,) = ([e for e in v.effects if e.name == "servo.lag"] for v in (whole, part))
    for name, size in lag.parameters.items():
        assert size.value == pytest.approx(every.parameters[name].value, rel=1e-3)
        assert size.high - size.low == pytest.approx(every.parameters[name].high - every.parameters[name].low, rel=0.1)
