"""Log with every tick exactly as in the loop, also if it is cut off."""

from dataclasses import is_dataclass, replace
from datetime import UTC, datetime
from types import UnionType
from typing import get_args, get_origin, get_type_hints

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from softarm.daemon.control.records import Inputs, Mode, Outputs, Request, RequestResult, TickTiming
from softarm.daemon.logbook import logs
from softarm.daemon.logbook.logs import exceeded
from softarm.daemon.logbook.ticks import CHANNELS, Joiner, Splitter, TickFile
from softarm.recordings.live import EVENT
from softarm.recordings.mcap_file import LogError
from softarm.schemas.config import Limits
from softarm.schemas.events import Entry
from softarm.schemas.messages import BODY_NAMES, Command, MocapFrame, Pose
from tests.daemon.logbook.builders import config, make_tick, recorded, unfinished


def values(hint) -> st.SearchStrategy:
    """Return a strategy for a type of a record's field, a record with all its fields included."""
    if hint is int:
        return st.integers(0, 2**63 - 1)  # a stamp fits into a log
    if hint is MocapFrame:
        poses = st.tuples(*[values(Pose)] * len(BODY_NAMES))
        return st.builds(MocapFrame, *map(values, (int, int, int)), poses)
    if is_dataclass(hint) or hasattr(hint, "_fields"):
        return st.builds(hint, **{name: values(each) for name, each in get_type_hints(hint).items()})
    if get_origin(hint) is UnionType:
        return st.one_of(*map(values, get_args(hint)))
    if get_origin(hint) is tuple:
        first, *others = get_args(hint)
        if others == [...]:
            return st.lists(values(first), max_size=2).map(tuple)
        return st.tuples(*map(values, (first, *others)))
    return st.text(max_size=20) if hint is str else st.from_type(hint)


tick = st.tuples(values(Inputs), values(Outputs), values(TickTiming))


@pytest.mark.slow
@settings(
    deadline=None, max_examples=6, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture]
)
@given(ticks=st.lists(tick, min_size=1, max_size=3))
def test_a_finished_file_gives_every_tick_back_bit_for_bit(tmp_path, ticks):
    log = logs.read(recorded(config(tmp_path), ticks).path)
    assert log.finished
    assert repr(list(log)) == repr(ticks)  # equal types and bits; all NaN are equal


def test_an_unchanged_reading_is_written_once():
    inputs, outputs, timing = make_tick(1)
    splitter = Splitter()
    first = [entry.topic for entry in splitter.split(inputs, outputs, timing)]
    again = [entry.topic for entry in splitter.split(inputs, outputs, timing)]
    assert first.count("/pressure") == first.count("/rail") == 1
    assert "/pressure" not in again
    assert "/rail" not in again


def test_messages_have_real_stamps(tmp_path):
    inputs, outputs, timing = make_tick(3)
    with recorded(config(tmp_path), [(inputs, outputs, timing)]).path.open("rb") as file:
        stamps = {c.topic: (m.log_time, m.publish_time) for _, c, m in make_reader(file).iter_messages()}
    newest = inputs.mocap[-1]
    assert stamps["/mocap"] == (newest.t_receive_ns, newest.t_capture_ns)
    assert stamps["/pressure"][0] == inputs.pressure.t_receive_ns
    assert stamps["/tick"][0] == inputs.t_ns


@pytest.mark.parametrize("channel", CHANNELS, ids=lambda c: c.topic)
def test_every_channel_describes_its_messages_as_objects(channel):
    assert b'"type": "object"' in channel.json_schema()
    data = {message.topic: message.data for message in Splitter().split(*run_of_six()[2])}
    data["/event"] = EVENT.encode(Entry(1, 2, datetime.now(UTC), 3, "stop", "stopped", "emergency stop"))
    data = data[channel.topic]
    assert data.startswith(b'{"')
    if channel.topic == "/mocap":
        assert b'"angle_rad":' in data
    if channel.topic == "/tick":
        assert b'"sent":{"enable":true,"cart_velocity_m_s":' in data


