"""Editor of single values in a configuration file."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softarm.common import yaml_lines
from softarm.common.yaml_lines import FileError
from softarm.daemon.config.configuration import EXAMPLE, TWIN
from softarm.daemon.config.edit import with_values

RAIL = ("drivers", "rail")
FILE = Path("arm.yaml")


def edited(text: str, **values: float | bool) -> str:
    return with_values(text, FILE, RAIL, values)


def test_in_the_packaged_file_only_the_value_changes():
    text = EXAMPLE.read_text(encoding="utf-8")
    new = edited(text, centre_m=0.2871, reversed=True)
    changed = [(a, b) for a, b in zip(text.splitlines(), new.splitlines(), strict=True) if a != b]
    assert len(changed) == 2
    assert changed[0][1].startswith("    centre_m: 0.2871 ")
    assert changed[0][1].endswith(changed[0][0].partition(" # ")[2])
    assert "reversed: true" in changed[1][1]


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("drivers:\n  rail:\n    host: h # mine\n", "drivers:\n  rail:\n    centre_m: 0.29\n    host: h # mine\n"),
        ("drivers:\n  rail:\n", "drivers:\n  rail:\n    centre_m: 0.29\n"),
        (
            "drivers:\n    mocap:\n        key: k\n",
            "drivers:\n    rail:\n      centre_m: 0.29\n    mocap:\n        key: k\n",
        ),
        ("# nothing\n", "# nothing\ndrivers:\n  rail:\n    centre_m: 0.29\n"),
        ("api:\n  port: 1", "api:\n  port: 1\ndrivers:\n  rail:\n    centre_m: 0.29\n"),
        ("", "drivers:\n  rail:\n    centre_m: 0.29\n"),
        (
            'drivers:\n  rail:\n    "centre_m":   0.3#x\n'.replace("#", " #"),
            'drivers:\n  rail:\n    "centre_m":   0.29 #x\n',
        ),
    ],
)
def test_a_value_is_inserted_in_its_group(before: str, after: str):
    assert edited(before, centre_m=0.29) == after


@pytest.mark.parametrize(
    "text",
    [
        "drivers: {rail: {centre_m: 0.3}}\n",
        "drivers:\n  rail: {host: h}\n",
        "drivers:\n  rail:\n    centre_m: &c 0.3\n",
        "drivers:\n  rail:\n    centre_m:\n      0.3\n",
        "drivers: {}\n",
        '{"drivers": {"rail": {"host": "h"}}}\n',
    ],
)
def test_an_unusual_layout_is_left_and_reported(text: str):
    with pytest.raises(FileError) as refused:
        edited(text, centre_m=0.29, reversed=True)
    assert str(refused.value).endswith("write by hand drivers.rail.centre_m: 0.29; drivers.rail.reversed: true")


def test_a_value_that_is_not_allowed_is_refused():
    with pytest.raises(FileError, match=r"drivers\.rail\.centre_m: is 7"):
        edited("api:\n  port: 1\n", centre_m=7.0)


@settings(max_examples=20)
@given(st.floats(-2, 2), st.booleans(), st.sampled_from([EXAMPLE, TWIN]))
def test_an_edited_file_reads_back_its_values(centre_m: float, reversed: bool, file: Path):
    text = file.read_text(encoding="utf-8")
    new = yaml_lines.parse(edited(text, centre_m=round(centre_m, 4), reversed=reversed), FILE).data
    old = yaml_lines.parse(text, FILE).data
    assert new["drivers"]["rail"].pop("centre_m") == pytest.approx(centre_m, abs=1e-4)
    assert new["drivers"]["rail"].pop("reversed") is reversed
    for key in ("centre_m", "reversed"):
        old["drivers"]["rail"].pop(key, None)
    assert new == old
