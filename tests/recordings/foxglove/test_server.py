"""The server process: its announcements and its messages of a live log."""

import io
import json
import sys

import pytest

from softarm.daemon.logbook import ticks
from softarm.recordings import mcap_file
from softarm.recordings.foxglove import converter, server
from softarm.recordings.live import LiveFile
from softarm.schemas import log as names


def test_without_the_extra_it_says_how_to_get_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "foxglove", None)
    server.serve("127.0.0.1", 0, io.BytesIO())
    assert capsys.readouterr().out == "is not installed: pip install 'softarm[foxglove]'\n"


def test_the_port_opens_after_every_channel_exists(monkeypatch):
    """The SDK may refuse a new channel to a client that connected before the channel was created."""
    foxglove = pytest.importorskip("foxglove")
    created, real = [], foxglove.Channel
    monkeypatch.setattr(foxglove, "Channel", lambda topic, **options: created.append(topic) or real(topic, **options))
    at_start, start = [], foxglove.start_server
    monkeypatch.setattr(foxglove, "start_server", lambda **options: at_start.extend(created) or start(**options))
    head = io.BytesIO()
    LiveFile(head, ticks.CHANNELS).note(names.CLOCK, {"wall_minus_monotonic_ns": "0"})
    head.seek(0)
    server.serve("127.0.0.1", 0, head)
    assert {"/tick", "/tf", "/state", "/scene/robot"} <= set(at_start)
    assert at_start == created


class Sdk:
    """Foxglove's module as far as a relay uses it: notes what goes out on which topic."""

    def __init__(self):
        self.sent = []

    def Schema(self, **said):
        return said

    def Channel(self, topic, *, schema, message_encoding, context):
        assert (schema["encoding"], message_encoding) == ("jsonschema", "json")
        sdk = self

        class Channel:
            def log(self, data, log_time):
                sdk.sent.append((topic, log_time, data))

        return Channel()


def test_live_messages_equal_an_export_with_unchanged_scenes_repeated_each_second(log, converted):
    """Relay a flight: the same messages, with the scenes repeated for later clients."""
    sdk = Sdk()
    relay = server.Relay(sdk, None)
    with log.path.open("rb") as file:
        for topic, record in mcap_file.stream(file, server.RECORD_MAX):
            relay.take(topic, record)
    for topic in ("/tf", "/state", "/tick"):
        relayed = [(at, json.loads(data)) for name, at, data in sdk.sent if name == topic]
        assert relayed == [(at, said) for at, _, said in converted.messages[topic]]
    again = [at for name, at, _ in sdk.sent if name == "/scene/robot"]
    assert len(again) == pytest.approx(log.duration_s, abs=1.5)
    assert {name for name, _, _ in sdk.sent} <= {one.topic for one in converter.channels()} | set(converted.channels)
