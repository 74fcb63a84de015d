"""Report of a finished run: report.html, tip_paths.png and the last lines of `softarm train`."""

import json
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.policies.base import MODELS
from softarm.reporting.colours import LIGHT
from softarm.reporting.document import Section, document
from softarm.reporting.markup import Html, el, join, picture, table, tiles
from softarm.simulator.kernel.contact import APART_M, DEPTH_M, THICKNESS_M
from softarm.training.learn.validation import Tested, chosen_by, fly_trials
from softarm.training.record import curve
from softarm.training.record.checkpoint import Settings, load_policy, quick_products, usual
from softarm.training.record.curve import BLUE, ORANGE, PAPER
from softarm.training.run.session import Session
from softarm.training.task.reach import ReachTask, ShelfTask

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REACHED, MISSED = BLUE, ORANGE
_INK, _SOFT, _LINE = (LIGHT[name] for name in ("ink", "soft", "line"))
_BEYOND, _BOARD = LIGHT["beyond"], LIGHT["board"]
_MARGIN_M = 0.035
_WIDTH_IN, _LEFT_IN, _RIGHT_IN, _TOP_IN, _BOTTOM_IN, _GAP_IN = 13.4, 0.5, 0.1, 1.15, 0.35, 0.05


class Panel(NamedTuple):
    """Panel of one target and its trials."""

    row: int
    column: int
    trials: NDArray[np.int64]
    name: str  # title in the panel; empty on a grid, whose axes give the target


class _Window(NamedTuple):
    """Range of a panel in y and z, m."""

    y: tuple[float, float]
    z: tuple[float, float]


def draw(tested: Tested, task: ReachTask, title: str) -> "Figure":
    """Draw a panel per target, with the paths from all cart starts; panels of the grid are arranged as in space."""
    from matplotlib.figure import Figure  # no pyplot: no global state, no display

    shelf = isinstance(task, ShelfTask)
    panels, window = _shelf_panels(tested) if shelf else _grid_panels(tested), _window(tested, task)
    rows, columns = (1 + max(getattr(panel, way) for panel in panels) for way in ("row", "column"))
    width_in = (_WIDTH_IN - _LEFT_IN - _RIGHT_IN - (columns - 1) * _GAP_IN) / columns
    height_in = width_in * np.ptp(window.z) / np.ptp(window.y)
    size_in = (_WIDTH_IN, rows * (height_in + _GAP_IN) - _GAP_IN + _TOP_IN + _BOTTOM_IN)
    figure = Figure(figsize=size_in, facecolor=PAPER)
    for panel in panels:
        left = _LEFT_IN + panel.column * (width_in + _GAP_IN)
        bottom = _BOTTOM_IN + (rows - 1 - panel.row) * (height_in + _GAP_IN)
        place = (left / size_in[0], bottom / size_in[1], width_in / size_in[0], height_in / size_in[1])
        axes = figure.add_axes(place, xlim=window.y, ylim=window.z, xticks=[], yticks=[], facecolor="white")
        _draw_trials(axes, tested, panel, task)
        y, z = tested.scenarios.target_m[panel.trials[0]]
        if not shelf and panel.row == rows - 1:
            axes.set_xlabel(f"y {y:.2f} m", color=_SOFT, fontsize=9)
        if not shelf and panel.column == 0:
            axes.set_ylabel(f"z {z:.2f} m", color=_SOFT, fontsize=9)
    _head(figure, tested, task, title)
    return figure


def write_png(tested: Tested, task: ReachTask, path: Path, title: str) -> None:
    """Write the picture as a PNG."""
    draw(tested, task, title).savefig(path, dpi=140)


def _grid_panels(tested: Tested) -> list[Panel]:
    """Arrange panels by target: y from left to right, z from bottom to top."""
    y, z = tested.scenarios.target_m.T
    places = [
        (row, column, np.flatnonzero((y == across) & (z == height)))
        for row, height in enumerate(np.unique(z)[::-1])
        for column, across in enumerate(np.unique(y))
    ]
    return [Panel(row, column, trials, "") for row, column, trials in places if len(trials)]


