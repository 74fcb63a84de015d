"""Film of a mechanism: its bodies as measured and as the models move them, in the seconds of the largest gap."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from softarm.diagnosis.answer.worst import window, worst
from softarm.diagnosis.data.trials import Trial, stage_of
from softarm.diagnosis.engine.result import Diagnosis, Film, Overlay
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.body_terms import continuous
from softarm.diagnosis.rigs.mjcf.drive import columns
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism, mechanism

FRAMES_PER_S = 20.0
# Factors by which deviations may be enlarged, and the largest drawn deviation as a share of the mechanism's extent.
FACTORS = 1, 2, 5, 10, 20, 50, 100
DRAWN = 0.1
# Height of a motion as a share of its width, up to which it is drawn from above.
FLAT = 0.05
# Corners of all outlines together, and least and most corners of one: bounds of the report's size.
CORNERS, FEWEST, MOST = 400, 8, 24


def film(diagnosis: Diagnosis, trials: Sequence[Trial]) -> Film | None:
    """Return the film of a diagnosis, or None if no joint of a model stands out.

    Deviations are those of each stage alone, driven by the measured motion of the others.

    Args:
        diagnosis: diagnosis with its signals in standard units.
        trials: trials of all stages.
    """
    if diagnosis.verdict.where.stage is None or not diagnosis.overlays:
        return None
    shown = diagnosis.overlays[worst(diagnosis)]
    own = [t for t in trials if stage_of([t]).name == shown.stage]
    if stage_of(own).kind != "mujoco":
        return None
    trial = next(t for t in own if _is_of(shown, t))
    start, end = window(shown) or (float(shown.t_s[0]), float(shown.t_s[-1]))
    t_s = np.arange(start, end, 1 / FRAMES_PER_S)
    model = mechanism(Path(str(stage_of([trial]).model["mjcf"])), *columns([trial]))
    measured = _measured(model, trial, t_s)
    seen = [each for each in diagnosis.overlays if _is_of(each, trial) and each.stage in measured]
    apart = {"nominal": _apart(seen, [each.nominal for each in seen], t_s)}
    if any(each.patched is not None for each in seen):
        apart["patched"] = _apart(seen, [each.nominal if each.patched is None else each.patched for each in seen], t_s)

    def points(kind: str, factor: float) -> Array:
        moved = {name: x + factor * apart[kind].get(name, 0.0) for name, x in measured.items()}
        still = np.zeros_like(t_s)
        return model.points(model.joint(shown.stage), {name: (x, still, still) for name, x in moved.items()})

    real, simulated = points("nominal", 0.0), points("nominal", 1.0)
    factor, axes = _factor(real, simulated), _plane(real, simulated)
    found = {"measured": real} | {kind: points(kind, factor) for kind in apart}
    lines = {kind: _outlines(each @ axes.T) for kind, each in found.items()}
    return Film(_recording(trial.name, shown.stage), t_s, lines, factor)


def _is_of(overlay: Overlay, trial: Trial) -> bool:
    """Return whether an overlay shows the recording of a trial, or a stretch of it."""
    return _recording(overlay.trial, overlay.stage) == _recording(trial.name, stage_of([trial]).name)


def _recording(trial: str, stage: str) -> str:
    """Return the name of a trial's recording, without its stage and the start of a stretch."""
    return trial.rpartition(f"/{stage}")[0]


def _measured(model: Mechanism, trial: Trial, t_s: Array) -> dict[str, Array]:
    """Return the measured positions and poses at some times, by column."""
    found = {}
    for series in continuous(model, trial):
        for name, values in series.columns.items():
            known = np.isfinite(values)
            found[name] = np.interp(t_s, series.t_s[known], values[known])
    return found


def _apart(seen: Sequence[Overlay], simulated: Sequence[Array], t_s: Array) -> Mapping[str, Array]:
    """Return the deviation of the simulated joints from the measured ones at some times, by joint; 0 where unknown."""
    found: dict[str, Array] = {}
    for each, values in zip(seen, simulated, strict=True):
        apart = np.nan_to_num(values - each.measured)
        found[each.stage] = found.get(each.stage, 0.0) + np.interp(t_s, each.t_s, apart, left=0.0, right=0.0)
    return found


def _factor(measured: Array, nominal: Array) -> float:
    """Return the factor by which deviations are drawn larger; measured, nominal: points, [F, G, P, 3]."""
    extent = float(np.linalg.norm(np.ptp(measured.reshape(-1, 3), axis=0)))
    apart = float(np.linalg.norm(nominal - measured, axis=-1).max(initial=1e-12))
    return float(max(f for f in FACTORS if f == 1 or f * apart <= DRAWN * extent))


def _plane(measured: Array, nominal: Array) -> Array:
    """Return the axes of the drawing to the right and up, [2, 3]; measured, nominal: points, [F, G, P, 3].

    The plane is upright and shows the largest horizontal deviation; a flat mechanism is seen from above.
    """
    _, _, across = np.linalg.svd((nominal - measured).reshape(-1, 3)[:, :2], full_matrices=False)
    wide, deep, up = np.array([*across[0], 0.0]), np.array([*across[1], 0.0]), np.array([0.0, 0.0, 1.0])
    wide *= np.sign(wide[np.argmax(np.abs(wide))])
    centres = np.concatenate((measured, nominal)).mean(axis=2).reshape(-1, 3)
    return np.stack((wide, up if np.ptp(centres @ up) > FLAT * np.ptp(centres @ wide) else deep))


def _outlines(flat: Array) -> Array:
    """Return the corners of each shape's outline, counter-clockwise, [F, G, C, 2].

    Args:
        flat: points of each convex shape in the plane of the drawing, [F, G, P, 2].
    """
    # A multiple of four, so that both axes of the drawing are among the directions.
    corners = min(max(4 * (CORNERS // 4 // flat.shape[1]), FEWEST), MOST)
    angle = 2 * np.pi * np.arange(corners) / corners
    towards = np.stack((np.cos(angle), np.sin(angle)))
    return np.take_along_axis(flat, np.argmax(flat @ towards, axis=2)[..., None], axis=2)
