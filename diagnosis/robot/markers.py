"""Does every marker set move as one with its link? Mocap alone can tell: no model of the arm, no simulation.

From one link's end to the next it is a link's length along that link's angle, whatever the arm does. A marker set that
wobbles on its link is off that line, and so, the other way, is the next link, which begins where it seems to be.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softarm.diagnosis.data.trials import Series, Trial
from softarm.diagnosis.engine.structure import LEVEL, over_blocks
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.engine.whitened import BLOCK_S

# RMS of what carries on from frame to frame. Nominal robots of the independent simulator show at most 0.1 mm, those
# with 4 mm of white noise a frame 0.5 mm, of which the test over blocks is not sure.
FLOOR_M = 0.00025


@dataclass(frozen=True, slots=True)
class Loose:
    """A marker set that does not move with its link."""

    link: int  # counted from 1
    rms_m: float  # of what carries on from frame to frame
    energy: float  # the same, mean square over the floor's


def loose_marker(trials: Sequence[Trial], links: int) -> Loose | None:
    """The marker set that moves most against its link; None where every one is as still as its noise, or no angles."""
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
    # The next link seems to move as much; the first of the two is the one.
    first = worst - 1 if worst and found[worst - 1] > 0.5 * found[worst] else worst
    return Loose(first + 1, float(np.sqrt(found[worst])), energy)


def _products(mocap: Series | None, links: int) -> list[Array] | None:
    """By block: of every link's ends off its line, frame times next frame, y and z together, [N, links]."""
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
    """A link's end as seen from the end before, less what goes with its angle: length, scale and frame, [N, 2]."""
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
