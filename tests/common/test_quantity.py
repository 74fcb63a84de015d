"""Quantities with unit and bounds, hints and suggestions."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from softarm.common.quantity import PURE, UNITS, Quantity, factor, shown
from softarm.common.words import did_you_mean, nearest

CONVERSIONS = [(unit, other, worth) for unit, others in UNITS.items() for other, worth in others.items()]
METRES, SECONDS = Quantity(unit="m", low=-0.3, high=0.3), Quantity(unit="s", low=0, high=0.2)
ONE_TO_TWO = {unit: Quantity(unit=unit, low=1.0, high=2.0) for unit in UNITS}


@pytest.mark.parametrize(
    ("allowed", "value", "said"),
    [
        (METRES, 250, "is 250; allowed -0.3 to 0.3 m; if you meant 250 mm, write 0.25"),
        (SECONDS, "33 ms", "is '33 ms'; allowed 0 to 0.2 s; write a bare number in s: 0.033"),
        (SECONDS, "33 m", "is '33 m'; allowed 0 to 0.2 s; write a bare number in s"),
        (SECONDS, "soon", "is 'soon'; allowed 0 to 0.2 s; write a bare number in s"),
        (Quantity(low=0, high=1), "50 %", "is '50 %'; allowed 0 to 1; write a bare number: 0.5"),
        (Quantity(low=0, above=True, high=1, unit="m/s"), 0, "is 0; allowed above 0, at most 1 m/s"),
        (Quantity(low=0, high=9, whole=True), 2.5, "is 2.5; allowed 0 to 9, a whole number"),
        (Quantity(low=100, whole=True), True, "is true; allowed 100 or more, a whole number"),
        (Quantity(unit="kPa", low=1, high=9, also=math.inf), math.nan, "is nan; allowed 1 to 9 kPa, or inf for none"),
        (Quantity(unit="rad", high=3), [3], "is a list; allowed at most 3 rad"),
        (Quantity(unit="N"), None, "is null; allowed a number in N"),
        (Quantity(low=0, high=1), 10**400, "is beyond 1e15; allowed 0 to 1"),
    ],
)
def test_a_rejected_value_has_its_sentence(allowed, value, said):
    assert not allowed.takes(value)
    assert allowed.complaint(value) == said


@given(st.sampled_from(CONVERSIONS), st.floats(1.0, 2.0))
def test_a_number_of_another_unit_is_converted_as_text(conversion, wanted):
    unit, other, worth = conversion
    message = ONE_TO_TWO[unit].complaint(f"{wanted / worth!r} {other}")
    if ONE_TO_TWO[unit].admits(float(f"{wanted:.6g}")):
        assert float(message.rpartition(": ")[2]) == pytest.approx(wanted, rel=1e-5)


@given(st.sampled_from(list(UNITS)), st.floats(-1e9, 1e9))
def test_every_suggested_value_is_allowed(unit, number):
    allowed = ONE_TO_TWO[unit]
    assume(not allowed.admits(number))
    _, said, meant = allowed.complaint(number).rpartition("write ")
    assert not said or allowed.admits(float(meant))


@given(st.floats(allow_nan=False), st.floats(allow_nan=False), st.booleans(), st.booleans(), st.floats())
def test_allowed_values_are_within_the_bounds(low, high, above, below, number):
    allowed = Quantity(low=low, high=high, above=above, below=below)
    within = low < number < high or (number == low <= high and not above) or (number == high >= low and not below)
    if low < high:
        assert allowed.admits(number) == within


def test_excluded_bounds_are_said_to_be_excluded():
    assert Quantity(low=0.0, high=1.0, above=True, below=True).bounds == "above 0, below 1"
    assert Quantity(high=1.0, below=True).bounds == "below 1"


def test_a_unit_is_in_the_table_once():
    names = [name for unit, others in UNITS.items() for name in (unit, *others)]
    assert len(names) == len(set(names))


@pytest.mark.parametrize(
    ("unit", "worth"),
    [
        ("s", (1.0, "s")),
        ("deg", (math.pi / 180, "rad")),
        ("1", (1.0, PURE)),
        ("mN m", (1e-3, "N m")),
        ("Nm", (1.0, "N m")),
        ("%", (1e-2, PURE)),
        ("counts", (1.0, "counts")),
        ("\N{MICRO SIGN}m", (1e-6, "m")),
        ("\N{DEGREE SIGN}/s", (math.pi / 180, "rad/s")),
        ("mV/s", (1e-3, "V/s")),
        ("deg/s^2", (math.pi / 180, "rad/s^2")),
    ],
)
def test_a_column_is_multiplied_by_the_factor_of_its_unit(unit, worth):
    assert factor(unit) == worth


def test_an_unknown_unit_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=r"no unit 'turns'; allowed .*, s, ms, us, ns, m, mm"):
        factor("turns")


@pytest.mark.parametrize(("written", "meant"), [("Kpa", "kPa"), ("pa", "Pa"), ("degree", "degrees")])
def test_a_unit_that_is_nearly_known_is_recognised(written, meant):
    with pytest.raises(ValueError, match=f"no unit '{written}'; did you mean .*{meant}.*\\? allowed"):
        factor(written)


def test_a_value_is_shown_as_a_file_would_have_it_and_no_longer_than_a_line():
    assert [shown(each) for each in (None, True, 3, 0.1 + 0.2, "a", {}, (1,))] == [
        "null",
        "true",
        "3",
        "0.3",
        "'a'",
        "a group",
        "a list",
    ]
    assert len(shown("x" * 10_000)) < 100
    assert str(Quantity(unit=PURE, low=0, high=1)) == "0 to 1"


def test_a_near_word_is_offered_and_a_far_one_is_not():
    assert did_you_mean("raech", ["reach", "hold"]) == "did you mean reach? "
    assert did_you_mean("zzz", ["reach", "hold"]) == ""


@given(st.sampled_from(["reach", "shelf", "hold"]), st.data())
def test_a_word_with_two_letters_swapped_is_found(word, data):
    at = data.draw(st.integers(0, len(word) - 2))
    assert nearest(word[:at] + word[at + 1] + word[at] + word[at + 2 :], ["reach", "shelf", "hold"]) == word
