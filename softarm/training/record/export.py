"""Export of a trained network as an ONNX file with metadata and a golden run.

The graph is built by hand: operator set 17, float32, raw physical values in, actions in -1..1 out, the recurrent
state explicit. Inputs `observation` [batch, 10] (11 for the shelf), `h_in`, `c_in` [1, batch, 256]; outputs `action`
[batch, 2], `h_out`, `c_out`. The self-description (`softarm.schemas.policy.PolicyMetadata`) is JSON under the
metadata key `softarm`.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from softarm.common import files, revision
from softarm.schemas.policy import ACTION, METADATA_KEY, OBSERVATION, Golden, PolicyMetadata, TrainingRange
from softarm.schemas.robot import PHYSICS_RATE_HZ
from softarm.training.learn import validation
from softarm.training.learn.inference import Act, actor, workers
from softarm.training.learn.network import CLIP, PolicyNetwork
from softarm.training.record.checkpoint import CheckpointError, Settings, load_policy, task_of
from softarm.training.record.curve import Iteration, validated
from softarm.training.task.environment import environment_of
from softarm.training.task.reach import ReachTask

Array = NDArray[np.float32]

OPSET = 17
GOLDEN_STEPS = 100
IR_VERSION = 8  # the oldest for operator set 17, so that old runtimes read it


class Graph:
    """Builder of an ONNX graph; each method adds nodes and returns the name of their output."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.weights: list[onnx.TensorProto] = []

    def weight(self, name: str, values: torch.Tensor | np.ndarray) -> str:
        """Add a constant with these values."""
        array = values.detach().numpy() if isinstance(values, torch.Tensor) else values
        self.weights.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def node(self, kind: str, inputs: list[str], outputs: list[str], **attributes: object) -> str:
        """Add an operator and return its first output."""
        self.nodes.append(helper.make_node(kind, inputs, outputs, **attributes))
        return outputs[0]

    def linear(self, name: str, module: torch.nn.Linear, x: str) -> str:
        """Add a layer of weights and biases."""
        inputs = [x, self.weight(f"{name}_weight", module.weight), self.weight(f"{name}_bias", module.bias)]
        return self.node("Gemm", inputs, [name], transB=1)

    def clip(self, x: str, bound: float, output: str, of: str) -> str:
        """Clip at +-bound; `of` is the prefix of the bounds' names."""
        ends = (("low", -bound), ("high", bound))
        limits = [self.weight(f"{of}_{name}", np.array(end, dtype=np.float32)) for name, end in ends]
        return self.node("Clip", [x, *limits], [output])

    def normalised(self, mean: torch.Tensor | np.ndarray, scale: torch.Tensor | np.ndarray, cut: float) -> str:
        """Normalise the observation and clip it at +-cut, which may be infinite."""
        centred = self.node("Sub", ["observation", self.weight("observation_mean", mean)], ["centred"])
        scaled = self.node("Div", [centred, self.weight("observation_scale", scale)], ["scaled"])
        return self.clip(scaled, cut, "normalised", "observation") if np.isfinite(cut) else scaled

    def pass_state(self) -> None:
        """Pass the state through, for a network without recurrence."""
        for name in ("h", "c"):
            self.node("Identity", [f"{name}_in"], [f"{name}_out"])

    def mlp(self, network: PolicyNetwork, x: str) -> str:
        """Add the dense layers of a network."""
        modules = (module for module in network.mlp if isinstance(module, torch.nn.Linear))
        for k, module in enumerate(modules):
            x = self.node("Elu", [self.linear(f"mlp_{k}", module, x)], [f"mlp_{k}_elu"])
        return x

    def lstm(self, network: PolicyNetwork, x: str) -> str:
        """Add the recurrent cell and its LayerNorm."""
        size = network.shape.state

        def gates(values: torch.Tensor) -> torch.Tensor:
            i, f, g, o = values.detach().chunk(4)
            return torch.cat((i, o, f, g))  # ONNX orders the gates input, output, forget, cell

        axis = self.weight("axis_0", np.array([0], dtype=np.int64))
        inputs = [
            self.node("Unsqueeze", [x, axis], ["sequence"]),
            self.weight("lstm_w", gates(network.w_x)[None]),
            self.weight("lstm_r", gates(network.w_h)[None]),
            self.weight("lstm_b", torch.cat((gates(network.bias), torch.zeros(4 * size)))[None]),
            "",
            "h_in",
            "c_in",
        ]
        self.node("LSTM", inputs, ["", "h_out", "c_out"], hidden_size=size)
        hidden = self.node("Squeeze", ["h_out", axis], ["hidden"])
        norm = network.layer_norm
        inputs = [hidden, self.weight("norm_scale", norm.weight), self.weight("norm_bias", norm.bias)]
        return self.node("LayerNormalization", inputs, ["normed"], axis=-1, epsilon=norm.eps)


