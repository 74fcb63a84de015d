"""Contents of a log for display: the newest data at each tick, and errors as sentences."""

import pytest

from softarm.recordings import flight
from softarm.recordings.mcap_file import LogError
from tests.recordings.conftest import write


def test_each_tick_has_the_newest_data(flight_file, log):
    moments = [moment for moment in flight.moments(flight_file) if moment is not None]
    for moment, (inputs, outputs, timing) in zip(moments, log, strict=True):
        assert (moment.frame, moment.pressure, moment.rail) == (inputs.mocap[-1], inputs.pressure, inputs.rail)
        assert (moment.tick.outputs.tick, moment.tick.outputs.sent) == (outputs.tick, outputs.sent)
        assert moment.tick.timing.compute_ns == timing.compute_ns


def test_every_message_reports_progress(flight_file, log):
    assert sum(1 for _ in flight.moments(flight_file)) == log.records


def test_seconds_count_from_the_first_measurement_and_of_nothing_there_are_none(tmp_path, killed, readings):
    assert flight.first_stamp_ns(killed) == readings[0].t_receive_ns
    empty = write(tmp_path / "empty.mcap", ())
    with pytest.raises(LogError, match=r"empty\.mcap: holds nothing to show; was the daemon stopped before its first"):
        flight.first_stamp_ns(empty)


@pytest.mark.parametrize(
    ("data", "what"),
    [(b'{"position_m": 0}', "t_receive_ns: Field required"), (b"{", "Invalid JSON")],
    ids=["field", "json"],
)
def test_a_message_of_another_kind_is_reported_with_its_place(tmp_path, data, what):
    odd = write(tmp_path / "odd.mcap", [(1, data)])
    with pytest.raises(
        LogError, match=rf"odd\.mcap: a message on /rail: {what}.*; was it edited, or recorded by another"
    ):
        list(flight.records(odd))
