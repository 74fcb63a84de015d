"""Generated recordings of a servo: an angle that follows a command with a lag of 80 ms."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.data.servo import table as text_of

T = np.arange(300) * 0.02
COMMAND = 30 * np.sin(2 * T) + 5 * np.sign(np.sin(7 * T))
MEASURED = np.zeros(300)
for _k in range(1, 300):
    MEASURED[_k] = MEASURED[_k - 1] + 0.25 * (COMMAND[_k - 1] - MEASURED[_k - 1])


@pytest.fixture
def table(tmp_path: Path) -> Callable[..., Path]:
    """Write a text table and return its path."""

    def write(name: str, head: str, *columns: Sequence[float], **form: str) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text_of(head, *columns, **form), encoding="utf-8")
        return path

    return write


@pytest.fixture
def servo() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time, command and measured angle."""
    return T, COMMAND, MEASURED
