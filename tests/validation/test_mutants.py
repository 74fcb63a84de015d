"""Mutants of the safety code: a test detects each, or the list explains why none is needed."""

import pytest
from click.testing import CliRunner

from validation.mutants import __main__ as command
from validation.mutants import explained
from validation.mutants.operators import mutants, mutated
from validation.mutants.targets import TARGETS, Target
from validation.mutants.trials import FailsUnchanged, trials

SAMPLE = 3  # mutants of a module; all of them: `make prove`
EXPLAINED = explained.read()


# The modules

SMOKE = "drivers/regulator/cobs.py"  # tried in every test run; `make prove` tries all modules


@pytest.mark.parametrize("module", TARGETS)
def test_every_explained_mutant_still_exists(module):
    assert explained.stale(EXPLAINED, module, mutants(TARGETS[module].source)) == []


def test_the_list_speaks_of_modules_that_are_mutated_and_of_each_mutant_once():
    assert {each.module for each in EXPLAINED} <= TARGETS.keys()
    named = [(each.module, each.key) for each in EXPLAINED]
    assert len(set(named)) == len(named)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "module", [name if name == SMOKE else pytest.param(name, marks=pytest.mark.prove) for name in TARGETS]
)
def test_a_sample_of_mutants_is_killed_or_explained(module):
    found = command.prove(TARGETS[module], EXPLAINED, 1, command.Choice(SAMPLE))
    assert len(found.trials) == SAMPLE
    assert found.unexplained == []


# The changes


@pytest.mark.parametrize(
    ("was", "instead"),
    [
        ("x < y", {"x <= y", "x >= y"}),
        ("x is None", {"x is not None"}),
        ("x in y", {"x not in y"}),
        ("x + y", {"x - y"}),
        ("x * y", {"x / y"}),
        ("x << y", {"x >> y"}),
        ("x and y and z", {"x or y or z", "x and y", "y and z", "x and z"}),
        ("not x", {"x"}),
        ("-x", {"x"}),
        ("abs(x)", {"x"}),
        ("min(x, y)", {"max(x, y)"}),
        ("math.ceil(x)", {"math.floor(x)"}),
        ("x if y else z", {"x if not y else z"}),
        ("[x for x in y if x.z]", {"[x for x in y if not x.z]"}),
        ("f(7)", {"f(8)", "f(6)"}),
        ("f(0)", {"f(1)"}),
        ("f(0.5)", {"f(1.0)", "f(0.25)"}),
        ("f(True)", {"f(False)"}),
        ("f('reach')", {"f('mutant')"}),
        ("f('a sentence')", set()),
        ("f(f'{x} apart')", set()),
    ],
)
def test_each_kind_of_mutation_is_made(was, instead):
    assert {each.now for each in mutants(f"value = {was}\n")} == {f"value = {now}" for now in instead}


SOURCE = '''"""A module."""

LIMITS = {"low": Rule(True), "high": Rule(True)}

class Thing:
    """Has a number."""

    def __init__(self, number: int = 3) -> None:
        self.number = number

    def step(self, by):
        """Take a step."""
        if by.small:
            return
        by = by.whole
        self.number += by.size
        match by.kind:
            case "up":
                self.go()
        raise ValueError(f"cannot go {by.size * self.number} steps")
'''


def test_messages_and_types_are_not_mutated():
    found = {(each.function, each.was, each.now) for each in mutants(SOURCE)}
    assert {was for function, was, now in found if now == "pass"} == {
        "self.number = number",
        "return",
        "by = by.whole",
        "self.number += by.size",
        "self.go()",
        "raise ValueError(f'cannot go {by.size * self.number} steps')",
    }
    assert ("Thing.__init__", "self, number: int=3", "self, number: int=4") in found
    assert ("Thing.step", "case 'up':", "case _ if False:") in found
    assert {now for function, was, now in found if function == "Thing.step" and "cannot" in now} == {
        "raise ValueError(f'cannot go {by.size / self.number} steps')"
    }
    assert not any("module" in was or "number." in was for function, was, now in found)


