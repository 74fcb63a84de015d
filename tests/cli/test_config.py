"""`softarm config`: a new file, and what its keys take."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.common.revision import ROOT
from softarm.daemon.config.configuration import read
from softarm.schemas.config import Config


@pytest.fixture
def softarm(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        return CliRunner().invoke(main, list(arguments), prog_name="softarm")

    return run


def test_a_new_file_is_the_packaged_one_and_says_what_comes_next(softarm):
    done = softarm("config", "new")
    assert done.exit_code == 0, done.output
    assert Path("softarm.yaml").read_text() == (ROOT / "softarm.yaml").read_text()
    assert "wrote softarm.yaml" in done.output
    assert "softarm run --config softarm.yaml" in done.output


@pytest.mark.parametrize(
    ("option", "name", "runs"),
    [("--twin", "twin.yaml", "softarm twin --config"), ("--simulated", "softarm.yaml", "softarm run --simulated")],
)
def test_a_file_for_each_kind_of_robot(softarm, option, name, runs):
    done = softarm("config", "new", option)
    assert done.exit_code == 0, done.output
    assert runs in done.output
    assert isinstance(read(name).config, Config)


def test_a_file_that_is_there_stays(softarm):
    Path("mine.yaml").write_text("mine")
    done = softarm("config", "new", "mine.yaml")
    assert done.exit_code == 1
    assert "mine.yaml: is there already" in done.output
    assert Path("mine.yaml").read_text() == "mine"


def test_a_file_in_no_folder_is_told(softarm):
    done = softarm("config", "new", "no/mine.yaml")
    assert done.exit_code == 1
    assert "no/mine.yaml: cannot be written" in done.output


def test_units_of_the_keys_that_are_asked_for(softarm):
    told = softarm("config", "units", "slew").output
    assert "limits.pressure.slew_max_kpa_s" in told
    assert "above 0, at most 1000 kPa/s" in told
    rows = json.loads(softarm("config", "units", "margin", "--json").output)
    assert [row["key"] for row in rows] == ["limits.rail.margin_m"]
    assert (rows[0]["unit"], rows[0]["default"]) == ("m", "0.01")


def test_a_part_of_no_key_is_told(softarm):
    done = softarm("config", "units", "torque")
    assert done.exit_code == 1
    assert "no key has 'torque' in its name" in done.output
