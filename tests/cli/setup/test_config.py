"""Tests of `softarm config`."""

import json
from pathlib import Path

import pytest

from softarm.common.revision import PACKAGE
from softarm.daemon.config.configuration import read
from softarm.schemas.config import Config
from tests.cli.invoke import invoke, succeed


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_new_file_is_the_packaged_one_and_the_next_command_is_printed():
    done = succeed("config", "new")
    assert Path("softarm.yaml").read_text() == (PACKAGE / "softarm.yaml").read_text()
    assert "wrote softarm.yaml" in done.output
    assert "softarm run --config softarm.yaml" in done.output


@pytest.mark.parametrize(
    ("option", "name", "runs"),
    [("--twin", "twin.yaml", "softarm twin --config"), ("--simulated", "softarm.yaml", "softarm run --simulated")],
)
def test_each_kind_of_robot_has_its_file(option, name, runs):
    done = succeed("config", "new", option)
    assert runs in done.output
    assert isinstance(read(name).config, Config)


def test_units_of_matching_keys_are_printed():
    output = invoke("config", "units", "slew").output
    assert "limits.pressure.slew_max_kpa_s" in output
    assert "above 0, at most 1000 kPa/s" in output
    rows = json.loads(invoke("config", "units", "margin", "--json").output)
    assert [row["key"] for row in rows] == ["limits.rail.margin_m"]
    assert (rows[0]["unit"], rows[0]["default"]) == ("m", "0.01")
