"""Live server for Foxglove: records of a log come in, their messages go out over WebSocket.

It is a separate process, `python -m softarm.recordings.foxglove.server HOST PORT`: the log arrives on standard input,
and the server ends with it. It starts after the log's head and prints one line, the port or an error. Clients can only
watch: the server accepts no message, parameter or call.
"""

import os
import signal
import sys
from collections.abc import Iterator
from typing import Any, BinaryIO

from mcap.records import Channel, McapRecord, Message, Metadata, Schema

from softarm.recordings import mcap_file
from softarm.recordings.foxglove import converter
from softarm.recordings.foxglove.converter import Converter
from softarm.recordings.live import LogMessage
from softarm.schemas import log
from softarm.schemas.config import Config

NAME = "softarm"
REPEAT_S = 1.0  # unchanged scenes are repeated at this interval for later clients
RECORD_MAX = 16_000_000


class Relay:
    """Relay of a log's records, and of the messages that show them, to Foxglove's channels."""

    def __init__(self, foxglove: Any, context: Any) -> None:
        """Create a relay with the SDK's module, which is an extra."""
        self._foxglove, self._context = foxglove, context
        self._schemas: dict[int, Schema] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._converter: Converter | None = None
        self._channels = {one.topic: self._channel(one) for one in converter.channels()}

    @property
    def is_complete(self) -> bool:
        """Return whether every channel exists: the SDK may refuse a channel to a client that connects earlier."""
        return log.CLOCK in self._metadata

    def take(self, topic: str, record: McapRecord) -> None:
        """Relay one record to the clients; a message has a topic."""
        match record:
            case Schema():
                self._schemas[record.id] = record
            case Channel():
                self._channels[record.topic] = self._channel(converter.own(record, self._schemas[record.schema_id]))
            case Metadata():
                self._metadata[record.name] = record.metadata
            case Message():
                for message in self._shown(topic, record):
                    self._channels[message.topic].log(message.data, log_time=message.log_time)

    def _shown(self, topic: str, record: Message) -> Iterator[LogMessage]:
        if self._converter is None:  # the header of a log precedes its messages
            config = Config.model_validate_json(self._metadata[log.CONFIGURATION]["json"])
            offset_ns = int(self._metadata[log.CLOCK]["wall_minus_monotonic_ns"])
            self._converter = Converter(config, offset_ns, REPEAT_S)
        return self._converter.take(topic, record.log_time, record.publish_time, record.data)

    def _channel(self, one: converter.Channel) -> Any:
        schema = self._foxglove.Schema(name=one.schema_name, encoding="jsonschema", data=one.json_schema)
        return self._foxglove.Channel(one.topic, schema=schema, message_encoding="json", context=self._context)


def serve(host: str, port: int, source: BinaryIO) -> None:
    """Serve until the source ends, and print the port or the error."""
    try:
        import foxglove
    except ModuleNotFoundError:
        _say("is not installed: pip install 'softarm[foxglove]'")
        return
    context, server = foxglove.Context(), None
    relay = Relay(foxglove, context)
    try:
        for topic, record in mcap_file.stream(source, RECORD_MAX):
            relay.take(topic, record)
            if server is None and relay.is_complete:
                try:
                    server = foxglove.start_server(name=NAME, host=host, port=port, capabilities=[], context=context)
                except Exception as error:  # the SDK passes on errors of the operating system
                    _say(f"cannot be served at {host}:{port} ({error}); choose another port")
                    return
                _say(str(server.port))
    finally:
        if server is not None:
            server.stop()


def _say(text: str) -> None:
    print(text, flush=True)


def _step_back() -> None:
    """Lower the priority inherited from the daemon and ignore signals, which the daemon handles."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(5)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


if __name__ == "__main__":
    _step_back()
    serve(sys.argv[1], int(sys.argv[2]), sys.stdin.buffer)
