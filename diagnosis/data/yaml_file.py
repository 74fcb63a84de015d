"""Small YAML files into their schema, with an error that names file, line, key and what is allowed."""

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel

from softarm.common import yaml_lines
from softarm.common.yaml_lines import FileError
from softarm.common.yaml_schema import fit
from softarm.diagnosis.data.trials import TrialError

M = TypeVar("M", bound=BaseModel)


def load(path: Path, schema: type[M], example: str) -> M:
    """Read a file. Raises TrialError when it cannot be read or does not fit; `example` shows what would."""
    try:
        return fit(yaml_lines.read(path, f"write one, e.g. {example}"), schema)
    except FileError as error:
        raise TrialError(str(error)) from None
