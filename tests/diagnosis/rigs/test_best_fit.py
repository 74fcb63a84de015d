"""The effects that predict whole recordings of a stage best, named or not."""

from dataclasses import replace

import pytest

from softarm.diagnosis.rigs.best_fit import best_fit
from softarm.diagnosis.rigs.candidates import candidates, setup_of
from softarm.diagnosis.rigs.stage import examine, view_of
from tests.diagnosis.rigs.mjcf.test_model_attributes import ROBOT, changed, elbows, record
from tests.diagnosis.rigs.recordings import rms

LOOP = 'kp="30" kv="1.2" forcerange="-8 8"'


def test_whole_recordings_show_an_error_that_windows_hide(tmp_path):
    """A weak loop leaves the joint where friction holds it, and each window begins there."""
    weak = changed(LOOP, 'kp="2" kv="0.05" forcerange="-8 8"')
    record(weak, tmp_path / "motion.csv", seconds=5)
    view, _ = view_of(elbows(tmp_path, weak.replace('frictionloss="0.05"', 'frictionloss="0.15"')))
    windows, whole = (rms(each) for each in (view, view.uninterrupted()))
    assert whole > 1.4 * windows


@pytest.mark.slow
def test_the_best_fit_predicts_whole_recordings_and_not_windows(tmp_path):
    """Damping moves a joint between its windows' starts about as friction does, and lets it drift in the long run."""
    weak = changed(LOOP, 'kp="2" kv="0.05" forcerange="-8 8"')
    record(weak.replace('frictionloss="0.05"', 'frictionloss="0.15"'), tmp_path / "motion.csv", seconds=3)
    view, windows = view_of(elbows(tmp_path, weak))
    known = {each.name.partition(".")[2]: each for each in candidates(view)}
    sets = [(known["coulomb_friction"],), (known["damping"],), ()]
    begun = [(effects, tuple(each.starts[0] for each in effects)) for effects in sets]
    friction, damping, none = setup_of(view, windows.kinds, windows.origins).plain().fit(begun)
    better_in_windows = replace(damping, held_out=friction.held_out / 10)
    found = best_fit(view, windows, [better_in_windows, friction], none, {}, lambda path: "")
    assert "elbow.coulomb_friction.torque" in found.parameters
    assert found.after.value < 0.3 * found.before.value


def test_a_joint_that_nothing_holds_keeps_its_windows(tmp_path):
    free = changed(f"<position {LOOP} ctrlrange", "<motor ctrlrange").replace("<position", "<motor")
    free = free.replace("<option ", '<option gravity="0 0 0" ')
    record(free, tmp_path / "motion.csv", seconds=3)
    view, _ = view_of(elbows(tmp_path, free))
    assert view.uninterrupted() is view


# Over 3 s: a search over all effects, which finds none that is steady.
@pytest.mark.prove
def test_a_gap_without_a_steady_cause_has_a_best_fit(tmp_path):
    """The friction of each recording is another one."""
    for k, friction in enumerate((0.2, 0.3, 0.35)):
        record(changed('frictionloss="0.05"', f'frictionloss="{friction}"'), tmp_path / f"motion-{k}.csv", seconds=5)
    found = examine(elbows(tmp_path, ROBOT))
    assert (found.decision.kind, found.named) == ("unknown", ())
    assert "elbow.coulomb_friction.torque" in found.best_fit.parameters
    assert found.best_fit.after.value < 0.7 * found.answer.before
    assert any("--best-fit writes it" in text for text in found.warnings)


@pytest.mark.prove
def test_a_model_that_enlarges_the_gap_of_a_recording_is_no_best_fit(tmp_path):
    for k, friction in enumerate((0.3, 0.35, 0.4, 0.0)):
        record(changed('frictionloss="0.05"', f'frictionloss="{friction}"'), tmp_path / f"motion-{k}.csv", seconds=5)
    assert examine(elbows(tmp_path, ROBOT)).best_fit is None
