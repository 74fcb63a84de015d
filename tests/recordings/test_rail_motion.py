"""Commands and motion of the rail, read from a log of the daemon."""

import numpy as np
import pytest

from softarm.recordings import rail_motion
from softarm.schemas.config import Config


def test_a_log_contains_commands_and_their_effects(flight_file):
    motion = rail_motion.read(flight_file)
    assert motion.config == Config.model_validate(motion.config.model_dump())
    assert len(motion.sent_s) == len(motion.set_point_m_s) == len(motion.obeyed) > 200
    assert len(motion.t_s) == len(motion.position_m) == len(motion.velocity_m_s) > 200
    assert np.diff(motion.t_s).min() > 0
    assert np.median(np.diff(motion.sent_s)) == pytest.approx(1 / 30, abs=1e-6)
    # The drive was off before it was armed, and after the stop; it stood still there.
    assert not motion.obeyed[:30].any()
    assert 0.5 < motion.obeyed.mean() < 0.95
    assert not motion.set_point_m_s[~motion.obeyed].any()
    assert np.abs(motion.velocity_m_s).max() > 0.5


def test_readings_that_are_no_numbers_are_left_out_and_a_log_without_ticks_is_empty(killed):
    motion = rail_motion.read(killed)
    assert (len(motion.t_s), len(motion.sent_s), motion.config) == (29, 0, None)
