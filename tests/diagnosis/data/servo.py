"""Recording of a servo and its stage file, for tests of tables."""

import numpy as np

from softarm.diagnosis.data import tables

T = np.arange(200) * 0.02
COMMAND, MEASURED = 0.5 * np.sin(3 * T), 0.5 * np.sin(3 * (T - 0.1))
STAGE = """
name: servo
kind: tracking
channels:
  command: {time: {source: t, unit: s}, columns: {command: {source: u, unit: rad}}}
  measured: {time: {source: t, unit: s}, columns: {position: {source: y, unit: rad}}}
trials:
  - {name: one, kind: sine, files: data.csv}
"""


def table(head="t,u,y", *columns, delimiter=",", decimal="."):
    """Return a text table; by default that of the servo."""
    cells = zip(*(columns or (T, COMMAND, MEASURED)), strict=True)
    rows = [delimiter.join(f"{x:.9f}".replace(".", decimal) for x in row) for row in cells]
    return "\n".join([*([head] if head else []), *rows, ""])


def changed(stage, *changes):
    """Return a stage file with replaced texts."""
    for old, new in changes:
        assert old in stage
        stage = stage.replace(old, new)
    return stage


def read(folder, text, *changes, stage=STAGE, name="data.csv", coding="utf-8"):
    """Write a table and a stage file with changes, and read the trials."""
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text, encoding=coding)
    (folder / "stage.yaml").write_text(changed(stage, *changes))
    return tables.read(folder / "stage.yaml")
