"""Trained policy from an ONNX file with metadata; docs/policies/interface.md describes the file."""

import copy
import hashlib
import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import numpy as np
import onnxruntime as ort
from pydantic import ValidationError

from softarm.common import files
from softarm.policies import onnx_graph
from softarm.policies.base import MODELS, Array, PolicyError, PolicySpec
from softarm.schemas.policy import (
    ACTION,
    GOALS,
    METADATA_FORMAT,
    METADATA_KEY,
    OBSERVATION,
    REACH_GOAL,
    PolicyMetadata,
    Signal,
)
from softarm.schemas.robot import CONTROL_RATE_HZ

_WARM_UP_STEPS = 3
DEPTH_M = 0.075  # middle of the depths in the training of shelf policies


class OnnxPolicy:
    """LSTM policy with its state outside the graph; loading replays the file's golden run.

    Args:
        model: A path that ends in .onnx, or the name of a shipped model.
        target_depth_m: Depth of the targets behind the shelf's front edge, which a goal does not contain.

    Raises:
        PolicyError: The file is missing or not ONNX, has other signals, units, order, shapes or rate, or does not
            reproduce its golden run.
    """

    spec = PolicySpec(name="onnx", description="a learned policy from an ONNX file")

    def __init__(self, model: str, target_depth_m: float = DEPTH_M) -> None:
        file = _open(_path(model))
        self.metadata = file.metadata
        self.spec = _with_shelf(file, target_depth_m)
        self._run = file.session.run
        self.target_depth_m = target_depth_m
        self._input = np.zeros((1, len(OBSERVATION) + len(self.metadata.goal)), dtype=np.float32)
        self._outputs = ["action", "h_out", "c_out"]
        low = np.array([signal.low for signal in self.metadata.action], dtype=np.float32)
        high = np.array([signal.high for signal in self.metadata.action], dtype=np.float32)
        self._centre: Array = (high + low) * np.float32(0.5)
        self._half_range: Array = (high - low) * np.float32(0.5)
        self.reset()
        self._replay_golden_run(file.path)
        self.step_s = min(self._timed_step() for _ in range(_WARM_UP_STEPS))  # of the warm-up
        self.reset()

    @classmethod
    def describe(cls, model: str, target_depth_m: float = DEPTH_M) -> PolicySpec:
        """Return the spec of a model without running it. Raises PolicyError as the constructor does."""
        return _with_shelf(_open(_path(model), to_run=False), target_depth_m)

    def reset(self) -> None:
        """Set the recurrent state to zero."""
        shape = (1, 1, self.metadata.state_size)
        self._feed = {
            "observation": self._input,
            "h_in": np.zeros(shape, dtype=np.float32),
            "c_in": np.zeros(shape, dtype=np.float32),
        }

    def step(self, observation: Array, goal: Array) -> Array:
        """Return [cart velocity m/s, pressure kPa]: the network's -1..1 scaled to the metadata's ranges."""
        self._input[0, : len(OBSERVATION)] = observation
        end = len(OBSERVATION) + len(REACH_GOAL)
        self._input[0, len(OBSERVATION) : end] = goal
        self._input[0, end:] = self.target_depth_m  # an empty slice for a reach task
        action: Array = self._centre + self._half_range * self._advance()
        return action

    def replica(self) -> "OnnxPolicy":
        """Return a policy on the same network with a state of its own."""
        other = copy.copy(self)
        other._input = self._input.copy()
        other.reset()
        return other

    def _timed_step(self) -> float:
        """Run one step on zeros and return its time, s."""
        start_s = monotonic()
        self.step(np.zeros(len(OBSERVATION), np.float32), np.zeros(len(REACH_GOAL), np.float32))
        return monotonic() - start_s

    def _advance(self) -> Array:
        """Run the network on `_input`, carry its state, return its action [2] in -1..1."""
        feed = self._feed
        action, feed["h_in"], feed["c_in"] = self._run(self._outputs, feed)
        row: Array = action[0]
        return row

    def golden_error(self) -> tuple[float, int]:
        """Replay the golden run and return the largest error (of actions in -1..1) and its step; resets the policy."""
        golden = self.metadata.golden
        errors = np.empty(len(golden.inputs))
        self.reset()
        with np.errstate(over="ignore", invalid="ignore"):  # numbers beyond float32 give the error NaN
            for number, (inputs, expected) in enumerate(zip(golden.inputs, golden.outputs, strict=True)):
                self._input[0] = inputs
                errors[number] = np.max(np.abs(self._advance() - np.array(expected, dtype=np.float32)))
        self.reset()
        worst = int(np.argmax(errors))  # the first NaN, if there is one
        return float(errors[worst]), worst

    def _replay_golden_run(self, path: Path) -> None:
        allowed = self.metadata.golden.tolerance
        off, step = self.golden_error()
        if not off <= allowed:
            raise PolicyError(
                f"{path}: its golden run is off by {off:.2g} at step {step}; allowed "
                f"{allowed:.2g}: the file is damaged or was altered, export it again"
            )


