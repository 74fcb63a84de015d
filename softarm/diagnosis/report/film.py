"""Moving drawing of a mechanism: measured, nominal and patched bodies in the seconds of the largest gap."""

import numpy as np

from softarm.diagnosis.engine.result import Film
from softarm.diagnosis.engine.view import Array
from softarm.reporting.charts import path, svg
from softarm.reporting.markup import Html, el, legend
from softarm.reporting.numbers import number

_WIDTH, _HEIGHT, _MARGIN = 460.0, 300.0, 16.0
_SLOWER = 2.0  # than the motion
_STROKE = 1.4  # width of an outline


def drawing(film: Film) -> Html:
    """Return a figure with the film and a button that stops it."""
    views = _scaled(film)
    robots = [_robot(lines, film, id=f"film-{kind}") for kind, lines in views.items()]
    body = el("use", href="#film-measured", class_="body")
    drawn = {"filter": "url(#film-outline)"}
    outlines = [el("use", href=f"#film-{kind}", class_=f"outline {kind}", **drawn) for kind in views]
    factor = "" if film.factor == 1 else f"; deviations enlarged {number(film.factor, 3)} times"
    text = f"Mechanism in {film.trial} from {number(film.t_s[0], 3)} s, at half speed{factor}"
    return el(
        "figure",
        el("figcaption", f"{text}. Each joint is simulated alone, and the others move as measured."),
        legend(*views),
        svg(_WIDTH, _HEIGHT, text, el("defs", _outline(), *robots), body, *outlines, kind="film"),
        el("button", "stop or play", type="button"),
        class_="film",
    )


def _outline() -> Html:
    """Return the filter that leaves the outline of a robot's shapes together; lines inside it would hide each other."""
    wide = el("feMorphology", operator="dilate", radius=_STROKE, result="wide")
    return el("filter", wide, el("feComposite", in_="wide", in2="SourceGraphic", operator="out"), id="film-outline")


def _scaled(film: Film) -> dict[str, Array]:
    """Return the outlines of each robot, [F, L, C, 2], in the drawing's units."""
    every = np.concatenate([lines.reshape(-1, 2) for lines in film.lines.values()])
    low, size = every.min(axis=0), np.maximum(np.ptp(every, axis=0), 1e-9)
    scale = float(min((np.array([_WIDTH, _HEIGHT]) - 2 * _MARGIN) / size))
    corner = (np.array([_WIDTH, _HEIGHT]) - scale * size) / 2
    found = {kind: corner + scale * (lines - low) for kind, lines in film.lines.items()}
    return {kind: points * [1, -1] + [0, _HEIGHT] for kind, points in found.items()}


def _robot(lines: Array, film: Film, id: str) -> Html:
    frames = ["".join(map(_closed, frame)) for frame in lines]
    seconds = _SLOWER * len(frames) * float(np.median(np.diff(film.t_s)))
    moving = el(
        "animate",
        attributeName="d",
        values=";".join(frames),
        dur=f"{seconds:.3g}s",
        calcMode="discrete",
        repeatCount="indefinite",
    )
    return el("path", moving, d=frames[0], id=id)


def _closed(outline: Array) -> str:
    """Return an outline, [C, 2], as a part of a path; corners that round to the corner before are left out."""
    rounded = outline.round(1)
    corners = rounded[np.any(rounded != np.roll(rounded, 1, axis=0), axis=1)]
    return f"{path(*corners.T)}Z" if len(corners) else ""
