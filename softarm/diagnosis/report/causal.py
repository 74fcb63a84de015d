"""Drawing of the causal chain: each stage with its share of the gap, its RMS and its noise floor."""

from typing import NamedTuple

from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.report.words import corrected
from softarm.reporting.charts import line, svg, write
from softarm.reporting.markup import Html, el, join
from softarm.reporting.numbers import percent, quantity
from softarm.simulator.effects import STAGES

_BOX_W, _BOX_H = 172.0, 96.0
_SLIM = 84.0  # width of the command's box


class Layout(NamedTuple):
    """Top left corners of the boxes, the arrows between them, and the size of the drawing."""

    width: float
    height: float
    places: dict[str, tuple[float, float]]
    arrows: tuple[tuple[str, str], ...]


# Stage -> top left corner in the wide and in the tall drawing, and the stages that it drives.
_ROBOT: dict[str, tuple[tuple[float, float], tuple[float, float], tuple[str, ...]]] = {
    "command": ((4, 82), (144, 4), ("pressure", "rail")),
    "pressure": ((132, 12), (4, 130), ("arm",)),
    "rail": ((132, 152), (196, 130), ("arm",)),
    "arm": ((348, 82), (100, 258), ("mocap",)),
    "mocap": ((564, 82), (100, 386), ("observation",)),
    "observation": ((780, 82), (100, 514), ()),
    "clock": ((564, 196), (4, 630), ()),
}
_ARROWS = tuple((stage, driven) for stage, (*_, drives) in _ROBOT.items() for driven in drives)
_WIDE = Layout(960, 300, {stage: wide for stage, (wide, *_) in _ROBOT.items()}, _ARROWS)
_TALL = Layout(372, 734, {stage: tall for stage, (_, tall, _) in _ROBOT.items()}, _ARROWS)


def chain(diagnosis: Diagnosis) -> Html:
    """Return the drawing in a wide and a tall form; the page shows the form that fits.

    Stages of another rig are drawn side by side.
    """
    stages = tuple(dict.fromkeys((*diagnosis.verdict.gap.before, *diagnosis.verdict.where.share)))
    if any(stage in STAGES for stage in stages):
        return join([_draw(diagnosis, _WIDE, "wide robot"), _draw(diagnosis, _TALL, "tall")])
    own = [stage for stage in stages if stage != "chain"]
    return join([_draw(diagnosis, _side_by_side(own, 4), "wide"), _draw(diagnosis, _side_by_side(own, 1), "tall")])


def _side_by_side(stages: list[str], columns: int) -> Layout:
    """Return boxes in rows; a single stage follows its command."""
    alone = len(stages) == 1
    left = _SLIM + 44 if alone else 4
    places = {
        stage: (left + (i % columns) * (_BOX_W + 16), 4 + (i // columns) * (_BOX_H + 16))
        for i, stage in enumerate(stages)
    }
    rows = max(1, -(-len(stages) // columns))
    if alone:
        places["command"] = (4.0, 4.0)
    width = max(left + min(columns, len(stages)) * (_BOX_W + 16), 2 * _BOX_W)
    return Layout(width, 8 + rows * (_BOX_H + 16), places, (("command", stages[0]),) if alone else ())


def _draw(diagnosis: Diagnosis, layout: Layout, kind: str) -> Html:
    down = layout.height > layout.width
    arrows = [_arrow(layout.places[a], layout.places[b], a == "command", down) for a, b in layout.arrows]
    boxes = [_box(diagnosis, name, at) for name, at in layout.places.items()]
    note = _clock_note(layout, down) if "clock" in layout.places else Html("")
    share = diagnosis.verdict.where.share
    shares = ", ".join(f"{stage} {percent(value)}" for stage, value in share.items() if value > 0)
    text = f"Causal chain from command to observation; share of the gap: {shares or 'none'}"
    return svg(layout.width, layout.height, text, *arrows, *boxes, note, kind=f"chain {kind}")


def _arrow(start: tuple[float, float], end: tuple[float, float], from_command: bool, down: bool) -> Html:
    width = _SLIM if from_command else _BOX_W
    if down and end[1] > start[1]:
        x1, y1, x2, y2 = start[0] + width / 2, start[1] + _BOX_H, end[0] + _BOX_W / 2, end[1] - 6
        middle = (y1 + y2) / 2
        bend = f"M{x1:.1f} {y1:.1f}C{x1:.1f} {middle:.1f} {x2:.1f} {middle:.1f} {x2:.1f} {y2:.1f}"
        head = f"M{x2 - 5:.1f} {y2 - 3:.1f}L{x2:.1f} {y2 + 5:.1f}L{x2 + 5:.1f} {y2 - 3:.1f}Z"
    else:
        x1, y1, x2, y2 = start[0] + width, start[1] + _BOX_H / 2, end[0] - 6, end[1] + _BOX_H / 2
        middle = (x1 + x2) / 2
        bend = f"M{x1:.1f} {y1:.1f}C{middle:.1f} {y1:.1f} {middle:.1f} {y2:.1f} {x2:.1f} {y2:.1f}"
        head = f"M{x2 - 3:.1f} {y2 - 5:.1f}L{x2 + 5:.1f} {y2:.1f}L{x2 - 3:.1f} {y2 + 5:.1f}Z"
    return join([el("path", d=bend, class_="arrow"), el("path", d=head, class_="head")])


def _clock_note(layout: Layout, down: bool) -> Html:
    """Return the note on the clock, which acts on stamps and not on signals."""
    x, y = layout.places["clock"]
    if down:
        return write(x + _BOX_W + 12, y + _BOX_H / 2 + 4, "timing of each tick")
    to = layout.places["command"]
    dashes = f"M{x:.1f} {y + 70:.1f}H{to[0] + _SLIM / 2:.1f}V{to[1] + _BOX_H + 4:.1f}"
    note = write(x + _BOX_W + 12, y + 45, "timing of each tick")
    return join([el("path", d=dashes, class_="beside"), note])


def _box(diagnosis: Diagnosis, name: str, at: tuple[float, float]) -> Html:
    x, y = at
    if name == "command":
        return join(
            [
                el("rect", x=x, y=y, width=_SLIM, height=_BOX_H, rx=8, class_="box plain"),
                write(x + _SLIM / 2, y + _BOX_H / 2 + 4, "command", "middle", "name"),
            ]
        )
    verdict, gap = diagnosis.verdict, diagnosis.verdict.gap
    chosen = " chosen" if name == verdict.where.stage else ""
    share = verdict.where.share.get(name)
    most = 18 if share is None else 11  # letters beside the share
    kind = "box" + chosen if name in gap.before or share is not None else "box absent"
    parts = [
        el("rect", x=x, y=y, width=_BOX_W, height=_BOX_H, rx=8, class_=kind),
        write(x + 12, y + 22, name if len(name) <= most else f"{name[: most - 1]}…", kind="name"),
    ]
    if share is not None:
        parts += [
            write(x + _BOX_W - 12, y + 22, percent(share).replace("under", "<"), "end", "share"),
            line(x + 12, y + 35, x + _BOX_W - 12, y + 35, "rail"),
            line(x + 12, y + 35, x + 12 + share * (_BOX_W - 24), y + 35, "part") if share > 0 else Html(""),
        ]
    if name not in gap.before:
        return join([*parts, write(x + 12, y + 58, "no gap measured")])
    floor = gap.floor[name]
    parts.append(write(x + 12, y + 60, corrected(diagnosis, name), kind="gap"))
    parts.append(write(x + 12, y + 80, f"floor {quantity(floor.value, floor.unit)}"))
    return join(parts)
