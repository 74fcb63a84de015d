"""What a problem's folds leave out, as a report says it."""

import numpy as np
import pytest

from softarm.diagnosis.engine.problem import held_out_by


@pytest.mark.parametrize(
    ("fold", "kinds", "says"),
    [
        ([0, 0, 1, 1], ("steps", "chirp"), "kind"),
        ([0, 0, 1, 1], ("steps", "steps"), "trial"),  # the kind was seen
        ([0, 1, 0, 1], ("steps", "chirp"), "block"),
        ([0, 0, 1, 2], ("steps", "chirp"), "block"),  # of one of the trials
        ([0, 0, 0, 0], ("steps", "steps"), "block"),  # nothing is left out
    ],
)
def test_what_is_left_out_is_read_off_the_folds(fold, kinds, says):
    blocks = [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert held_out_by(blocks, np.array(fold), kinds) == says
