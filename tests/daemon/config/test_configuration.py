"""Reader of the configuration file: every mistake with its line, the allowed values and the next step."""

import re
from pathlib import Path
from textwrap import dedent

import pytest

from softarm.common.keys import leaves
from softarm.daemon.config import configuration
from softarm.daemon.config.configuration import ConfigurationError, effective_limits, load, read
from softarm.schemas.config import Config

ROOT = Path(__file__).parents[3]


@pytest.fixture
def write(tmp_path):
    def write(text: str) -> Path:
        path = tmp_path / "arm.yaml"
        path.write_text(dedent(text))
        return path

    return write


def problems(path: Path) -> list[str]:
    """Return the messages about a file, without its folder."""
    with pytest.raises(ConfigurationError) as refusal:
        read(path)
    assert str(refusal.value).splitlines() == list(refusal.value.problems)
    return [problem.removeprefix(f"{path.parent}/") for problem in refusal.value.problems]


def test_the_example_is_complete_and_shows_the_defaults():
    example = read(ROOT / "softarm.yaml")
    assert example.config.model_dump() == Config().model_dump()
    absent = [key.name for key in leaves(Config) if key.path not in example.lines]
    assert absent == []


def test_the_twin_file_differs_from_the_example_in_addresses_only():
    default, twin = Config().model_dump(), load(ROOT / "twin.yaml").model_dump()
    assert {name for name in default if default[name] != twin[name]} == {"control", "drivers"}
    assert twin["drivers"]["rail"]["host"] == "127.0.0.1"
    assert twin["drivers"]["rail"]["port"] == 15020


@pytest.mark.parametrize("text", ["", "# nothing\n", "limits:\n", "limits:\n  rail:\n"])
def test_missing_keys_have_their_defaults(write, text):
    assert load(write(text)) == Config()


def test_values_are_read_with_their_lines(write):
    path = write("""\
        limits:
          rail: {position_max_m: 0.2, velocity_max_m_s: 5e-1}
        policies:
          gentle: {plugin: pid, options: {kp_y: 0.5, note: slow, flag: true, n: 3}}
        recorder:
          directory: /var/lib/softarm
        """)
    loaded = read(path)
    assert loaded.config.limits.rail.velocity_max_m_s == 0.5
    assert loaded.config.policies["gentle"].options == {"kp_y": 0.5, "note": "slow", "flag": True, "n": 3}
    assert loaded.config.recorder.directory == Path("/var/lib/softarm")
    assert loaded.place(("limits", "rail", "position_max_m")) == f"{path}:2"
    assert loaded.place(("limits", "rail", "position_min_m")) == str(path)


def test_all_mistakes_are_reported_in_the_files_order(write):
    """`tests/common/test_yaml_schema.py` tests the sentence of each kind."""
    path = write("""\
        limits:
          rail:
            position_max_m: 250
            latency_s: 33 ms
            max_kpa: 3
          pressure:
            min_kpa: .nan
        goals: 3
        policies:
          mine:
            options: {kp: [1]}
        api:
          port: 8080
          port: 8080
        """)
    assert [problem.split(": ")[:2] for problem in problems(path)] == [
        ["arm.yaml:3", "limits.rail.position_max_m"],
        ["arm.yaml:4", "limits.rail.latency_s"],
        ["arm.yaml:5", "limits.rail.max_kpa"],
        ["arm.yaml:7", "limits.pressure.min_kpa"],
        ["arm.yaml:8", "goals"],
        ["arm.yaml:10", "policies.mine"],
        ["arm.yaml:11", "policies.mine.options.kp"],
        ["arm.yaml:14", "api.port"],
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("drivers: {rail: {acceleration_m_s2: 8}}", "1: drivers.rail.acceleration_m_s2: is 8.0, above limits.rail."),
        (
            "limits: {rail: {position_min_m: 0.3}}",
            "1: limits.rail: position_max_m must lie above position_min_m by four",
        ),
        ("goals: {workspace: {z_min_m: 0.9}}", "1: goals.workspace: y_min_m must lie below y_max_m, and z_min_m below"),
        ("limits:\n  rail:\npolicies:\n", "3: policies: is null; allowed a group of names"),
        ("drivers: {mocap: {endpoint: foo}}", "1: drivers.mocap.endpoint: is 'foo'; allowed tcp/HOST:PORT with"),
        ("drivers: {mocap: {endpoint: tcp/arm}}", "1: drivers.mocap.endpoint: is 'tcp/arm'; allowed tcp/HOST:PORT"),
        ("drivers: {rail: {units_per_m: 0.001}}", "1: drivers.rail.units_per_m: is 0.001; allowed 1000 to"),
        ("ros: {router: 'tcp/10.0.0.2:99999'}", "1: ros.router: is 'tcp/10.0.0.2:99999'; allowed tcp/HOST:PORT"),
    ],
)
def test_each_mistake_has_its_message(write, text, said):
    assert any(problem.startswith(f"arm.yaml:{said}") for problem in problems(write(text)))


def test_an_unreadable_file_is_named_with_the_next_step(tmp_path):
    assert problems(tmp_path / "no.yaml") == [
        "no.yaml: no such file; name an existing file, or write one with `softarm config new`"
    ]


def test_effective_limits_have_value_bounds_and_source(write):
    rail = "    velocity_max_m_s: 0.5\n    braking_m_s2: 2.5\n    latency_s: 0.1\n    drag_m_s: 0.1\n"
    path = write(f"limits:\n  rail:\n{rail}")
    rows = {row.key: row for row in effective_limits(read(path))}
    assert rows["limits.rail.velocity_max_m_s"][1:] == ("0.5", "m/s", "above 0, at most 1 m/s", "line 3")
    assert rows["limits.pressure.max_kpa"][1:] == ("20", "kPa", "above 0, at most 20 kPa", "default")
    in_force = {key.name for key in leaves(Config) if key.path[0] in ("limits", "failsafe", "goals")}
    assert in_force <= rows.keys()
    stopping = rows["stopping distance at full speed"]
    assert float(stopping.value) == pytest.approx(0.6 * (0.1 + 0.045) + 0.36 / 5, rel=1e-3)
    assert stopping.source == "derived"
    assert float(rows["pressure step per tick"].value) == pytest.approx(20.7)


def test_the_pages_example_prints_the_pages_output(write):
    page = (ROOT / "docs/reference/configuration.md").read_text(encoding="utf-8")
    said = re.search(r"```\n(arm\.yaml:.*?)```", page, re.DOTALL)[1]
    example = re.search(r"```yaml\n(.*?)```", page, re.DOTALL)[1]
    assert problems(write(example)) == said.splitlines()


def test_every_key_has_unit_range_default_and_meaning():
    rows = {row.key: row for row in configuration.key_rows()}
    assert list(rows) == [key.name for key in leaves(Config)]
    assert [row.key for row in rows.values() if not row.meaning] == []
    assert rows["limits.rail.margin_m"][:4] == ("limits.rail.margin_m", "m", "0 to 0.1 m", "0.01")
    assert rows["recorder.keep_days"][1:4] == ("days", "above 0, at most 36500 days or null", "null")
    assert rows["control.policy"][1:4] == ("", "a text", "'reach'")
    assert rows["policies"].default == "none"


def test_the_file_of_a_simulated_robot_has_no_drivers(tmp_path):
    (tmp_path / "simulated.yaml").write_text(configuration.for_a_simulated_robot())
    simulated = read(tmp_path / "simulated.yaml")
    assert simulated.config == Config()
    assert {place[0] for place in simulated.lines if place} == set(Config.model_fields) - {"drivers"}
