"""Small YAML files into their schema, with an error that names file, line, key and what is allowed."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from softarm.common import yaml_lines
from softarm.common.yaml_lines import FileError, Place
from softarm.common.yaml_schema import fit
from softarm.diagnosis.data.trials import TrialError

M = TypeVar("M", bound=BaseModel)
Findings = Mapping[Place, Callable[[], str]]


def load(path: Path, schema: type[M], example: str, more: Callable[[Any], Findings] = lambda data: {}) -> M:
    """Read a file. Raises TrialError when it cannot be read or does not fit; `example` shows what would.

    more: what is wrong with the file's plain data beyond the schema, by place.
    """
    try:
        document = yaml_lines.read(path, f"write one, e.g. {example}")
        return fit(document, schema, more(document.data))
    except FileError as error:
        raise TrialError(str(error)) from None
