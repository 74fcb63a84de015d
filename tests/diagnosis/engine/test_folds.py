"""Tests of the folds of held-out data."""

import pytest

from softarm.diagnosis.engine.problem import folds, held_out, interleaved

BLOCKS = [(trial, number) for trial in range(3) for number in range(10)]


@pytest.mark.parametrize(
    ("kinds", "origins", "says"),
    [
        (("steps", "chirp", "steps"), (0, 1, 2), "kind"),
        (("steps", "steps", "steps"), (0, 1, 2), "trial"),
        (("steps", "steps", "steps"), (0, 0, 0), "block"),  # three windows of one recording
    ],
)
def test_whole_kinds_are_left_out_else_whole_recordings_else_stretches(kinds, origins, says):
    found = folds(BLOCKS, kinds, origins)
    assert held_out(kinds, origins) == says
    whole = {"kind": kinds, "trial": origins}.get(says)
    if whole is None:
        assert len(set(found)) == 5
        return
    together = {(whole[trial], int(fold)) for (trial, _), fold in zip(BLOCKS, found, strict=True)}
    assert len(together) == len(set(whole)) == len(set(found))


def test_many_recordings_are_left_out_a_few_at_a_time():
    blocks = [(trial, 0) for trial in range(20)]
    found = folds(blocks, ("steps",) * 20, range(20))
    assert len(set(found)) == 6
    assert sorted(found) == list(found)  # neighbours together


def test_interleaved_folds_hold_a_part_of_every_trial():
    found = interleaved(BLOCKS)
    for trial in range(3):
        assert len({int(f) for (t, _), f in zip(BLOCKS, found, strict=True) if t == trial}) == 5