class _File(NamedTuple):
    path: Path
    session: Any  # onnxruntime.InferenceSession; it carries no types
    metadata: PolicyMetadata
    spec: PolicySpec


def _with_shelf(file: _File, target_depth_m: float) -> PolicySpec:
    return replace(file.spec, shelf_depth_m=target_depth_m) if file.metadata.task == "shelf" else file.spec


def _path(model: str) -> Path:
    """Return the path of a model: `model` itself if it ends in .onnx, else the shipped model of that name."""
    path = Path(model).expanduser() if model.endswith(".onnx") else MODELS / f"{model}.onnx"
    if files.is_file(path):
        return path.absolute()
    shipped = ", ".join(sorted(file.stem for file in MODELS.glob("*.onnx"))) or "none"
    raise PolicyError(
        f"option model is '{model}': no file {path.absolute()}; give a path that ends in .onnx "
        f"or the name of a shipped model ({shipped})"
    )


def _open(path: Path, to_run: bool = True) -> _File:
    status = path.stat()
    return _read(path, status.st_mtime_ns, status.st_size, to_run)


@lru_cache(maxsize=16)  # listing the policies must not parse every model again; a changed file is another key
def _read(path: Path, _mtime_ns: int, size: int, to_run: bool) -> _File:
    options = ort.SessionOptions()
    if not to_run:  # optimising works out what depends on constants alone, for however long that takes
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    # One thread, no spinning: a pool's hand-over costs milliseconds at p99.9 beside a loaded control loop.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    options.log_severity_level = 3
    try:
        onnx_graph.check_size(size)
        content = path.read_bytes()
        onnx_graph.check(content)  # an endless loop would block the service
        session = ort.InferenceSession(content, options, providers=["CPUExecutionProvider"], enable_fallback=0)
        entries = session.get_modelmeta().custom_metadata_map
    except Exception as error:  # onnxruntime raises a class of its own for every kind of damage
        text = str(error).partition("\n")[0]
        raise PolicyError(f"{path}: not an ONNX model that can be run ({text}); export it again") from error
    metadata = _metadata(path, entries)
    _check_graph(path, session, metadata)
    spec = PolicySpec(
        name=metadata.name,
        description=(
            f"learned ({metadata.task}): tip to y {_span(metadata.trained.target_y_m)}, "
            f"z {_span(metadata.trained.target_z_m)} m; {metadata.validation_success:.0%} in validation"
        ),
        episode_steps=metadata.episode_steps,
        trained=metadata.trained,
        sha256=hashlib.sha256(content).hexdigest(),
    )
    return _File(path, session, metadata, spec)


