"""Suggestions for misspelled words."""

from hypothesis import given
from hypothesis import strategies as st

from softarm.common.words import did_you_mean, nearest


def test_a_near_word_is_offered_and_a_far_one_is_not():
    assert did_you_mean("raech", ["reach", "hold"]) == "did you mean reach? "
    assert did_you_mean("zzz", ["reach", "hold"]) == ""


@given(st.sampled_from(["reach", "shelf", "hold"]), st.data())
def test_a_word_with_two_letters_swapped_is_found(word, data):
    at = data.draw(st.integers(0, len(word) - 2))
    assert nearest(word[:at] + word[at + 1] + word[at] + word[at + 2 :], ["reach", "shelf", "hold"]) == word
