"""A trained network as an ONNX file that describes and proves itself.

The graph is built by hand: operator set 17, float32, raw physical values in, actions in -1..1 out, the recurrent
state explicit. Inputs `observation` [batch, 10], `h_in`, `c_in` [1, batch, 256]; outputs `action` [batch, 2],
`h_out`, `c_out`. The self-description (`schemas.policy.PolicyMetadata`) is JSON under the metadata key `softarm`.
"""

import os
import subprocess
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

from schemas.policy import (
    ACTION,
    METADATA_KEY,
    OBSERVATION,
    REACH_GOAL,
    Golden,
    PolicyMetadata,
    TrainingRange,
)
from training.environment import Environment
from training.evaluation import at_rest
from training.inference import infer, workers
from training.network import PolicyNetwork
from training.normaliser import CLIP
from training.tasks import ReachTask

OPSET = 17
IR_VERSION = 8  # the one that came with operator set 17: old runtimes read it
Settings = dict[str, str | float | int | bool | list[float] | None]


def onnx_model(network: PolicyNetwork) -> onnx.ModelProto:
    """Build the graph. Raises onnx.checker.ValidationError if it were malformed."""
    shape, size = network.shape, network.shape.state
    weights: list[onnx.TensorProto] = []
    nodes: list[onnx.NodeProto] = []

    def weight(name: str, values: torch.Tensor | np.ndarray) -> str:
        array = values.detach().numpy() if isinstance(values, torch.Tensor) else values
        weights.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def node(kind: str, inputs: list[str], outputs: list[str], **attributes: object) -> str:
        nodes.append(helper.make_node(kind, inputs, outputs, **attributes))
        return outputs[0]

    def limits(name: str, bound: float) -> list[str]:
        return [
            weight(f"{name}_low", np.array(-bound, dtype=np.float32)),
            weight(f"{name}_high", np.array(bound, dtype=np.float32)),
        ]

    normaliser = network.observation_normaliser
    centred = node("Sub", ["observation", weight("observation_mean", normaliser.mean.float())], ["centred"])
    scaled = node("Div", [centred, weight("observation_scale", normaliser.scale())], ["scaled"])
    x = node("Clip", [scaled, *limits("observation", CLIP)], ["normalised"])

    layer = x
    linear = [module for module in network.mlp if isinstance(module, torch.nn.Linear)]
    for k, module in enumerate(linear):
        inputs = [layer, weight(f"mlp_{k}_weight", module.weight), weight(f"mlp_{k}_bias", module.bias)]
        layer = node("Elu", [node("Gemm", inputs, [f"mlp_{k}"], transB=1)], [f"mlp_{k}_elu"])
    features = node("Concat", [layer, x], ["features"], axis=1)

    def to_onnx_gates(values: torch.Tensor) -> torch.Tensor:
        i, f, g, o = values.detach().chunk(4)
        return torch.cat((i, o, f, g))  # ONNX orders the gates input, output, forget, cell

    axis = weight("axis_0", np.array([0], dtype=np.int64))
    bias = torch.cat((to_onnx_gates(network.bias), torch.zeros(4 * size)))
    inputs = [
        node("Unsqueeze", [features, axis], ["sequence"]),
        weight("lstm_w", to_onnx_gates(network.w_x)[None]),
        weight("lstm_r", to_onnx_gates(network.w_h)[None]),
        weight("lstm_b", bias[None]),
        "",
        "h_in",
        "c_in",
    ]
    node("LSTM", inputs, ["", "h_out", "c_out"], hidden_size=size)
    hidden = node("Squeeze", ["h_out", axis], ["hidden"])
    norm = network.layer_norm
    inputs = [hidden, weight("norm_scale", norm.weight), weight("norm_bias", norm.bias)]
    normed = node("LayerNormalization", inputs, ["normed"], axis=-1, epsilon=norm.eps)
    head = network.mean_head
    inputs = [normed, weight("head_weight", head.weight), weight("head_bias", head.bias)]
    mean = node("Gemm", inputs, ["mean"], transB=1)
    node("Clip", [mean, *limits("action", 1.0)], ["action"])

    def signal(name: str, *dimensions: int | str) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, dimensions)

    state = (1, "batch", size)
    graph = helper.make_graph(
        nodes,
        "softarm_policy",
        [signal("observation", "batch", shape.inputs), signal("h_in", *state), signal("c_in", *state)],
        [signal("action", "batch", shape.actions), signal("h_out", *state), signal("c_out", *state)],
        weights,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    onnx.checker.check_model(model, full_check=True)
    return model


def golden_run(network: PolicyNetwork, task: ReachTask, steps: int = 100) -> Golden:
    """Record a closed-loop run of one robot at a typical target: what the exported file has to reproduce."""
    # No radius: passing the target does not end the run.
    recorded = replace(task, action_noise=0.0, success_radius_m=0.0, episode_steps=steps + 1)
    environment = Environment(recorded, 1, seed=0, physics_rate_hz=1200.0)
    target = np.array([[np.mean(task.target_y_m), np.mean(task.target_z_m)]], dtype=np.float32)
    observation = environment.reset(at_rest(np.array([0.1]), environment.simulator.links), target)
    state = network.initial_state(1)
    inputs, outputs = [], []
    with workers(1) as pool:
        for _ in range(steps):
            inputs.append(tuple(observation[0].tolist()))
            mean, _, state = infer(network, torch.from_numpy(observation), torch.ones(1), state, pool)
            action = mean.clamp(-1.0, 1.0).numpy()
            outputs.append(tuple(action[0].tolist()))
            observation = environment.step(action).observation
    return Golden(inputs=tuple(inputs), outputs=tuple(outputs))


def git_revision() -> str:
    """The source's revision, with `-dirty` when it was changed; `unknown` outside a repository."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()


def metadata(
    network: PolicyNetwork, task: ReachTask, settings: Settings, seed: int, validation_success: float
) -> PolicyMetadata:
    """Say what the policy is and how it came to be."""
    return PolicyMetadata(
        name=task.name,
        task="reach",
        rate_hz=task.rate_hz,
        observation=OBSERVATION,
        goal=REACH_GOAL,
        action=ACTION,
        state_size=network.shape.state,
        rail_limit_m=task.rail_limit_m,
        episode_steps=task.episode_steps,
        trained=TrainingRange(target_y_m=task.target_y_m, target_z_m=task.target_z_m, cart_start_m=task.cart_start_m),
        training=settings,
        seed=seed,
        git_revision=git_revision(),
        validation_success=validation_success,
        golden=golden_run(network, task),
    )


def write(network: PolicyNetwork, description: PolicyMetadata, path: Path) -> None:
    """Write the file in one piece: a reader sees the old file or the new one."""
    model = onnx_model(network)
    helper.set_model_props(model, {METADATA_KEY: description.model_dump_json()})
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    onnx.save(model, temporary)
    os.replace(temporary, path)


def flat_settings(**parts: object) -> Settings:
    """Dataclasses as one flat dictionary, `part.field`, tuples as lists."""
    settings: Settings = {}
    for name, part in parts.items():
        for key, value in asdict(part).items():  # type: ignore[call-overload]
            settings[f"{name}.{key}"] = list(value) if isinstance(value, tuple) else value
    return settings
