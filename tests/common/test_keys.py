"""Keys of a schema: names, allowed values, units and defaults."""

import pytest

from softarm.common.keys import find, leaves
from softarm.schemas.config import Config
from softarm.schemas.model import Model
from softarm.schemas.trial import StageFile, TrialFile


def test_every_key_can_be_found_by_its_path_and_has_something_to_say():
    for key in leaves(Config):
        assert find(Config, key.path) == key
        assert key.allowed
    assert find(Config, ("limits", "rail", "nonsense")) is None
    assert find(Config, ("policies", "mine", "plugin")).allowed == "a text"


def test_every_key_whose_name_ends_in_a_unit_says_so():
    units = {key.name: key.unit for key in leaves(Config)}
    assert units["limits.rail.braking_m_s2"] == "m/s^2"
    assert units["limits.pressure.slew_max_kpa_s"] == "kPa/s"
    assert units["drivers.rail.units_per_m"] == "1/m"
    assert units["failsafe.arming_frames"] == ""


@pytest.mark.parametrize(
    ("schema", "path", "allowed"),
    [
        (StageFile, ("trials", 2, "name"), "a text or null"),
        (StageFile, ("channels", "measured", "columns", "angle1", "row"), "0 or more, a whole number"),
        (StageFile, ("elements", "servo1"), "0 or more, a whole number"),
        (StageFile, ("model", "lag_s"), "a number or a text or a list in s"),
        (StageFile, ("trials",), "a list"),
        (TrialFile, ("rail",), "'free' or 'held'"),
        (Model, ("arm", "link_mass_kg", 3), "above 0"),
        (Model, ("effects",), "a group of names of your choice"),
    ],
)
def test_a_key_within_lists_and_named_groups_is_found(schema, path, allowed):
    assert find(schema, path).allowed == allowed


def test_a_path_without_a_key_is_not_found():
    assert find(StageFile, ("trials", 0, "nme")) is None
    assert find(TrialFile, ("kind", "deeper")) is None
