"""The notebooks of examples/notebooks run from the first cell to the last, and hold no outputs."""

import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = Path(__file__).parents[2] / "examples" / "notebooks"

pytestmark = pytest.mark.slow


def cells(name: str) -> list[dict[str, Any]]:
    return list(json.loads((NOTEBOOKS / name).read_text(encoding="utf-8"))["cells"])


def run(name: str, shown: str = "", instead: str = "") -> dict[str, Any]:
    """Execute all code cells, one text replaced, and return their names."""
    source = "\n".join("".join(cell["source"]) for cell in cells(name) if cell["cell_type"] == "code")
    assert shown in source
    names: dict[str, Any] = {}
    exec(source.replace(shown, instead), names)
    return names


def test_the_notebooks_hold_no_outputs() -> None:
    notebooks = sorted(path.name for path in NOTEBOOKS.glob("*.ipynb"))
    assert notebooks == ["diagnose.ipynb", "fly.ipynb"]
    for name in notebooks:
        for cell in cells(name):
            assert not cell.get("outputs")
            assert cell.get("execution_count") is None


def test_the_notebook_of_a_flight_reaches_the_target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names = run("fly.ipynb")
    assert names["flight"].reached
    assert (tmp_path / "swing.html").is_file()


@pytest.mark.prove
def test_the_notebook_of_a_diagnosis_names_the_hidden_delay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # The last of its three recordings suffices and is diagnosed in a quarter of the time.
    names = run("diagnose.ipynb", '("sinusoid", "rail-multisine", "pressure-multisine")', '("pressure-multisine",)')
    (effect,) = names["diagnosis"].verdict.effects
    assert effect.name == "pressure.dead_time"
    assert effect.parameters["delay"].low < 0.06 < effect.parameters["delay"].high
