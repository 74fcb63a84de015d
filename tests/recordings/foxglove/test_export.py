"""Export for Foxglove: its types, wall-clock times, all data, an unchanged log."""

import json
from datetime import UTC, datetime

import jsonschema
import pytest

from softarm.diagnosis.data import mcap
from softarm.recordings import live
from softarm.recordings.foxglove import converter
from softarm.schemas.config import Config
from softarm.schemas.log import Metadata
from softarm.schemas.messages import MocapFrame

OWN = {"/event", "/mocap", "/pressure", "/rail", "/request", "/tick"}
TYPES = {
    "/tf_static": "foxglove.FrameTransforms",
    "/tf": "foxglove.FrameTransforms",
    "/scene/robot": "foxglove.SceneUpdate",
    "/scene/target": "foxglove.SceneUpdate",
    "/scene/shelf": "foxglove.SceneUpdate",
    "/scene/trail": "foxglove.SceneUpdate",
    "/log": "foxglove.Log",
}


def test_the_channels_declare_foxgloves_types(converted):
    assert set(converted.messages) == OWN | set(TYPES) | {"/state"}
    for topic, schema in converted.schemas.items():
        assert schema.encoding == "jsonschema"
        assert converted.channels[topic].message_encoding == "json"
        assert topic not in TYPES or schema.name == TYPES[topic]


@pytest.mark.parametrize("topic", [*TYPES, "/state"])
def test_every_message_is_as_its_schema_says(converted, topic):
    schema = json.loads(converted.schemas[topic].data)
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    for said in converted[topic][::7] + converted[topic][-1:]:
        validator.validate({name: value for name, value in said.items() if value is not None or topic != "/state"})


READ = {"boolean", "string", "number", "integer", "object", "array"}


def unread(node, where):
    """Return the parts of a schema that Foxglove Studio 1.48 rejects (mcap-support, parseJsonSchema)."""
    if "oneOf" in node and all(isinstance(one.get("const"), int) for one in node["oneOf"]):
        return
    if node.get("type") not in READ:
        yield where
    for name, field in node.get("properties", {"": {}} if node.get("type") == "object" else {}).items():
        yield from unread(field, f"{where}.{name}")
    if node.get("type") == "array":
        yield from unread(node["items"], f"{where}[]")


def test_every_schema_is_one_that_foxglove_reads(converted):
    """Foxglove needs one type per field and drops the whole topic otherwise."""
    for topic, schema in converted.schemas.items():
        assert list(unread(json.loads(schema.data, parse_constant=pytest.fail), topic)) == []


@pytest.mark.parametrize("topic", TYPES)
def test_foxgloves_own_definitions_know_every_field(converted, topic):
    """Its SDK's Protobuf descriptors, which refuse what they do not know: no schema of ours is believed here."""
    messages = pytest.importorskip("foxglove").messages
    from google.protobuf import descriptor_pb2, json_format, message_factory

    kind = TYPES[topic]
    schema = getattr(messages, kind.removeprefix("foxglove.")).get_schema()
    described = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
    parsed = message_factory.GetMessages(described.file)[schema.name]
    for said in converted[topic][::7] + converted[topic][-1:]:
        message = json_format.ParseDict(protobuf_times(said), parsed())
        assert json_format.MessageToDict(message)


def protobuf_times(said):
    """Protobuf's JSON has times as texts, durations too."""
    if isinstance(said, dict):
        if said.keys() == {"sec", "nsec"}:
            return f"{datetime.fromtimestamp(said['sec'], UTC):%Y-%m-%dT%H:%M:%S}.{said['nsec']:09d}Z"
        return {
            name: f"{value['sec']}s" if name == "lifetime" else protobuf_times(value) for name, value in said.items()
        }
    return [protobuf_times(each) for each in said] if isinstance(said, list) else said


def test_every_time_is_wall_clock_time(converted, log):
    offset_ns = int(log.metadata["clock"]["wall_minus_monotonic_ns"])
    ticks = [inputs.t_ns + offset_ns for inputs, _ in log.ticks()]
    assert (
        [at for at, _, _ in converted.messages["/tick"]] == ticks == [at for at, _, _ in converted.messages["/state"]]
    )
    assert f"{datetime.fromtimestamp(ticks[0] / 1e9, UTC):%Y-%m-%d}" == "2026-11-23"
    taken = [frame.t_capture_ns + offset_ns for inputs, _ in log.ticks() for frame in inputs.mocap]
    assert [at for _, at, _ in converted.messages["/tf"]] == taken
    stamps = [said["transforms"][0]["timestamp"] for said in converted["/tf"]]
    assert [stamp["sec"] * 10**9 + stamp["nsec"] for stamp in stamps] == taken


