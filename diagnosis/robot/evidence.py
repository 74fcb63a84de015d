"""What a report shows of the robot's stages: overlays, spectra, regimes, rivals, leftovers."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine.ceiling import regimes
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.result import Leftover, Overlay, Regime, Rival, Spectrum
from softarm.diagnosis.engine.search import Choice, Gain, Search, SelectedEffect
from softarm.diagnosis.engine.view import Point, View
from softarm.diagnosis.robot.trial_grid import RATE_HZ
from softarm.schemas.verdict import Interval

Gap = NDArray[np.float32]
BANDS = ((0.0, 0.5, "below 0.5 Hz"), (0.5, 2.0, "from 0.5 to 2 Hz"), (2.0, 30.0, "above 2 Hz"))
RIVALS_SHOWN = 6


def gaps(setup: Setup, nominal: Point, patched: Point | None) -> list[tuple[Gap, Gap | None]]:
    """Raw gaps of every view, nominal and patched, [M, S]."""
    found = []
    for each in setup.gaps:
        points = [nominal] if patched is None else [nominal, patched]
        fetched = each.fetch(points)
        found.append((fetched[each.key(nominal)], None if patched is None else fetched[each.key(patched)]))
    return found


def overlays(
    views: Sequence[View], pairs: Sequence[tuple[Gap, Gap | None]], trials: Sequence[Trial]
) -> tuple[Overlay, ...]:
    """Measured, nominal and patched signals, every trial and the channels that people look at."""
    found = []
    for view, (before, after) in zip(views, pairs, strict=True):
        chosen = (
            range(len(view.channels))
            if len(view.channels) <= 2
            else (len(view.channels) // 2 - 1, len(view.channels) - 1)
        )
        for k, trial in enumerate(trials):
            rows = view.trial == k
            for s in chosen:
                measured = view.measured[rows, s]
                if not np.isfinite(measured).any():
                    continue
                patched = None if after is None else measured - after[rows, s]
                signals = measured, measured - before[rows, s], patched
                labels = view.stage, trial.name, trial.kind, view.channels[s], view.unit
                found.append(Overlay(*labels, view.t_s[rows], *signals))
    return tuple(found)


def spectra(views: Sequence[View], pairs: Sequence[tuple[Gap, Gap | None]]) -> tuple[Spectrum, ...]:
    """Amplitude densities of the residuals, trials and channels pooled."""
    found = []
    for view, (before, after) in zip(views, pairs, strict=True):
        frequency, nominal = _density(view, before)
        patched = None if after is None else _density(view, after)[1]
        floor = float(np.sqrt(np.mean(view.floor**2) / (RATE_HZ / 2)))
        found.append(Spectrum(view.stage, view.unit, frequency, nominal, patched, floor))
    return tuple(found)


def _density(view: View, gap: Gap) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    powers, frequency = [], np.zeros(0)
    for k in np.unique(view.trial):
        part = np.nan_to_num(gap[view.trial == k])
        if len(part) >= 128:
            frequency, power = welch(part, fs=RATE_HZ, nperseg=128, axis=0)
            powers.append(power.mean(axis=1))
    return frequency, np.sqrt(np.mean(powers, axis=0)) if powers else np.zeros(0)


def regime_rows(views: Sequence[View], pairs: Sequence[tuple[Gap, Gap | None]]) -> tuple[Regime, ...]:
    """How large the gap is in every part of the data."""
    found = []
    for view, (before, after) in zip(views, pairs, strict=True):
        nominal, patched = regimes(view, before), {} if after is None else regimes(view, after)
        masks = view.regimes
        found += [
            Regime(view.stage, name, int(masks[name].sum()), rms, patched.get(name), view.unit)
            for name, rms in nominal.items()
        ]
    return tuple(found)


def where_in_words(view: View, gap: Gap) -> str:
    """The regime in which the gap stands out and the band that holds most of it."""
    overall = float(np.sqrt(np.nanmean(gap**2)))
    frequency, density = _density(view, gap)
    parts = [float((density[(frequency >= a) & (frequency < b)] ** 2).sum()) for a, b, _ in BANDS]
    band = BANDS[int(np.argmax(parts))][2] if sum(parts) > 0 else ""
    standing = (
        sorted(((rms / overall, name) for name, rms in regimes(view, gap).items()), reverse=True) if overall else []
    )
    if standing and standing[0][0] > 1.2:
        return f"{standing[0][1]}, {band}"
    return f"throughout, {band}"


def rivals(search: Search, choice: Choice, selected: Sequence[SelectedEffect]) -> tuple[Rival, ...]:
    """The named effects, who was tried in their place, and what each explains alone."""
    alone = {fit.names[0]: _alone(gain) for fit, gain in choice.alone}
    named = {m.candidate.name for m in selected}
    found = []
    for effect in selected:
        name = effect.candidate.name
        scale = max(effect.gain.value, 1e-9)
        same = f"; cannot be told from {', '.join(effect.equivalents)}" if effect.equivalents else ""
        found.append(
            Rival(
                (name,),
                alone.get(name, 0.0),
                _share(effect.gain, scale),
                _own(choice.chosen.point, name),
                f"named{same}",
            )
        )
    further = [(f, g) for f, g in search.ranked(choice.chosen) if f.effects[-1].name not in named][:RIVALS_SHOWN]
    scale = max((m.gain.value for m in selected), default=max((g.value for _, g in further), default=1.0)) or 1.0
    for fit, gain in further:
        name = fit.effects[-1].name
        note = "at its bound" if fit.at_bound else "adds too little to be named"
        found.append(Rival((name,), alone.get(name, 0.0), _share(gain, scale), _own(fit.point, name), note))
    return tuple(found)


def _alone(gain: Gain) -> float:
    """Share of the RMS that goes, of the stage where most goes."""
    return max((1 - float(np.sqrt(max(1 - s, 0.0))) for s in gain.shares.values()), default=0.0)


def _share(gain: Gain, scale: float) -> Interval:
    return Interval(value=gain.value / scale, low=gain.low / scale, high=gain.high / scale)


def _own(point: Mapping[str, float], name: str) -> dict[str, float]:
    return {path: x for path, x in point.items() if path.startswith(f"{name}.") and np.isfinite(x)}


def leftovers(
    flexible: Mapping[str, tuple[float, Mapping[str, float]]], explained: Mapping[str, float]
) -> tuple[Leftover, ...]:
    """What a flexible model still finds, per stage, and what it looks at."""
    return tuple(
        Leftover(stage, explained.get(stage, 1.0), tuple(uses.items())) for stage, (_, uses) in flexible.items()
    )
