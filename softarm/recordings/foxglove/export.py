"""Export of a log for Foxglove: the messages in wall-clock time, with a scene, plots and a journal."""

import re
from collections.abc import Callable, Iterable
from importlib.resources import files
from pathlib import Path

from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import Writer
from pydantic import ValidationError

from softarm.common import files as atomic
from softarm.recordings import flight, mcap_file
from softarm.recordings.foxglove import converter
from softarm.recordings.foxglove.converter import Converter
from softarm.recordings.live import LIBRARY, LogMessage, register
from softarm.recordings.log_file import LogFile
from softarm.reporting.colours import on_any_ground
from softarm.schemas.events import Entry

Advance = Callable[[], None]


def layout() -> str:
    """Return the layout for Foxglove: 3D, plots, states and journal, in the colours of `softarm.reporting`."""
    text = (files("softarm.recordings.foxglove") / "layout.json").read_text(encoding="utf-8")
    return re.sub(r'"color": "([a-z]+)"', lambda found: f'"color": "{_hex(found[1])}"', text)


def _hex(name: str) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in on_any_ground(name))


def export(log: LogFile, target: Path, entries: Iterable[Entry], advance: Advance = lambda: None) -> None:
    """Write a log and its events for Foxglove; the log itself is not changed.

    Raises:
        LogError: The log cannot be read.
        OSError: The file cannot be written.
    """
    offset_ns = flight.wall_minus_monotonic_ns(log.path, log.metadata)
    changing = Converter(log.config, offset_ns)
    with atomic.replacing(target) as file:
        writer = Writer(file)
        writer.start(profile="", library=LIBRARY)
        ids = {channel.topic: register(writer, *channel) for channel in converter.channels()}
        topics: dict[int, str] = {}
        schemas: dict[int, Schema] = {}
        count = 0

        def put(message: LogMessage) -> None:
            nonlocal count
            count += 1
            writer.add_message(ids[message.topic], message.log_time, message.data, message.publish_time, count)

        for record in mcap_file.records(log.path):
            match record:
                case Schema():
                    schemas[record.id] = record
                case Channel():
                    topics[record.id] = record.topic
                    if record.topic not in ids:  # a finished log repeats it at its end
                        ids[record.topic] = register(writer, *converter.own(record, schemas[record.schema_id]))
                case Metadata():
                    writer.add_metadata(record.name, record.metadata)
                case Message():
                    advance()
                    topic = topics[record.channel_id]
                    try:
                        for message in changing.take(topic, record.log_time, record.publish_time, record.data):
                            put(message)
                    except ValidationError as error:
                        raise flight.unreadable(log.path, topic, error) from None
        if not changing.has_events:
            for entry in entries:
                put(changing.journal(entry))
        writer.finish()
