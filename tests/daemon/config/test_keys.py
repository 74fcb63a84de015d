"""Reference of the configuration keys and generated files."""

from softarm.common.keys import leaves
from softarm.daemon.config import keys
from softarm.daemon.config.configuration import read
from softarm.schemas.config import Config


def test_every_key_has_unit_range_default_and_meaning():
    rows = {row.key: row for row in keys.rows()}
    assert list(rows) == [key.name for key in leaves(Config)]
    assert [row.key for row in rows.values() if not row.meaning] == []
    assert rows["limits.rail.margin_m"][:4] == ("limits.rail.margin_m", "m", "0 to 0.1 m", "0.01")
    assert rows["recorder.keep_days"][1:4] == ("days", "above 0, at most 36500 days or null", "null")
    assert rows["control.policy"][1:4] == ("", "a text", "'reach'")
    assert rows["policies"].default == "none"


def test_the_file_of_a_simulated_robot_has_no_drivers(tmp_path):
    (tmp_path / "simulated.yaml").write_text(keys.for_a_simulated_robot())
    simulated = read(tmp_path / "simulated.yaml")
    assert simulated.config == Config()
    assert {place[0] for place in simulated.lines if place} == set(Config.model_fields) - {"drivers"}
