"""The extra named in the message about the missing SDK exists."""

import tomllib
from pathlib import Path


def test_the_extra_that_is_named_brings_the_sdk_and_the_core_does_not():
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    assert any(each.startswith("foxglove-sdk") for each in project["optional-dependencies"]["foxglove"])
    assert not any("foxglove" in each for each in project["dependencies"])
