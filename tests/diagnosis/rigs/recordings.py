"""Recordings of rigs, and the effects that a diagnosis names in them."""

from pathlib import Path

import numpy as np

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import Series, TableStage, Trial
from softarm.diagnosis.rigs.diagnose import diagnose_table

# Description of a servo in degrees, with the columns t, u and y.
SERVO = """
kind: tracking
channels:
  command: {time: {source: t, unit: s}, columns: {command: {source: u, unit: deg}}}
  measured: {time: {source: t, unit: s}, columns: {position: {source: y, unit: deg}}}
trials:
  - {files: "*.csv"}
"""


def recording(name, kind, t, channels, stage):
    """Return a recording; channels: channel -> column -> values [T]; stage: its arguments."""
    series = {c: Series(t.copy(), {n: np.array(x) for n, x in columns.items()}) for c, columns in channels.items()}
    return Trial(name, kind, Path(name), series, stage=TableStage(*stage))


def named(trials):
    """Return the verdict on trials, and the values of the named effects' parameters."""
    verdict = diagnose_table(trials).verdict
    return verdict, {e.name.partition(".")[2]: {k: p.value for k, p in e.parameters.items()} for e in verdict.effects}


STAGES = Path(tables.__file__).parents[1] / "rigs" / "stages"


def shipped(stage, data):
    """Return the real trials of a shipped stage.yaml."""
    return tables.read(STAGES / stage, data)
