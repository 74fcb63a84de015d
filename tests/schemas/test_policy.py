"""The observation: one order for files, logs and arrays."""

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from softarm.schemas.policy import OBSERVATION, Observation, places

SEEN = Observation(0.1, -0.2, -0.3, 0.6, 1.0, -1.0, 0.5, 12.5)


def test_the_fields_are_the_signals_with_their_units():
    suffixes = {"m": "m", "m/s": "m_s", "kPa": "kpa"}
    assert Observation._fields == tuple(f"{signal.name}_{suffixes[signal.unit]}" for signal in OBSERVATION)


def test_places_find_fields_in_an_array_of_it():
    array = np.array(SEEN, dtype=np.float32)
    np.testing.assert_allclose(array[places("tip_y_m", "tip_z_m")], (SEEN.tip_y_m, SEEN.tip_z_m))
    with pytest.raises(ValueError, match="tuple"):
        places("tip")


def test_a_log_keeps_it_as_a_bare_array_and_reads_it_back():
    adapter = TypeAdapter(Observation)
    text = adapter.dump_json(SEEN)
    assert text == b"[0.1,-0.2,-0.3,0.6,1.0,-1.0,0.5,12.5]"
    assert adapter.validate_json(text) == SEEN
    assert isinstance(adapter.validate_json(text), Observation)


@pytest.mark.parametrize("count", [7, 9])
def test_an_array_of_another_length_is_refused(count):
    with pytest.raises(ValidationError):
        TypeAdapter(Observation).validate_python([0.0] * count)
