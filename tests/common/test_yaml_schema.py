"""Validation against a schema: all errors with their lines in one pass, in bounded time."""

import sys
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, model_validator

from softarm.common.yaml_lines import ERRORS_MAX, FileError, parse
from softarm.common.yaml_schema import fit
from softarm.schemas.config import Config
from softarm.schemas.model import Model


class Part(BaseModel):
    model_config = ConfigDict(extra="forbid")
    length_m: Annotated[float, Field(gt=0, le=2)] = 1.0
    name: Annotated[str, Field(min_length=1)]


class Thing(BaseModel):
    model_config = ConfigDict(extra="forbid")
    kind: Literal["one", "other"] = "one"
    main: Part = Part(name="main")
    parts: tuple[Part, ...] = ()
    named: dict[str, Part] = Field(default_factory=dict)
    row: Annotated[int, Field(ge=0)] | None = None
    delay_s: Annotated[float, Field(ge=0, le=0.2)] = 0.1

    @model_validator(mode="after")
    def _one_row(self):
        if self.row == 7:
            raise ValueError("main.length_m must be 1 where row is 7")
        return self


def problems(text: str, schema=Thing) -> list[str]:
    with pytest.raises(FileError) as error:
        fit(parse(text, Path("file.yaml")), schema)
    return [problem.removeprefix("file.yaml:") for problem in error.value.problems]


def test_a_file_becomes_its_schema():
    text = "kind: other\nmain:\nparts:\n- {name: a, length_m: 2}\nnamed: {b: {name: b}}\nrow: null\n"
    with pytest.raises(FileError, match=r":2: main: name is missing; allowed a text; add it"):
        fit(parse(text, Path("file.yaml")), Thing)  # an empty group has defaults, where it has them
    thing = fit(parse(text.replace("main:\n", "main: {name: m}\n"), Path("file.yaml")), Thing)
    assert (thing.kind, thing.parts[0].length_m, thing.named["b"].name, thing.row) == ("other", 2.0, "b", None)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("- 1", "1: must hold keys; allowed: kind, main, parts, named, row, delay_s"),
        (
            "kind: third",
            "1: kind: is 'third'; allowed 'one' or 'other'; change it, or remove the line for the default 'one'",
        ),
        (
            "parts:\n- name: a\n- name: b\n  lenght_m: 3",
            "4: parts.1.lenght_m: unknown key; did you mean length_m? (allowed above 0, at most 2 m; default 1)",
        ),
        (
            "parts:\n- {name: a,\n   length_m: 150}",
            "3: parts.0.length_m: is 150; allowed above 0, at most 2 m; if you meant 150 mm, write 0.15",
        ),
        ("named:\n  b: {name: 3}", "2: named.b.name: is 3; allowed a text; change it"),
        ("named:\n  b: {name: ''}", "2: named.b.name: is empty; allowed a text; write one"),
        ("parts: {}", "1: parts: is a group; allowed a list; change it"),
        (
            "row: -1",
            "1: row: is -1; allowed 0 or more, a whole number; change it, or remove the line for the default null",
        ),
        ("delay_s: 33 ms", "1: delay_s: is '33 ms'; allowed 0 to 0.2 s; write a bare number in s: 0.033"),
        (
            "delay_s: [1, 2]",
            "1: delay_s: is a list; allowed 0 to 0.2 s; change it, or remove the line for the default 0.1",
        ),
        (
            "named: {b: {name: b, delay_s: 0.1}}",
            "1: named.b.delay_s: unknown key here; move it to delay_s (allowed 0 to 0.2 s; default 0.1)",
        ),
        ("zzz: 1", "1: zzz: unknown key; remove it, or use one of kind, main, parts, named, row, delay_s"),
        ("row: 7\nmain:\n  name: m\n  length_m: 2", "4: main.length_m: must be 1 where row is 7"),
    ],
)
def test_each_error_has_its_sentence(text, said):
    assert said in problems(text)


def test_an_unreadable_key_is_reported_once():
    assert problems("delay_s: 2024-13-45") == [
        "1: delay_s: cannot be read (month must be in 1..12); write a plain value"
    ]


FLOODS = {
    "unknown keys": (Config, "", "unknown_key_{i}: {i}\n", ""),
    "unknown keys of a group": (Config, "limits:\n", "  rial_{i}:\n", ""),
    "unknown keys of a model": (Model, "cart:\n", "  mass_{i}: {i}\n", ""),
    "wrong values": (Model, "arm: {{link_mass_kg: [", "x, ", "]}}"),
    "keys that stand twice": (Config, "limits:\n", "limits:\n", ""),
}


def flood(count: int, before: str, repeated: str, after: str) -> str:
    return before.format() + "".join(repeated.format(i=i) for i in range(count)) + after.format()


@pytest.mark.parametrize(("schema", "before", "repeated", "after"), FLOODS.values(), ids=FLOODS)
def test_of_hundreds_of_errors_the_first_are_reported_and_the_rest_counted(schema, before, repeated, after):
    """The work grows with the length of the file, however many errors it holds."""
    calls = Counter()
    for count in (30, 120):
        sys.setprofile(lambda _frame, event, _arg, count=count: calls.update({(count, event): 1}))
        try:
            reported = problems(flood(count, before, repeated, after), schema)
        finally:
            sys.setprofile(None)
    assert len(reported) == ERRORS_MAX + 1
    assert reported[-1] == f" and {120 - ERRORS_MAX} more; correct these first"
    assert calls[120, "call"] + calls[120, "c_call"] < 5 * (calls[30, "call"] + calls[30, "c_call"])
