"""The one drawing of the arm, for pictures; `shared/arm.js` draws the same in browsers."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RADII_M = (0.030, 0.024)  # at the cart and at the tip; the real dimensions are unknown
_STEPS = 8


def outline(points: Array) -> Array:
    """Return a smooth, tapered outline around the arm; the far end is round.

    `points` are the cart and the far ends of the links, m, [n, 2], at least two.
    """
    points = np.asarray(points, dtype=np.float64)
    chords = np.maximum(np.linalg.norm(np.diff(points, axis=0), axis=1), 1e-9)
    last = len(chords)
    around = np.concatenate((points[:1], points, points[-1:]))
    lengths = np.append(chords, 0.0) + np.insert(chords, 0, 0.0)
    tangents = (around[2:] - around[:-2]) / lengths[:, None]

    k = np.arange(last * _STEPS + 1)
    i = np.minimum(k // _STEPS, last - 1)
    u, size = (k / _STEPS - i)[:, None], chords[i][:, None]
    start, end, m, n = points[i], points[i + 1], size * tangents[i], size * tangents[i + 1]
    c, d = 3 * (end - start) - 2 * m - n, 2 * (start - end) + m + n
    middle = start + u * (m + u * (c + u * d))
    along = m + u * (2 * c + 3 * u * d)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)

    radius = np.linspace(*RADII_M, len(k))[:, None]
    across = radius * np.column_stack((-along[:, 1], along[:, 0]))
    turn = np.pi * np.arange(1, _STEPS)[:, None] / _STEPS
    cap = middle[-1] + across[-1] * np.cos(turn) + radius[-1] * along[-1] * np.sin(turn)
    return np.concatenate((middle + across, cap, (middle - across)[::-1]))