def test_a_log_cut_anywhere_is_read_up_to_the_last_whole_tick(tmp_path):
    ticks = [make_tick(n) for n in range(12)]
    whole = unfinished(tmp_path / "killed.mcap", ticks).read_bytes()
    cut = tmp_path / "cut.mcap"
    seen = []
    for length in [*range(0, len(whole), 1999), len(whole)]:
        cut.write_bytes(whole[:length])
        log = logs.read(cut)
        found = list(log)
        assert not log.finished
        assert repr(found) == repr(ticks[: len(found)])
        assert f"{log.records} complete records over {log.duration_s:.2f} s" in log.ending
        seen.append(len(found))
    assert seen == sorted(seen)
    assert (seen[0], seen[-1]) == (0, 12)


def test_a_log_without_measurements_is_not_replayed():
    entries = list(Splitter().split(*make_tick(1)))
    joiner = Joiner()
    for entry in entries[1:-1]:
        joiner.join(entry.topic, entry.data)
    with pytest.raises(ValueError, match="not those that it names"):
        joiner.join(entries[-1].topic, entries[-1].data)


@pytest.mark.parametrize("version", ["2", "-1"])
def test_a_log_of_a_newer_format_is_refused_with_both_versions(tmp_path, version):
    path = tmp_path / "newer.mcap"
    with path.open("wb") as file:
        live = TickFile(file)
        live.note("software", {"softarm": "0.9.0", "log_format": version})
        live.flush()
    with pytest.raises(LogError, match=rf"format {version}, written by softarm 0\.9\.0; this software reads format 1"):
        logs.read(path)


def run_of_six() -> list[tuple[Inputs, Outputs, TickTiming]]:
    """Return ticks of which the third has a request to arm and the fourth is armed."""
    ticks = [make_tick(n) for n in range(1, 7)]
    for n, (inputs, outputs, timing) in enumerate(ticks):
        if n == 2:
            inputs = replace(inputs, requests=(Request(1, "arm", who="the terminal"),))
            outputs = replace(outputs, results=(RequestResult(1, True),))
        ticks[n] = inputs, replace(outputs, mode=Mode.ARMED if n >= 3 else Mode.DISARMED), timing
    return ticks


ENTRIES = [("request", 3, "arm requested from the terminal"), ("mode", 4, "disarmed → armed")]


def test_a_log_has_its_events_in_wall_time(tmp_path):
    clocks = {"monotonic_ns": lambda: 0, "wall_ns": lambda: 1_800_000_000_000_000_000}
    box = recorded(config(tmp_path), run_of_six(), **clocks)
    entries = list(logs.read(box.path).entries())
    assert [(e.kind, e.tick, e.text) for e in entries] == ENTRIES
    assert [e.number for e in entries] == [1, 2]
    assert entries == list(box.history.entries)
    assert entries[1].time.isoformat() == "2027-01-15T08:00:05.133333+00:00"
    assert len(list(logs.read(box.path))) == 6


def test_the_events_of_a_log_without_events_are_derived_from_its_ticks(tmp_path):
    log = logs.read(unfinished(tmp_path / "killed.mcap", run_of_six()))
    assert [(e.kind, e.tick, e.text) for e in log.entries()] == ENTRIES
    assert {e.number for e in log.entries()} == {0}


@pytest.mark.parametrize(
    ("limits", "problems"),
    [
        ({}, []),
        ({"rail": {"position_min_m": -0.01}}, ["the cart left its limits: -0.050 to 0.100 m"]),
        ({"rail": {"velocity_max_m_s": 0.45}}, ["a velocity above its limit was sent"]),
        ({"pressure": {"max_kpa": 4.0}}, ["a pressure outside its limits was sent"]),
    ],
)
def test_values_beyond_a_limit_are_reported(limits, problems):
    inputs, outputs, _ = make_tick(1)
    run = [
        (replace(inputs, rail=replace(inputs.rail, position_m=cart_m)), replace(outputs, sent=Command(True, *sent)))
        for cart_m, *sent in ((-0.05, 0.4, 1.0), (0.1, -0.5, 5.0))
    ]
    assert exceeded(run, Limits.model_validate(limits)) == problems
    assert exceeded([(Inputs(0), outputs) for _, outputs in run], Limits()) == []
