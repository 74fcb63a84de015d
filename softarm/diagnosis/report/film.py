"""Moving drawing of a mechanism: measured, nominal and patched links in the seconds of the largest gap."""

import numpy as np

from softarm.diagnosis.engine.result import Film
from softarm.diagnosis.engine.view import Array
from softarm.reporting.charts import path, svg
from softarm.reporting.markup import Html, el, legend
from softarm.reporting.numbers import number

_WIDTH, _HEIGHT, _MARGIN = 460.0, 300.0, 16.0
_SLOWER = 2.0  # than the motion
_MEASURED = "film-measured"  # robot that is drawn twice: as wide as a body, and as a line
_FLAT = 0.05  # height of a motion as a share of its width, up to which it is drawn from above


def drawing(film: Film) -> Html:
    """Return a figure with the film and a button that stops it."""
    views = _projected(film)
    measured = _robot(views["measured"], film, id=_MEASURED)
    body, curve = (el("use", href=f"#{_MEASURED}", class_=kind) for kind in ("body", "curve measured"))
    models = [_robot(views[kind], film, class_=f"curve {kind}") for kind in views if kind != "measured"]
    factor = "" if film.factor == 1 else f"; deviations enlarged {number(film.factor, 3)} times"
    text = f"Links of the mechanism in {film.trial} from {number(film.t_s[0], 3)} s, at half speed{factor}"
    return el(
        "figure",
        el("figcaption", f"{text}. Each joint is simulated alone, and the others move as measured."),
        legend(*views),
        svg(_WIDTH, _HEIGHT, text, el("defs", measured), body, curve, *models, kind="film"),
        el("button", "stop or play", type="button"),
        class_="film",
    )


def _projected(film: Film) -> dict[str, Array]:
    """Return the lines of each robot in the drawing's plane, [F, L, 2, 2], in its units.

    The plane is upright and shows the largest horizontal deviation; a flat mechanism is seen from above.
    """
    every = np.concatenate([lines.reshape(-1, 3) for lines in film.lines.values()])
    apart = (film.lines["nominal"] - film.lines["measured"]).reshape(-1, 3)
    _, _, across = np.linalg.svd(apart[:, :2], full_matrices=False)
    wide, deep, up = np.array([*across[0], 0.0]), np.array([*across[1], 0.0]), np.array([0.0, 0.0, 1.0])
    wide *= np.sign(wide[np.argmax(np.abs(wide))])
    axes = np.stack((wide, up if np.ptp(every @ up) > _FLAT * np.ptp(every @ wide) else deep))
    flat = every @ axes.T
    low, size = flat.min(axis=0), np.maximum(np.ptp(flat, axis=0), 1e-9)
    scale = float(min((np.array([_WIDTH, _HEIGHT]) - 2 * _MARGIN) / size))
    corner = (np.array([_WIDTH, _HEIGHT]) - scale * size) / 2
    found = {kind: corner + scale * (lines @ axes.T - low) for kind, lines in film.lines.items()}
    return {kind: points * [1, -1] + [0, _HEIGHT] for kind, points in found.items()}


def _robot(lines: Array, film: Film, **attributes: str) -> Html:
    frames = ["".join(path(*line.T) for line in frame) for frame in lines]
    seconds = _SLOWER * len(frames) * float(np.median(np.diff(film.t_s)))
    moving = el(
        "animate",
        attributeName="d",
        values=";".join(frames),
        dur=f"{seconds:.3g}s",
        calcMode="discrete",
        repeatCount="indefinite",
    )
    return el("path", moving, d=frames[0], **attributes)