def _shelf_panels(tested: Tested) -> list[Panel]:
    """Arrange panels in the order of the targets, two per row."""
    targets, first, which = np.unique(tested.scenarios.target_m, axis=0, return_index=True, return_inverse=True)
    return [
        Panel(k // 2, k % 2, np.flatnonzero(which == i), f"target at y {targets[i, 0]:.2f}, z {targets[i, 1]:.2f} m")
        for k, i in enumerate(np.argsort(first))
    ]


def _window(tested: Tested, task: ReachTask) -> _Window:
    """Return the range that contains every path, every target and the rail's limits."""
    points = np.concatenate((tested.flown.tip_m.reshape(-1, 2), tested.scenarios.target_m))
    low, high = np.nanmin(points, axis=0) - _MARGIN_M, np.nanmax(points, axis=0) + _MARGIN_M
    if isinstance(task, ShelfTask):
        high[1] = max(high[1], float(tested.scenarios.target_m[:, 1].max()) + APART_M + _MARGIN_M)
    else:
        high[1] += 0.25 * (high[1] - low[1])  # a line of words
    limit = task.rail_limit_m + _MARGIN_M
    return _Window((min(low[0], -limit), max(high[0], limit)), (low[1], high[1]))


def _draw_trials(axes: "Axes", tested: Tested, panel: Panel, task: ReachTask) -> None:
    """Draw a target's trials."""
    from matplotlib.patches import Circle

    axes.spines[:].set_color(_LINE)
    left, right = axes.get_xlim()
    axes.axvspan(left, -task.rail_limit_m, color=_BEYOND, linewidth=0, zorder=0)
    axes.axvspan(task.rail_limit_m, right, color=_BEYOND, linewidth=0, zorder=0)
    outcome, target = tested.flown, tested.scenarios.target_m[panel.trials[0]]
    if tested.scenarios.depth_m is not None and isinstance(task, ShelfTask):
        _boards(axes, target[0] + tested.scenarios.depth_m[panel.trials[0]], target[1] - task.board_below_m)
    reached = outcome.reached[panel.trials]
    colour = REACHED if reached.all() else MISSED
    axes.add_patch(Circle(target, task.success_radius_m, facecolor=f"{colour}2c", edgecolor=colour, linewidth=0.8))
    large = 1.0 if panel.name == "" else 1.8
    for trial, good in sorted(zip(panel.trials, reached, strict=True), key=lambda each: bool(each[1])):
        path, own = outcome.tip_m[:, trial], REACHED if good else MISSED
        path = path[np.isfinite(path[:, 0])]
        axes.plot(*path.T, color=own, linewidth=(0.9 if good else 0.5) * large, alpha=0.85, gid=f"trial-{trial}")
        axes.plot(*path[0], "o", color=_SOFT, markersize=2.2 * large, zorder=3)
        axes.plot(*path[-1], "o", color=own, markersize=3.2 * large, zorder=3)
    size, place = 7.5 if panel.name == "" else 11, axes.transAxes
    axes.text(0.985, 0.96, _result(tested, panel), ha="right", va="top", color=colour, fontsize=size, transform=place)
    axes.text(0.5, 0.96, panel.name, ha="center", va="top", color=_INK, fontsize=size, transform=place)


def _result(tested: Tested, panel: Panel) -> str:
    """Describe the result of a trial in a few words."""
    reached = tested.flown.reached[panel.trials]
    if reached.all():
        return f"in {tested.flown.time_s[panel.trials].max():.1f} s"
    short_cm = 100.0 * float(tested.flown.closest_m[panel.trials][~reached].min())
    return f"{reached.sum()} of {len(reached)}, {short_cm:.1f} cm away"


def _boards(axes: "Axes", edge_y_m: float, top_z_m: float) -> None:
    """Draw both boards of a shelf from its front edge and the lower one's top."""
    from matplotlib.patches import FancyBboxPatch

    for z_m in (top_z_m - THICKNESS_M, top_z_m + APART_M):
        place, half = (edge_y_m - DEPTH_M, z_m + THICKNESS_M / 2), THICKNESS_M / 2
        rounded = f"round,pad={half}"
        axes.add_patch(FancyBboxPatch(place, DEPTH_M - half, 0.0, boxstyle=rounded, color=_BOARD, linewidth=0))


def _head(figure: "Figure", tested: Tested, task: ReachTask, title: str) -> None:
    """Draw title, result and legend."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def dot(colour: str, size: float, edge: str | None = None) -> Line2D:
        return Line2D([], [], marker="o", linestyle="", color=colour, markersize=size, markeredgecolor=edge or colour)

    signs = {
        "start": dot(_SOFT, 4),
        f"target, {100 * task.success_radius_m:.0f} cm around": dot(_LINE, 10, _SOFT),
        "reached; from the slowest start in": Line2D([], [], color=REACHED, marker="o", markersize=4),
        "missed; at best this far away": Line2D([], [], color=MISSED, marker="o", markersize=4, linewidth=0.9),
        "beyond the rail's limits": Patch(facecolor=_BEYOND, edgecolor=_LINE),
    }
    if isinstance(task, ShelfTask):
        signs["the shelf's boards"] = Line2D([], [], color=_BOARD, linewidth=4)
    left, height_in = _LEFT_IN / _WIDTH_IN, figure.get_figheight()
    head = f"{title}: the tip's paths in the test trials"
    figure.text(left, 1 - 0.32 / height_in, head, color=_INK, fontsize=15, fontweight="bold", va="center")
    figure.text(left, 1 - 0.64 / height_in, tested.sentence, color=_INK, fontsize=10.5, va="center")
    figure.legend(
        list(signs.values()),
        list(signs),
        loc="center left",
        bbox_to_anchor=(left, 1 - 0.94 / height_in),
        ncols=len(signs),
        frameon=False,
        fontsize=9,
        labelcolor=_SOFT,
        handletextpad=0.5,
        columnspacing=1.6,
        borderaxespad=0,
        borderpad=0,
    )


def fly_test_trials(session: Session) -> Tested:
    """Fly the task's test trials with the exported policy; they do not influence the training."""
    network, _ = load_policy(session.out / "best.pt")
    return fly_trials(network, session.task, session.pool, session.model)


def write(session: Session, tested: Tested) -> Path:
    """Write report.html and tip_paths.png next to the learning curve and return the path of the page."""
    write_png(tested, session.task, session.out / "tip_paths.png", session.title)
    path = session.out / "report.html"
    path.write_text(_page(session, tested), encoding="utf-8")
    return path


def _page(session: Session, tested: Tested) -> str:
    """Return the self-contained page; equal runs give equal pages."""
    best = session.exported
    share = f"{session.best or 0.0:.1%}"
    facts = (
        ("task", session.task.name),
        ("model", str(session.settings["model.name"])),
        ("seed", str(session.config.seed)),
        ("frames", f"{session.frames / 1e6:.2f} M"),
        ("training time", f"{session.seconds / 60:.1f} min"),
        ("validation set reached", share),
    )
    lead = join([el("h1", session.title), el("div", el("p", tested.sentence), class_="lead"), tiles(facts)])
    flown = (
        "Flown by the exported policy on its training simulator, one point per control step. These trials did not "
        "influence the training."
    )
    chosen = (
        f"The exported checkpoint, after {best.frames / 1e6:.2f} M frames, has the best validation "
        f"({share}): {chosen_by(session.task)}."
    )
    curve_png, paths_png = ((session.out / name).read_bytes() for name in ("learning_curve.png", "tip_paths.png"))
    paths = picture(paths_png, "Tip paths in the test trials")
    curve = picture(curve_png, "Success, reward, KL divergence and learning rate over frames", "narrow")
    network = session.network
    expected = usual(session.task, network.shape.inputs) | {"run.matrix_products": quick_products(network.device)}
    sections = (
        Section("Tip paths", "paths", join([paths, el("p", flown, class_="hint")])),
        Section("Learning curve", "curve", join([curve, el("p", chosen, class_="hint")])),
        Section("Settings", "settings", _settings(changed(session.settings, expected))),
    )
    return document(session.title, "softarm train", lead, sections)


def changed(settings: Settings, usual: Settings) -> list[tuple[str, str, str]]:
    """Return settings that differ from the default: name, value and default (if there is one)."""
    # The frequency of drawing matters only if the robots vary.
    alike = not any(name.startswith("randomise.ranges.") for name in settings)
    settings = {name: value for name, value in settings.items() if not (alike and name.startswith("randomise."))}
    return [
        (name, _text(value), _text(usual[name]) if name in usual else "")
        for name, value in settings.items()
        if name not in usual or usual[name] != value
    ]


def _settings(rows: Sequence[tuple[str, str, str]]) -> Html:
    if not rows:
        return el("p", "All settings have their default values.")
    text = el("p", "All other settings have their default values; the policy's file lists every setting.")
    body = ((el("code", name), value, usual) for name, value, usual in rows)
    return join([text, table(("setting", "value", "default"), body, "Settings that differ from the default")])


def _text(value: object) -> str:
    if isinstance(value, list):
        return " .. ".join(map(_text, value))
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 40 else f"{text[:12]}…"  # a model's fingerprint


def ending(session: Session, policy: Path) -> Iterator[str]:
    """Fly the test trials with the exported policy, write the page, and yield lines about files and next steps."""
    yield f"{session.frames / 1e6:.2f} M frames in {session.seconds / 60:.1f} min, {session.out}:"
    yield f"  {policy.name}: the checkpoint with {session.best:.1%} of the validation set reached"
    yield "  learning_curve.csv and .png, latest.pt (to resume), best.pt (`softarm dev export`)"
    if (error := session.exported.action_error) is not None:
        yield f"  action error on the held-out episodes: {error:.3f}, root mean square; actions span -1 to 1"
    tested = fly_test_trials(session)
    yield f"  {tested.sentence}"
    path = write(session, tested)
    yield f"  {path.name}: the curves and the tip's paths at these trials, also in tip_paths.png"
    folder = shlex.quote(str(session.out))
    if session.events.fault is None:
        yield f"  tensorboard/: see it with `tensorboard --logdir {folder}`"
    # A missing package was reported before the run.
    elif session.events.fault != curve.tensorboard_missing():
        yield f"  {session.events.fault}"
    name = session.task.name
    shipped = f" {name}" if (MODELS / f"{name}.onnx").is_file() else ""
    test = " --test shelf" if isinstance(session.task, ShelfTask) else ""
    yield "Next: fly it through the daemon's own tick, and give it a name for the daemon:"
    yield f"  softarm evaluate {folder}{shipped}{test}"
    mine = {"policies": {f"my-{name}": {"plugin": "onnx", "options": {"model": str(policy)}}}}
    yield f"  echo {shlex.quote(json.dumps(mine))} > mine.yaml"
