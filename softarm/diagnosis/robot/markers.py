"""Detection of loose marker sets from mocap alone, without a model of the arm.

The distance between two link ends lies along the link's angle in any pose. A loose marker set leaves that line, and so
does the next link in the opposite direction.
"""

from collections.abc import Sequence

import numpy as np

from softarm.diagnosis.data.trials import Series, Trial
from softarm.diagnosis.engine.structure import LEVEL, Structure, over_blocks
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.engine.whitened import BLOCK_S

# RMS of the autocorrelated part. Nominal robots of the independent simulator show at most 0.1 mm; those with 4 mm of
# white noise show 0.5 mm, which is not significant.
FLOOR_M = 0.00025


def loose_marker(trials: Sequence[Trial], links: int) -> Structure | None:
    """Return the marker set that moves most relative to its link, or None within noise or without angles."""
    products = [each for trial in trials if (each := _products(trial.channels.get("mocap"), links)) is not None]
    if not products:
        return None
    found = []
    for link in range(links):
        mean, p = over_blocks([block[:, link] for trial in products for block in trial])
        found.append(mean if p < LEVEL / links else 0.0)
    worst = int(np.argmax(found))
    energy = found[worst] / FLOOR_M**2
    if not energy > 1:
        return None
    # The next link seems to move as much: the first of the two is loose.
    first = worst - 1 if worst and found[worst - 1] > 0.5 * found[worst] else worst
    size_mm = 1e3 * float(np.sqrt(found[worst]))
    return Structure(energy, f"the markers of link {first + 1} move {size_mm:.1f} mm relative to the link")


def _products(mocap: Series | None, links: int) -> list[Array] | None:
    """Return, by block, the products of each link's offsets in neighbouring frames, [N, links]."""
    names = [f"{body}_{part}" for body in ("cart", *_bodies(links)) for part in ("y", "z")]
    if mocap is None or not {*names, *(f"{body}_angle" for body in _bodies(links))} <= set(mocap.columns):
        return None
    off = np.stack([_off_line(mocap, i) for i in range(1, links + 1)], axis=2)  # [N, 2, links]
    usual = float(np.median(np.diff(mocap.t_s)))
    regular = np.abs(np.diff(mocap.t_s) - usual) < 0.5 * usual
    together = np.where(regular[:, None], (off[1:] * off[:-1]).sum(axis=1), np.nan)
    size = max(2, round(BLOCK_S / usual))
    return [together[a : a + size] for a in range(0, len(together), size)]


def _bodies(links: int) -> list[str]:
    return [f"link{i}" for i in range(1, links + 1)]


def _off_line(mocap: Series, link: int) -> Array:
    """Return the offset of a link's end from its line, m, [N, 2]; length, scale and frame are fitted."""
    before = "cart" if link == 1 else f"link{link - 1}"
    angle = mocap[f"link{link}_angle"]
    regressors = np.stack((np.sin(angle), np.cos(angle), np.ones(len(angle))), axis=1)
    seen = np.isfinite(angle)
    columns = [mocap[f"link{link}_{part}"] - mocap[f"{before}_{part}"] for part in ("y", "z")]
    result = np.full((len(angle), 2), np.nan)
    for i, column in enumerate(columns):
        good = seen & np.isfinite(column)
        if good.sum() > 3 * regressors.shape[1]:
            solved = np.linalg.lstsq(regressors[good], column[good], rcond=None)[0]
            result[good, i] = column[good] - regressors[good] @ solved
    return result