def test_the_export_contains_the_whole_log(converted, log):
    trial, original = mcap.read(converted.path), mcap.read(log.path)
    assert trial.kind == original.kind
    for name, series in original.channels.items():
        assert trial.channels[name].t_s.tolist() == series.t_s.tolist()
        for column, values in series.columns.items():
            assert trial.channels[name][column].tobytes() == values.tobytes()
    written: Metadata = log.metadata
    assert converted.metadata == {name: dict(values) for name, values in written.items()}


def test_a_frame_stamped_by_another_clock_does_not_stop_the_trail(log):
    """The stamps of two frames are an hour ahead."""
    (one, *_) = (frame for inputs, _ in log.ticks() for frame in inputs.mocap)
    hour_ns, step_ns = 3_600_000_000_000, converter.TRAIL_STEP_NS
    trail = converter.Converter(Config(), 0)
    added = []
    for number, ahead_ns in enumerate((0, 0, hour_ns, hour_ns + step_ns, 0, 0)):
        t_ns = one.t_receive_ns + number * step_ns
        frame = MocapFrame(number, t_ns + ahead_ns, t_ns, one.bodies)
        topics = [each.topic for each in trail.take("/mocap", t_ns, t_ns, live.MOCAP.encode(frame))]
        added.append(converter.TRAIL in topics)
    assert added == [True, True, False, False, True, True]


def test_the_journal_lists_events_even_without_log_entries(converted, log):
    entries = list(log.entries())
    assert [said["message"] for said in converted["/log"]] == [entry.text for entry in entries]
    levels = {entry.text: said["level"] for entry, said in zip(entries, converted["/log"], strict=True)}
    stop = next(text for text in levels if text.startswith("emergency stop"))
    refused = next(text for text in levels if "refused" in text)
    assert (levels[stop], levels[refused], levels["arm"]) == (4, 3, 2)


def test_the_plotted_numbers_are_the_ticks(converted, log):
    for said, (inputs, outputs, _) in zip(converted["/state"], log, strict=True):
        assert (said["mode"], said["cart_velocity_sent_m_s"]) == (outputs.mode, outputs.sent.cart_velocity_m_s)
        assert said["pressure_measured_kpa"] == inputs.pressure.pressure_kpa
        assert said["tip_y_m"] == outputs.observed.values.tip_y_m


def test_lines_have_a_gap_while_nothing_is_requested(converted, log):
    """Foxglove draws a straight line over absent fields, and none over null."""
    requested = [outputs.action is not None for _, outputs, _ in log]
    assert set(requested) == {True, False}
    assert [said["cart_velocity_requested_m_s"] is not None for said in converted["/state"]] == requested


def test_the_layout_refers_to_existing_channels():
    layout = json.loads(converter.layout())
    topics = {channel.topic for channel in converter.channels()}
    (state,) = (json.loads(channel.json_schema) for channel in converter.channels() if channel.topic == "/state")
    kinds = set()
    for name, panel in layout["configById"].items():
        kinds.add(name.partition("!")[0])
        assert panel["foxglovePanelTitle"]
        for path in panel.get("paths", ()):
            topic, _, field = path["value"].partition(".")
            assert topic in topics
            assert field in state["properties"]
        assert set(panel.get("topics", ())) <= topics
        assert panel.get("topicToRender", "/log") in topics
    assert kinds == {"3D", "Plot", "StateTransitions", "RosOut"}
    assert leaves(layout["layout"]) == set(layout["configById"])
    plotted = {path["value"] for panel in layout["configById"].values() for path in panel.get("paths", ())}
    wanted = ("tip_y_m", "rail_position_m", "pressure_measured_kpa", "late_ms", "mode")
    assert {f"/state.{field}" for field in wanted} <= plotted


def leaves(node):
    return {node} if isinstance(node, str) else leaves(node["first"]) | leaves(node["second"])
