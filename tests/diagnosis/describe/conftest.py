"""Generated recordings of a servo: an angle that follows a command with a lag of 80 ms."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.diagnosis.data.servo import table as text_of

# Time, command and measured angle.
T = np.arange(300) * 0.02
U = 30 * np.sin(2 * T) + 5 * np.sign(np.sin(7 * T))
Y = lfilter([0.0, 0.25], [1.0, -0.75], U)


@pytest.fixture
def table(tmp_path: Path) -> Callable[..., Path]:
    """Write a text table and return its path."""

    def write(name: str, head: str, *columns: Sequence[float], **form: str) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text_of(head, *columns, **form), encoding="utf-8")
        return path

    return write
