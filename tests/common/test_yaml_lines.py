"""The YAML reader: the same data as PyYAML, the line of each key, and errors as sentences."""

import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from softarm.common import yaml_lines
from softarm.common.yaml_lines import MAX_ALIASED, MAX_DEPTH, FileError, parse, read

FILE = Path("file.yaml")
# The words that get past the first checks, in any order.
PARTS = [*":{}[] \n", "\n  ", ", ", "&a ", "*a", "!!int ", "!!set ", "? ", "- ", "a", "b: ", "1", "-1e9", ".nan"]
PARTS += [".inf", "null", "2020-13-45", "'", '"\\ud800"', "\x00", "<<: ", "0x" + "f" * 9999]
plain = st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats(allow_nan=False) | st.text(max_size=8)
values = st.recursive(
    plain,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=20,
)


def refusal(text: str) -> str:
    with pytest.raises(FileError) as error:
        parse(text, FILE)
    return str(error.value)


@pytest.mark.parametrize("parser", ["CSafeLoader", "SafeLoader"])
@settings(deadline=None, max_examples=60)
@given(data=values)
def test_a_written_file_is_read_back(parser, data):
    """Whichever parser is there: the fast one is not on every machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(yaml_lines, "_FAST", getattr(yaml, parser))
        document = parse(yaml.safe_dump({"top": data}), FILE)
    assert document.data == {"top": data}
    assert document.mistakes == []


def test_a_number_is_what_people_take_for_one():
    assert parse("a: 1e-3\nb: 5e3\nc: .inf\nd: 2024-01-02", FILE).data == {
        "a": 1e-3,
        "b": 5e3,
        "c": math.inf,
        "d": "2024-01-02",
    }


def test_every_key_and_item_has_its_line():
    document = parse("a:\n  b: 1\n  c:\n  - x\n  - {d: 2}\n", FILE)
    assert document.lines == {
        (): 1,
        ("a",): 1,
        ("a", "b"): 2,
        ("a", "c"): 3,
        ("a", "c", 0): 4,
        ("a", "c", 1): 5,
        ("a", "c", 1, "d"): 5,
    }
    assert document.line(("a", "c", 7, "e")) == 3


@pytest.mark.parametrize(
    "text",
    [
        "a: &x {b: 1, c: [2, 3]}\nd: *x",
        "a: &x {b: 1, c: 2}\nd: {<<: *x, b: 3}",
        "a: &x {b: 1}\ne: &y {b: 2, c: 3}\nd:\n  b2: 0\n  <<: [*x, *y]",
        "a: &x {b: {c: 1}}\nd: &y {<<: *x}\ne: {<<: *y, f: *x}",
        "d: {<<: {a: 1}, b: 2}",
    ],
)
def test_anchors_aliases_and_merges_are_pyyamls_and_their_keys_have_lines(text):
    document = parse(text, FILE)
    assert document.data == yaml.safe_load(text)

    def places(value, place):
        yield place
        if isinstance(value, dict | list):
            for key in value if isinstance(value, dict) else range(len(value)):
                yield from places(value[key], (*place, key))

    assert set(places(document.data, ())) <= document.lines.keys()


def test_values_of_merges_and_aliases_keep_their_lines():
    document = parse("a: &x\n  b: 1\nd:\n  <<: *x\n  c: 2\ne: *x\n", FILE)
    assert [document.lines[place] for place in (("d", "b"), ("d", "c"), ("e",), ("e", "b"))] == [2, 5, 6, 2]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: [", "file.yaml:1: not valid YAML: while parsing a flow node expected the node content"),
        ("a: 1\n---\nb: 2", "file.yaml:2: not valid YAML: expected a single document"),
        ("a: 1\nb: *c", "file.yaml:2: not valid YAML: found undefined alias 'c'; check"),
        ('a: "\\ud800"', "file.yaml:1: not valid YAML: it contains half a character; write"),
        ("\x00", "file.yaml: not valid YAML: unacceptable character"),
        ("a: " + "[" * 5_000, f"file.yaml:1: not valid YAML: it is nested too deeply (more than {MAX_DEPTH} levels)"),
        ("a: " + "{b: " * 500, "file.yaml:1: not valid YAML: it is nested too deeply"),
        ("? " + "[" * 500, "file.yaml:1: not valid YAML: it is nested too deeply"),
        ("a: !x " + "[" * 500, "file.yaml:1: not valid YAML: it is nested too deeply"),
        ("\n".join(" " * i + "a:" for i in range(500)), f"file.yaml:{MAX_DEPTH + 1}: not valid YAML: it is nested too"),
    ],
)
def test_invalid_yaml_is_rejected_at_its_line(text, said):
    assert refusal(text).startswith(said)


def test_depth_counts_through_aliases():
    step = MAX_DEPTH - 10
    text = "a0: &a0 1\n" + "\n".join(f"a{i + 1}: &a{i + 1} {'[' * step}*a{i}{']' * step}" for i in range(100))
    assert refusal(text).startswith("file.yaml:3: not valid YAML: it is nested too deeply")


@pytest.mark.parametrize(
    "text",
    [
        "a0: &a0 [x, x]\n" + "\n".join(f"a{i + 1}: &a{i + 1} [{', '.join([f'*a{i}'] * 9)}]" for i in range(20)),
        "a0: &a0 {k: 1}\n" + "\n".join(f"a{i + 1}: &a{i + 1} {{l: *a{i}, r: *a{i}}}" for i in range(40)),
        "a0: &a0 {k: 1}\n" + "\n".join(f"a{i + 1}: &a{i + 1} {{<<: *a{i}, k{i}: *a{i}}}" for i in range(40)),
    ],
)
def test_an_alias_bomb_is_an_error_after_so_many_values(text):
    assert f"its aliases stand for more than {MAX_ALIASED} values; write the values out" in refusal(text)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("a: 1\na: 2", [(("a",), 2, "is given twice (first in line 1); keep one")]),
        ("a: {b: 1,\n b: [2, {c: 3}], d: 4}", [(("a", "b"), 2, "is given twice (first in line 1); keep one")]),
        ("? [a, {b: 1}]\n: 2\nc: 3", [((), 1, "a key must be a plain name")]),
        ("a: &x\n  b: *x", [(("a", "b"), 2, "refers to itself; write the values out")]),
        ("a: !!set {b}", [(("a",), 1, "has the tag tag:yaml.org,2002:set; remove it")]),
        ("a: 2024-13-45", [(("a",), 1, "cannot be read (month must be in 1..12); write a plain value")]),
        ("a:\n  <<: 3", [(("a", "<<"), 2, "merges a value that is no group; name an anchor of a group")]),
    ],
)
def test_an_error_of_yaml_is_reported_with_the_others(text, found):
    document = parse(text, FILE)
    assert [(each.place, each.line, each.say()) for each in document.mistakes] == found


def test_names_of_keys_are_texts_as_they_were_written():
    assert parse("1: a\n2.50: b\nyes: c\n2024-01-02: d", FILE).data == {
        "1": "a",
        "2.50": "b",
        "yes": "c",
        "2024-01-02": "d",
    }


@pytest.mark.parametrize("text", ["", "# nothing\n", "---\n"])
def test_an_empty_file_holds_no_keys(text):
    assert parse(text, FILE).data in ({}, None)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.sampled_from(PARTS), max_size=25).map("".join) | st.text(max_size=40))
def test_any_text_is_a_document_or_an_error_in_words(text):
    try:
        document = parse(text, FILE)
    except FileError as error:
        reported = error.problems
    else:
        str(document.data).encode()
        return
    assert reported
    assert all(problem.startswith("file.yaml:") for problem in reported)


def test_a_file_that_cannot_be_read_is_named_with_the_way_out(tmp_path):
    (tmp_path / "latin.yaml").write_bytes("höhe: 1".encode("latin-1"))
    for name, said in {
        "no.yaml": "no such file; write one",
        ".": "cannot be read (Is a directory); name a readable file",
        "latin.yaml": "not UTF-8 text (invalid start byte); save it as UTF-8",
    }.items():
        with pytest.raises(FileError) as error:
            read(tmp_path / name, "write one")
        assert str(error.value).endswith(f": {said}")


def test_a_file_that_never_ends_is_not_read_to_its_end():
    with pytest.raises(FileError, match=r"/dev/zero: has more than 2 MB; name a file that a person wrote"):
        read("/dev/zero", "")