def _metadata(path: Path, entries: dict[str, str]) -> PolicyMetadata:
    """Read and check the metadata of a file."""
    if METADATA_KEY not in entries:
        raise PolicyError(f"{path}: no metadata under the key '{METADATA_KEY}'; export it with `softarm dev export`")
    if (format_ := _format(entries[METADATA_KEY])) > METADATA_FORMAT:
        raise PolicyError(
            f"{path}: its metadata has format {format_}, this software reads {METADATA_FORMAT}: update it, or export "
            "the policy again with this version"
        )
    try:
        metadata = PolicyMetadata.model_validate_json(entries[METADATA_KEY])
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the whole"
        raise PolicyError(
            f"{path}: metadata: {where}: {first['msg']} (of {error.error_count()} errors); export it again"
        ) from error
    problems = [
        *_signal_problems("observation", metadata.observation, OBSERVATION),
        *_signal_problems("goal", metadata.goal, GOALS[metadata.task]),
        *_signal_problems("action", metadata.action, ACTION),
        *_golden_problems(metadata),
    ]
    if metadata.rate_hz != CONTROL_RATE_HZ:
        problems.append(f"rate_hz is {metadata.rate_hz:g}; the control loop runs at {CONTROL_RATE_HZ}")
    if problems:
        raise PolicyError(f"{path}: metadata: {'; '.join(problems)}: train or export it again for this robot")
    return metadata


def _format(metadata: str) -> int:
    """Return the format of the metadata, or 0 if it states none."""
    try:
        content = json.loads(metadata)
    except (ValueError, RecursionError):
        return 0
    format_ = content.get("format") if isinstance(content, dict) else None
    return format_ if isinstance(format_, int) else 0


def _signal_problems(vector: str, got: tuple[Signal, ...], wanted: tuple[Signal, ...]) -> list[str]:
    """Check that names, units and order match this software, and that an action's range lies within the allowed one."""
    if len(got) != len(wanted):
        return [f"{vector} has {len(got)} elements, not {len(wanted)}"]
    problems = []
    for index, (g, w) in enumerate(zip(got, wanted, strict=True)):
        if (g.name, g.unit) != (w.name, w.unit):
            problems.append(f"{vector} {index} is {g.name} in {g.unit}, not {w.name} in {w.unit}")
        elif w.low is not None and w.high is not None:
            if g.low is None or g.high is None:
                problems.append(f"{vector} {index} ({g.name}) lacks low and high, what -1 and 1 map to")
            elif not w.low <= g.low < g.high <= w.high:
                problems.append(
                    f"{vector} {index} ({g.name}) maps to {g.low:g} .. {g.high:g} {g.unit}; "
                    f"allowed within {w.low:g} .. {w.high:g}"
                )
    return problems


def _golden_problems(metadata: PolicyMetadata) -> list[str]:
    golden = metadata.golden
    width_in, width_out = len(OBSERVATION) + len(metadata.goal), len(ACTION)
    if not golden.inputs or len(golden.inputs) != len(golden.outputs):
        return [
            f"golden has {len(golden.inputs)} inputs and {len(golden.outputs)} outputs; each step needs one of both"
        ]
    if any(len(row) != width_in for row in golden.inputs) or any(len(row) != width_out for row in golden.outputs):
        return [f"golden rows must be {width_in} inputs and {width_out} outputs wide"]
    if not 0 < golden.tolerance <= 1e-2:
        return [f"golden.tolerance is {golden.tolerance:g}; allowed above 0, at most 0.01"]
    return []


def _check_graph(path: Path, session: Any, metadata: PolicyMetadata) -> None:
    """Check names, types and shapes of the graph's inputs and outputs; a named dimension (a batch) counts as 1."""
    state = [1, 1, metadata.state_size]
    wanted_in = {"observation": [1, len(OBSERVATION) + len(metadata.goal)], "h_in": state, "c_in": state}
    wanted_out = {"action": [1, len(ACTION)], "h_out": state, "c_out": state}
    for what, nodes, wanted in (
        ("inputs", session.get_inputs(), wanted_in),
        ("outputs", session.get_outputs(), wanted_out),
    ):
        got = {
            node.name: [size if isinstance(size, int) else 1 for size in node.shape]
            if node.type == "tensor(float)"
            else node.type
            for node in nodes
        }
        if got != wanted:
            raise PolicyError(
                f"{path}: its {what} are {got}; they must be {wanted}, float32: export it with `softarm dev export`"
            )


def _span(ends: tuple[float, float]) -> str:
    return f"{ends[0]:g} .. {ends[1]:g}"
