"""Small YAML files into their schema, with an error that names file, key and what is allowed."""

from pathlib import Path
from typing import TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from softarm.diagnosis.trials import TrialError

M = TypeVar("M", bound=BaseModel)


def load(path: Path, schema: type[M], example: str) -> M:
    """Read a file. Raises TrialError when it cannot be read or does not fit; `example` shows what would."""
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise TrialError(f"{path}: cannot be read ({error.strerror}); write one, e.g. {example}") from None
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise TrialError(f"{path}: is not YAML text ({' '.join(str(error).split())}); e.g. {example}") from None
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        problems = [
            f"{path}: {'.'.join(map(str, item['loc'])) or 'the file'}: {item['msg']}"
            for item in error.errors(include_url=False)
        ]
        raise TrialError("\n".join(problems) + f"\nwrite e.g. {example}") from None
