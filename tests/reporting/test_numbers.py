"""Formatting of numbers."""

import pytest

from softarm.reporting import numbers


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0612, "s", "61 ms"),
        (0.25, "s", "0.25 s"),
        (0.1, "-", "0.1"),
        (0.0, "m", "0 m"),
        (1234.5, "N", "1234 N"),
        (3e-7, "N", "3.0e-07 N"),
        (float("inf"), "kPa/s", "none"),
        (float("nan"), "m", "not known"),
    ],
)
def test_numbers_are_written_as_people_read_them(value, unit, text):
    assert numbers.quantity(value, unit) == text


@pytest.mark.parametrize(
    ("share", "text"), [(0.5, "50 %"), (0.001, "under 1 %"), (0.0, "0 %"), (-0.001, "0 %"), (float("nan"), "not known")]
)
def test_a_share_is_a_whole_percentage(share, text):
    assert numbers.percent(share) == text


def test_a_list_is_written_as_an_enumeration():
    assert numbers.listed(["a"]) == "a"
    assert numbers.listed(["a", "b", "c"], "or") == "a, b or c"
