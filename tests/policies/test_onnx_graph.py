"""A model is looked through before any of it runs: no loops, nothing of its own, not too large."""

import contextlib

import onnx
import pytest
from onnx import helper

from softarm.policies import onnx_graph
from softarm.policies.base import MODELS, PolicyError
from softarm.policies.onnx_graph import GraphError, check, operators
from softarm.policies.onnx_policy import OnnxPolicy


def with_nodes(path, nodes) -> bytes:
    model = onnx.load(path)
    model.graph.node.extend(nodes)
    path.write_bytes(model.SerializeToString())
    return path.read_bytes()


def test_the_operators_of_shipped_models_equal_those_of_onnx():
    for path in sorted(MODELS.glob("*.onnx")):
        content = path.read_bytes()
        assert list(operators(memoryview(content))) == [node.op_type for node in onnx.load(path).graph.node]
        check(content)


@pytest.mark.parametrize("kind", ["Loop", "If", "Scan", "Expand", "Tile", "RandomNormal", "Range"])
def test_an_operator_that_no_policy_needs_is_refused_by_name(write_model, kind):
    path = write_model()
    content = with_nodes(path, [helper.make_node(kind, ["observation"], ["more"])])
    with pytest.raises(GraphError, match=f"its graph holds {kind}, which no policy needs"):
        check(content)


def test_a_loop_is_refused_before_the_model_is_loaded(write_model):
    path = write_model()
    with_nodes(path, [helper.make_node("Loop", ["observation"], ["end"])])
    for load in (OnnxPolicy, OnnxPolicy.describe):
        with pytest.raises(PolicyError, match=r"small\.onnx: not an ONNX model that can be run \(its graph holds Loop"):
            load(model=str(path))


def test_foreign_operators_and_custom_functions_are_refused(write_model):
    path = write_model()
    content = with_nodes(path, [helper.make_node("Relu", ["observation"], ["more"], domain="theirs")])
    with pytest.raises(GraphError, match=r"holds theirs\.Relu"):
        check(content)
    model = onnx.load(write_model("function.onnx"))
    node = helper.make_node("Relu", ["x"], ["y"])
    model.functions.append(helper.make_function("theirs", "F", ["x"], ["y"], [node], [helper.make_opsetid("", 17)]))
    with pytest.raises(GraphError, match="holds a custom function"):
        check(model.SerializeToString())


def test_an_oversized_graph_is_refused(write_model, monkeypatch):
    path = write_model()
    nodes = 1000 + len(onnx.load(path).graph.node)
    with pytest.raises(GraphError, match=f"its graph has {nodes} nodes; allowed are 1000"):
        check(with_nodes(path, [helper.make_node("Relu", ["observation"], [f"r{i}"]) for i in range(1000)]))
    monkeypatch.setattr(onnx_graph, "SIZE_MAX", 100)
    with pytest.raises(GraphError, match="allowed are"):
        check(path.read_bytes())


def test_a_model_cut_anywhere_is_read_or_refused(write_model):
    content = write_model().read_bytes()
    for end in range(0, len(content), len(content) // 60):
        with contextlib.suppress(GraphError):
            check(content[:end])
