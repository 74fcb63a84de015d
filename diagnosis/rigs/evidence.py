"""What a report shows of a rig's stage: overlays, regimes, rivals; and how far each named effect shrinks the gap."""

from collections.abc import Sequence

import numpy as np

from softarm.common import resample
from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine import shrink
from softarm.diagnosis.engine.fits import Fit
from softarm.diagnosis.engine.result import Overlay, Regime, Rival
from softarm.diagnosis.engine.search import Search, SelectedEffect
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.views import RigView
from softarm.schemas.verdict import Interval


def rms(values: Array) -> float:
    """Root mean square of what was measured."""
    return float(np.sqrt(np.nanmean(np.asarray(values, dtype=float) ** 2)))


def by_trial(search: Search, fit: Fit, origins: Sequence[int]) -> Array:
    """Held-out losses by recording [K]; of a single one by block."""
    return summed(search, fit.held_out, origins)


def summed(search: Search, losses: Array, origins: Sequence[int]) -> Array:
    """Losses of blocks [B] by recording [K]; of a single one by block."""
    if len(set(origins)) < 2:
        return np.maximum(losses, 0.0)
    squares = np.zeros(max(origins) + 1)
    for (trial, _), loss in zip(search.problem.blocks, losses, strict=True):
        squares[origins[trial]] += max(float(loss), 0.0)
    return squares


def shrunk(less: Array, more: Array) -> Interval:
    """Share of the RMS that goes, and an interval that holds on kinds of motion that no fit saw; losses by trial."""
    value, low, high = shrink.interval(less, more)
    return Interval(value=value, low=min(low, value), high=max(high, value))


def overlays(view: RigView, trials: Sequence[Trial], nominal: Array, left: Array | None) -> list[Overlay]:
    """Measured, nominal and patched, trial by trial and channel by channel; residuals [M, S]."""
    found = []
    for k, trial in enumerate(trials):
        mine = view.trial == k
        for s, channel in enumerate(view.channels):
            seen = view.measured[mine, s]
            patched = None if left is None else seen - left[mine, s]
            labels = view.stage, trial.name, trial.kind, channel, view.unit
            found.append(Overlay(*labels, view.t_s[mine], seen, seen - nominal[mine, s], patched))
    return found


def regime_rows(view: RigView, nominal: Array, left: Array | None) -> list[Regime]:
    """How large the gap is in every part of the data."""
    return [
        Regime(
            view.stage, name, int(mask.sum()), rms(nominal[mask]), None if left is None else rms(left[mask]), view.unit
        )
        for name, mask in view.regimes.items()
        if np.isfinite(nominal[mask]).any()
    ]


def rivals(search: Search, chosen: Fit, null_model: Fit, named: Sequence[SelectedEffect]) -> list[Rival]:
    """Every effect: what it takes away alone, and what it adds beside the others."""
    alone = {f.effects[0].name: f for f in search.extended(null_model)}
    further = {f.effects[-1].name: f for f in search.extended(chosen)}
    selected = {m.candidate.name: m for m in named}
    found = []
    for name, fit in alone.items():
        share = min(max(_bare(null_model, fit).value, 0.0), 1.0)
        more, less, note = further.get(name, fit), chosen if name in further else null_model, ""
        if name in selected:
            more, less, note = chosen, selected[name].without, "named"
        elif stands_in := [m.candidate.name for m in named if name in m.equivalents]:
            note = f"cannot be told from {stands_in[0]}"
        elif more.at_bound:
            note = "at its bound"
        point = {k: v for k, v in more.point.items() if k.startswith(f"{name}.") and np.isfinite(v)}
        found.append(Rival((name,), share, _bare(less, more), point, note))
    return sorted(found, key=lambda r: (-r.alone, r.names))


def _bare(less: Fit, more: Fit) -> Interval:
    """Share of the RMS that goes as the search saw it, blocks drawn anew."""
    before, after = np.maximum(less.held_out, 0.0), np.maximum(more.held_out, 0.0)
    drawn = resample.draws(len(before))
    low, high = resample.interval(1 - np.sqrt((drawn @ after) / np.maximum(drawn @ before, 1e-12)))
    value = 1 - float(np.sqrt(after.sum() / max(before.sum(), 1e-12)))
    return Interval(value=value, low=min(float(low), value), high=max(float(high), value))
