"""The recorded flight as an export for Foxglove, read back by independent libraries."""

import json
from collections import defaultdict

import pytest
from mcap.reader import make_reader

from softarm.recordings.foxglove import converter


class Converted:
    """By topic: schema, and messages as (log_time, publish_time, what JSON says)."""

    def __init__(self, path):
        self.path = path
        self.schemas, self.channels, self.messages = {}, {}, defaultdict(list)
        with path.open("rb") as file:
            reader = make_reader(file)
            for schema, channel, message in reader.iter_messages():
                self.schemas[channel.topic] = schema
                self.channels[channel.topic] = channel
                said = json.loads(message.data, parse_constant=pytest.fail)
                self.messages[channel.topic].append((message.log_time, message.publish_time, said))
            self.metadata = {record.name: record.metadata for record in reader.iter_metadata()}

    def __getitem__(self, topic):
        return [said for _, _, said in self.messages[topic]]


@pytest.fixture(scope="session")
def converted(log, tmp_path_factory):
    target = tmp_path_factory.mktemp("foxglove") / "flight-foxglove.mcap"
    converter.export(log, target, log.entries())
    return Converted(target)
