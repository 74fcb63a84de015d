"""A small, whole, valid ONNX policy with random weights; numpy, not onnxruntime, makes its golden run."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from softarm.schemas.policy import ACTION, METADATA_KEY, OBSERVATION, REACH_GOAL, Golden, PolicyMetadata, TrainingRange

STATE = 6
INPUTS = len(OBSERVATION) + len(REACH_GOAL)
WriteModel = Callable[..., Path]


class Network:
    """Normaliser, LSTM (gate order i, o, f, c), linear head, clip: once in numpy, once as a graph."""

    def __init__(self, seed: int = 0) -> None:
        random = np.random.default_rng(seed)

        def weights(*shape: int) -> np.ndarray:
            return (0.4 * random.standard_normal(shape)).astype(np.float32)

        self.mean = weights(INPUTS)
        self.deviation = np.float32(0.5) + np.abs(weights(INPUTS))
        self.w, self.r, self.b = (
            weights(1, 4 * STATE, INPUTS),
            weights(1, 4 * STATE, STATE),
            weights(1, 8 * STATE),
        )
        self.head = weights(STATE, 2) * 4
        self.inputs = random.standard_normal((20, INPUTS)).astype(np.float32)

    def run(self, inputs: np.ndarray) -> np.ndarray:
        """The actions [steps, 2] in -1..1 from a zero state."""
        h, c = np.zeros(STATE), np.zeros(STATE)
        actions = []
        for row in inputs:
            x = (row - self.mean) / self.deviation
            gates = self.w[0] @ x + self.r[0] @ h + self.b[0, : 4 * STATE] + self.b[0, 4 * STATE :]
            i, o, f, g = np.split(gates, 4)
            c = c / (1 + np.exp(-f)) + np.tanh(g) / (1 + np.exp(-i))
            h = np.tanh(c) / (1 + np.exp(-o))
            actions.append(np.clip(h @ self.head, -1, 1))
        return np.array(actions)

    def model(self) -> onnx.ModelProto:
        """The same as an ONNX graph."""
        constants = {
            "mean": self.mean,
            "deviation": self.deviation,
            "w": self.w,
            "r": self.r,
            "b": self.b,
            "head": self.head,
            "low": np.float32(-1),
            "high": np.float32(1),
            "axis": np.array([0], np.int64),
            "direction": np.array([1], np.int64),
        }
        nodes = [
            helper.make_node("Sub", ["observation", "mean"], ["centred"]),
            helper.make_node("Div", ["centred", "deviation"], ["normal"]),
            helper.make_node("Unsqueeze", ["normal", "axis"], ["sequence"]),
            helper.make_node(
                "LSTM",
                ["sequence", "w", "r", "b", "", "h_in", "c_in"],
                ["", "h_out", "c_out"],
                hidden_size=STATE,
            ),
            helper.make_node("Squeeze", ["h_out", "axis"], ["flat"]),
            helper.make_node("MatMul", ["flat", "head"], ["raw"]),
            helper.make_node("Clip", ["raw", "low", "high"], ["action"]),
        ]

        def tensors(**shapes: list[int]) -> list[onnx.ValueInfoProto]:
            return [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in shapes.items()]

        state = [1, 1, STATE]
        graph = helper.make_graph(
            nodes,
            "policy",
            tensors(observation=[1, INPUTS], h_in=state, c_in=state),
            tensors(action=[1, 2], h_out=state, c_out=state),
            [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
        )
        return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)


def metadata_of(network: Network) -> PolicyMetadata:
    """The self-description that a training run would have written."""
    return PolicyMetadata(
        name="small",
        task="reach",
        rate_hz=30,
        observation=OBSERVATION,
        goal=REACH_GOAL,
        action=ACTION,
        state_size=STATE,
        rail_limit_m=0.25,
        episode_steps=100,
        trained=TrainingRange(target_y_m=(-0.4, 0.0), target_z_m=(0.55, 0.7), cart_start_m=(-0.025, 0.25)),
        training={"frames": 0},
        seed=0,
        git_revision="0" * 40,
        validation_success=0.97,
        golden=Golden(inputs=network.inputs.tolist(), outputs=network.run(network.inputs).tolist()),
    )


@pytest.fixture
def network() -> Network:
    return Network()


@pytest.fixture
def write_model(tmp_path: Path, network: Network) -> WriteModel:
    """Call it with changes to the metadata, the name of a tensor to leave out, or `metadata=None`."""

    def write(name: str = "small.onnx", drop_output: str = "", **changes: object) -> Path:
        model = network.model()
        if drop_output:
            kept = [output for output in model.graph.output if output.name != drop_output]
            del model.graph.output[:]
            model.graph.output.extend(kept)
        if changes.get("metadata", "") is not None:
            text = metadata_of(network).model_copy(update=changes).model_dump_json()
            helper.set_model_props(model, {METADATA_KEY: text})
        path = tmp_path / name
        path.write_bytes(model.SerializeToString())
        return path

    return write
