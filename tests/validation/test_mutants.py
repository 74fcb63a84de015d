"""Mutants of the safety code: a test detects each, or the list explains why none is needed."""

import pytest

from validation.mutants import explained
from validation.mutants.__main__ import prove
from validation.mutants.operators import mutants
from validation.mutants.targets import TARGETS, Target
from validation.mutants.trials import FailsUnchanged, trials

# Its tests need neither sockets nor a clock.
SMOKE = "daemon/control/following.py"
THING = "def clip(x, top):\n    while x > top:\n        x = x - 1\n    return x\n"


@pytest.mark.parametrize("module", TARGETS)
def test_every_explained_mutant_still_exists(module):
    keys = [mutant.key for mutant in mutants(TARGETS[module].source)]
    assert len(set(keys)) == len(keys)
    assert explained.read().get(module, {}).keys() <= set(keys)


# Over 3 s: the tests of a module run three times, in processes of their own.
@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_sample_of_mutants_is_killed_or_explained():
    found = prove(TARGETS[SMOKE], jobs=1, sample=1)
    assert found.figures["tried"] == 1
    assert found.unexplained == []


@pytest.fixture
def tried(tmp_path):
    def run(expected):
        (tmp_path / "thing.py").write_text(THING)
        test = f"from thing import clip\ndef test_clip():\n    assert [clip(x, 2) for x in (1, 2, 5)] == {expected}\n"
        (tmp_path / "test_thing.py").write_text(test)
        target = Target("thing.py", ("test_thing.py",), tmp_path, package="")
        return {str(each.mutant): each.end for each in trials(target, mutants(THING), jobs=2, slack_s=0.2)}

    return run


# Over 3 s: waits for mutants that never end.
@pytest.mark.slow
def test_a_good_test_kills_every_mutant_and_one_that_never_ends_is_ended(tried):
    found = tried([1, 2, 2])
    assert set(found.values()) == {"killed", "timed out"}
    assert found["clip: x = x - 1  ->  pass"] == "timed out"


@pytest.mark.slow
def test_tests_that_already_fail_do_not_judge_mutants(tried):
    with pytest.raises(FailsUnchanged, match=r"thing.py: its tests fail without a change"):
        tried([1, 2, 3])
