"""Policy files: ONNX models, planned trajectories, checkpoints of training."""

import zipfile
from dataclasses import asdict
from io import BytesIO
from random import Random

from validation.fuzz import mutate
from validation.fuzz.parsers.base import Parser, folder, parser, written


def _model() -> bytes:
    from softarm.policies.base import MODELS

    return (MODELS / "reach.onnx").read_bytes()


def _changed_ends(random: Random, model: bytes, bytes_of_end: int) -> bytes:
    """Return a model with changes at its start or end, where the weights are not."""
    if random.random() < 0.5:
        return mutate.of_bytes(random, [model[:bytes_of_end]]) + model[bytes_of_end:]
    return model[:-bytes_of_end] + mutate.of_bytes(random, [model[-bytes_of_end:]])


@parser("onnx.graph")
def _graph() -> Parser:
    """Return the check of an ONNX file before it runs."""
    from softarm.policies import onnx_graph

    model = _model()
    examples = [model[:3000], model[:3000] + model[-3000:], model[-3000:]]
    return Parser(lambda random: mutate.of_bytes(random, examples), onnx_graph.check, (onnx_graph.GraphError,))


@parser("onnx.model")
def _onnx() -> Parser:
    """Return the parser of a whole model, including its golden run."""
    from softarm.policies.base import PolicyError
    from softarm.policies.onnx_policy import OnnxPolicy

    model = _model()

    def draw(random: Random) -> bytes:
        if random.random() < 0.2:
            return mutate.of_bytes(random, [model])
        return _changed_ends(random, model, random.choice((500, 4000)))

    return Parser(draw, lambda data: OnnxPolicy(str(written("model.onnx", data))), (PolicyError,))


@parser("onnx.weights")
def _weights() -> Parser:
    """Return the parser of a model whose training continues."""
    from softarm.training.record.checkpoint import CheckpointError
    from softarm.training.run.retrain import load_weights

    model = _model()
    return Parser(
        lambda random: _changed_ends(random, model, random.choice((4000, 20_000))),
        lambda data: load_weights(written("weights.onnx", data)),
        (CheckpointError,),
    )


@parser("onnx.metadata")
def _metadata() -> Parser:
    """Return the parser of a model's metadata with changed meaning."""
    import json

    import onnx

    from softarm.policies.base import MODELS, PolicyError
    from softarm.policies.onnx_policy import OnnxPolicy
    from softarm.schemas.policy import METADATA_KEY

    model = onnx.load(str(MODELS / "reach.onnx"))
    entry = next(each for each in model.metadata_props if each.key == METADATA_KEY)
    tree = json.loads(entry.value)

    def draw(random: Random) -> bytes:
        entry.value = mutate.to_json(random, mutate.of_tree(random, tree)).decode("utf-8", "replace")
        return bytes(model.SerializeToString())

    return Parser(draw, lambda data: OnnxPolicy(str(written("model.onnx", data))), (PolicyError,))


@parser("npz.plans")
def _plans() -> Parser:
    """Return the parser of planned trajectories, a zip of arrays with a wrong zip, header or number."""
    import numpy as np

    from softarm.policies.base import MODELS, PolicyError
    from softarm.policies.trajectory import Trajectory

    source = next(MODELS.glob("*.npz"))
    with np.load(source) as opened:
        arrays = {name: opened[name] for name in opened.files}
    arrays |= {name: array[:3] for name, array in arrays.items() if array.ndim}
    files = {}
    for name, array in arrays.items():
        buffer = BytesIO()
        np.save(buffer, array)
        files[f"{name}.npy"] = buffer.getvalue()

    def zipped(contents: dict[str, bytes]) -> bytes:
        out = BytesIO()
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in contents.items():
                archive.writestr(name, content)
        return out.getvalue()

    good = zipped(files)

    def draw(random: Random) -> bytes:
        if random.random() < 0.4:
            return mutate.of_bytes(random, [good])
        name = random.choice(sorted(files))
        content = files[name]
        changed = mutate.of_bytes(random, [content[:140]]) + content[140:]
        return zipped(files | {name: changed if random.random() < 0.8 else mutate.of_bytes(random, [content])})

    return Parser(draw, lambda data: Trajectory(str(written("plans.npz", data))), (PolicyError,))


@parser("pt.checkpoint")
def _checkpoint() -> Parser:
    import torch

    from softarm.training.learn.network import NetworkShape, PolicyNetwork
    from softarm.training.record import checkpoint

    shape = NetworkShape(mlp=(8,), state=8)
    network = PolicyNetwork(shape)
    plain = {"settings": {}, "task": {}, "seed": 1, "curve": [], "network": asdict(shape)}
    average = {"average": network.state_dict()}
    content = plain | average

    def draw(random: Random) -> bytes:
        path = folder() / "drawn.pt"
        made = content
        if random.random() < 0.6:
            changed = mutate.of_tree(random, plain)
            made = changed | average if isinstance(changed, dict) else changed
        try:
            checkpoint.save(path, made)
        except TypeError:  # the case is not a dict
            torch.save(made, path)
        data = path.read_bytes()
        return data if made is not content else mutate.of_bytes(random, [data])

    return Parser(draw, lambda data: checkpoint.load_policy(written("taken.pt", data)), (checkpoint.CheckpointError,))