def test_a_row_of_a_table_is_identified_by_its_key():
    table = (
        "TABLE = {'low': Rule(True, 'what is wrong, in so many words that the table is not to be read at a glance')}"
    )
    other = table.replace("}", ", 'high': Rule(False, 'and the same again, in other words, for another line of it')}")
    found = [(each.function, each.was) for each in mutants(other) if "Rule" in each.was]
    assert [function for function, was in found] == ["TABLE['low']", "TABLE['high']"]


def keys(source):
    return {explained.key(each) for each in mutants(source)}


def test_the_identity_of_a_mutant_is_independent_of_other_code():
    edited = SOURCE.replace('"""A module."""\n', '"""Another."""\n\n\ndef first(x):\n    return x + 1\n')
    edited = edited.replace("self.number = number", "self.number  =  number  # of steps")
    assert keys(SOURCE) < keys(edited)


def test_equal_statements_are_distinguished():
    source = "def f(a):\n    if a.x:\n        a.go()\n    a.stop()\n    a.go()\n"
    assert [each.which for each in mutants(source) if each.was == "a.go()"] == [1, 2]


def test_every_mutant_compiles_and_differs_from_the_module():
    for target in TARGETS.values():
        plain = compile(mutated(target.source, None), "module", "exec")
        every = mutants(target.source)
        assert every
        assert len(keys(target.source)) == len(every)
        for mutant in every[::10]:
            assert compile(mutated(target.source, mutant), "module", "exec") != plain


# The trials

THING = "def clip(x, top):\n    while x > top:\n        x = x - 1\n    return x\n"
STRONG = "from thing import clip\ndef test_clip():\n    assert [clip(x, 2) for x in (1, 2, 5)] == [1, 2, 2]\n"


@pytest.fixture
def tried(tmp_path):
    def run(test):
        (tmp_path / "thing.py").write_text(THING)
        (tmp_path / "test_thing.py").write_text(test)
        target = Target("thing.py", ("test_thing.py",), tmp_path, package="")
        return {str(each.mutant): each for each in trials(target, mutants(THING), jobs=2, slack_s=1.0)}

    return run


@pytest.mark.slow
def test_a_good_test_kills_every_mutant_and_one_that_never_ends_is_ended(tried):
    found = tried(STRONG)
    assert {each.end for each in found.values()} == {"killed", "timed out"}
    assert {each.by for each in found.values() if each.end == "killed"} == {"test_thing.py::test_clip"}
    assert found["clip: x = x - 1  ->  pass"].end == "timed out"


@pytest.mark.slow
def test_an_undetected_mutant_survives(tried):
    found = tried("from thing import clip\ndef test_clip():\n    assert clip(1, 2) == 1\n")
    alive = {name for name, each in found.items() if each.end == "survived"}
    assert "clip: x = x - 1  ->  x = x + 1" in alive
    assert "clip: x > top  ->  x <= top" not in alive


@pytest.mark.slow
def test_tests_that_already_fail_do_not_judge_mutants(tried):
    with pytest.raises(FailsUnchanged, match=r"(?s)thing.py: its tests fail without a change.*clip\(3, 2\) == 3"):
        tried("from thing import clip\ndef test_clip():\n    assert clip(3, 2) == 3\n")


# The list and the command


def test_an_entry_whose_code_is_gone_is_stale(tmp_path):
    mutant = mutants(THING)[0]
    file = tmp_path / "explained.yaml"
    file.write_text(f"thing.py:\n{explained.as_entry(mutant)} 'a test of the list: itself'\n")
    entries = explained.read(file)
    assert [each.key for each in entries] == [explained.key(mutant)]
    assert explained.stale(entries, "thing.py", mutants(THING)) == []
    assert explained.stale(entries, "thing.py", mutants(THING.replace("x > top", "top < x"))) == entries


def test_every_entry_has_a_reason(tmp_path):
    file = tmp_path / "explained.yaml"
    file.write_text(f"thing.py:\n{explained.as_entry(mutants(THING)[0])}\n")
    with pytest.raises(ValueError, match="says in, was, now, why"):
        explained.read(file)


def test_help_shows_an_example_of_itself():
    out = CliRunner().invoke(command.main, ["--help"])
    assert "python -m validation.mutants" in out.output.partition("Example")[2]