def onnx_model(network: PolicyNetwork) -> onnx.ModelProto:
    """Build the graph of a network. Raises onnx.checker.ValidationError if it is malformed."""
    shape, graph, statistics = network.shape, Graph(), network.observation_normaliser
    x = graph.normalised(statistics.mean.float(), statistics.scale(), CLIP)
    if shape.order == "mlp-lstm":
        both = graph.node("Concat", [graph.mlp(network, x), x], ["features"], axis=1)
        features = graph.lstm(network, both)
    elif shape.order == "lstm-mlp":
        features = graph.mlp(network, graph.lstm(network, x))
    else:
        features = graph.mlp(network, x)
        graph.pass_state()
    graph.clip(graph.linear("head", network.mean_head, features), 1.0, "action", "action")
    return finished(graph, shape.inputs, shape.state)


def finished(graph: Graph, inputs: int, state_size: int) -> onnx.ModelProto:
    """Add the inputs and outputs that the daemon expects, and check the model."""

    def signal(name: str, *dimensions: int | str) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, dimensions)

    state = (1, "batch", state_size)
    whole = helper.make_graph(
        graph.nodes,
        "softarm_policy",
        [signal("observation", "batch", inputs), signal("h_in", *state), signal("c_in", *state)],
        [signal("action", "batch", len(ACTION)), signal("h_out", *state), signal("c_out", *state)],
        graph.weights,
    )
    model = helper.make_model(whole, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    onnx.checker.check_model(model, full_check=True)
    return model


def export_checkpoint(source: Path, target: Path) -> None:
    """Export a checkpoint as an ONNX policy named after its task. Raises CheckpointError."""
    network, saved = load_policy(source)
    task = task_of(source, saved)
    if not task.muscle:
        _vent(network)
    shares = validated([Iteration(*row) for row in saved["curve"]])
    settings = saved["settings"] | {"run.frames": saved["frames"], "run.validation_set": validation.chosen_by(task)}
    success = shares[-1] if shares else 0.0
    with workers(1) as pool:
        golden = golden_run(actor(network, 1, pool), task)
    description = described(task, network.shape.state, settings, saved["seed"], success, golden)
    write_model(onnx_model(network), description, target)


def _vent(network: PolicyNetwork) -> None:
    """Fix the pressure at 0 for a network that was trained without the muscle."""
    low, high = ACTION[1].low, ACTION[1].high
    assert low is not None
    assert high is not None
    with torch.no_grad():
        network.mean_head.weight[1] = 0.0
        network.mean_head.bias[1] = -2.0 * low / (high - low) - 1.0


def golden_run(act: Act, task: ReachTask) -> Golden:
    """Record a run of one robot to a typical target, which the exported file must reproduce.

    Raises CheckpointError if an action is not finite.
    """
    # No radius: passing the target does not end the run.
    recorded = replace(task, action_noise=0.0, success_radius_m=0.0, episode_steps=GOLDEN_STEPS + 1)
    environment = environment_of(recorded, 1, seed=0, physics_rate_hz=PHYSICS_RATE_HZ)
    target = np.array([[np.mean(task.target_y_m), np.mean(task.target_z_m)]], dtype=np.float32)
    observation = environment.reset(validation.at_rest(np.array([0.1]), environment.simulator.links), target)
    inputs, outputs = [], []
    for _ in range(GOLDEN_STEPS):
        inputs.append(tuple(observation[0].tolist()))
        action = act(observation, np.ones(1, np.bool_))
        if not np.isfinite(action).all():
            raise CheckpointError(
                f"the network's action is {action[0].tolist()} in the golden run; allowed are finite actions: the "
                "training has diverged, train again with a smaller ppo.learning_rate"
            )
        outputs.append(tuple(action[0].tolist()))
        observation = environment.step(action).observation
    return Golden(inputs=tuple(inputs), outputs=tuple(outputs))


def described(
    task: ReachTask, state_size: int, settings: Settings, seed: int, validation_success: float, golden: Golden
) -> PolicyMetadata:
    """Return the metadata of a policy with a given golden run."""
    return PolicyMetadata(
        name=task.name,
        task=task.kind,
        rate_hz=task.rate_hz,
        observation=OBSERVATION,
        goal=task.goal,
        action=ACTION,
        state_size=state_size,
        rail_limit_m=task.rail_limit_m,
        episode_steps=task.episode_steps,
        trained=TrainingRange(target_y_m=task.target_y_m, target_z_m=task.target_z_m, cart_start_m=task.cart_start_m),
        training=settings,
        seed=seed,
        git_revision=revision.revision(),
        validation_success=validation_success,
        golden=golden,
    )


def write_model(model: onnx.ModelProto, description: PolicyMetadata, path: Path) -> None:
    """Write a graph as a policy file, atomically."""
    helper.set_model_props(model, {METADATA_KEY: description.model_dump_json()})
    path.parent.mkdir(parents=True, exist_ok=True)
    files.write_bytes(path, model.SerializeToString())
