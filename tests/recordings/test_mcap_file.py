"""A recording is read up to where it breaks off, by whoever reads it."""

import io

import pytest
from mcap.writer import Writer

from softarm.recordings import channels, mcap_file
from softarm.schemas.messages import RailReading

READINGS = [RailReading(n, n / 7, float("nan") if n == 3 else -0.0, True) for n in range(10)]


def whole() -> bytes:
    file = io.BytesIO()
    writer = Writer(file, use_chunking=False)
    writer.start()
    schema = writer.register_schema(channels.RAIL.schema_name, "jsonschema", channels.RAIL.json_schema())
    channel = writer.register_channel(channels.RAIL.topic, "json", schema)
    for reading in READINGS:
        writer.add_message(channel, reading.t_receive_ns, channels.RAIL.encode(reading), reading.t_receive_ns)
    writer.finish()
    return file.getvalue()


def test_every_cut_gives_a_prefix(tmp_path):
    data, path = whole(), tmp_path / "x.mcap"
    counts = []
    for length in range(0, len(data), 37):
        path.write_bytes(data[:length])
        read = [channels.RAIL.decode(message) for _, message in mcap_file.messages(path)]
        assert repr(read) == repr(READINGS[: len(read)])
        counts.append(len(read))
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, len(READINGS))


def test_what_is_not_there_or_no_log_is_told(tmp_path):
    with pytest.raises(mcap_file.LogError, match="cannot be read"):
        list(mcap_file.messages(tmp_path / "x.mcap"))
    (tmp_path / "x.mcap").write_bytes(b"nothing of the kind")
    with pytest.raises(mcap_file.LogError, match="not a log"):
        list(mcap_file.messages(tmp_path / "x.mcap"))
