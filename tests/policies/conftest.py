"""The shipped policy `reach` as a file that a test may change."""

from collections.abc import Callable
from pathlib import Path

import onnx
import pytest
from onnx import helper

from softarm.policies.base import MODELS
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.schemas.policy import METADATA_KEY, Golden

WriteModel = Callable[..., Path]


@pytest.fixture
def golden() -> Golden:
    """Return the golden run of the unchanged file, which torch has computed."""
    return OnnxPolicy("reach").metadata.golden


@pytest.fixture
def write_model(tmp_path: Path) -> WriteModel:
    """Write the file with changes to the metadata, without an output, or with `metadata=None`."""

    def write(name: str = "small.onnx", drop_output: str = "", **changes: object) -> Path:
        model = onnx.load(MODELS / "reach.onnx")
        if drop_output:
            kept = [output for output in model.graph.output if output.name != drop_output]
            del model.graph.output[:]
            model.graph.output.extend(kept)
        text = OnnxPolicy("reach").metadata.model_copy(update=changes).model_dump_json()
        helper.set_model_props(model, {} if changes.get("metadata", "") is None else {METADATA_KEY: text})
        path = tmp_path / name
        path.write_bytes(model.SerializeToString())
        return path

    return write
