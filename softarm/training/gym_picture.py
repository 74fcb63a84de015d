"""Rendering of Gymnasium environments: the robot from the side, as pixels or in a window."""

import os
import time
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.reporting.arm import outline
from softarm.reporting.colours import LIGHT
from softarm.schemas.model import Model
from softarm.simulator.kernel.contact import APART_M, DEPTH_M, THICKNESS_M

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float32]
Pixels = NDArray[np.uint8]

SIZE = (640, 360)  # width and height in pixels
_DPI = 100
_TRAIL = 45  # tip positions: 1.5 s
_MARGIN_M = 0.06  # margin around the reach of the arm
_CART_M = (0.07, 0.035)
_INK, _SOFT, _FLOOR, _MEASURED = (LIGHT[name] for name in ("ink", "soft", "floor", "measured"))
_BEYOND, _BOARD, _ARM, PAPER = (LIGHT[name] for name in ("beyond", "board", "arm", "paper"))
_REQUESTED, _REACHED = LIGHT["requested"], LIGHT["good"]


class View(NamedTuple):
    """State of one robot to draw."""

    time_s: float  # since the episode began
    cart_y_m: float
    ends_m: Array  # y, z of each link's far end, [n, 2]
    target_m: Array  # [2]
    success: bool
    shelf_m: Array | None = None  # y of the front edge, z of the lower board's top


class Picture:
    """Drawing of one robot, updated by `draw`."""

    def __init__(self, model: Model, rail_limit_m: float, radius_m: float, figure: "Figure | None" = None) -> None:
        """Prepare the drawing, in the figure of a window or, by default, in memory."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self._height_m, self._radius_m = model.arm.base_height_m, radius_m
        self.figure = figure or Figure(figsize=(SIZE[0] / _DPI, SIZE[1] / _DPI), dpi=_DPI)
        if figure is None:
            self._canvas = FigureCanvasAgg(self.figure)
        arm = sum(model.arm.link_length_m)
        half = model.cart.travel_m + arm + _MARGIN_M
        low = self._height_m - arm - 2 * _MARGIN_M
        self._axes = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set_axis_off()
        self._axes.set(xlim=(-half, half), ylim=(low, low + 2 * half * SIZE[1] / SIZE[0]))
        self._trail: deque[Array] = deque(maxlen=_TRAIL)
        self._drawn_s = 0.0
        self._stage(model.cart.travel_m, rail_limit_m, half)
        self._moving_parts()

    def draw(self, view: View) -> None:
        """Draw the state of a robot."""
        joints = np.vstack(((view.cart_y_m, self._height_m), view.ends_m))
        if view.time_s == 0.0 or view.time_s < self._drawn_s:
            self._trail.clear()  # another episode
        self._drawn_s = view.time_s
        self._trail.append(view.ends_m[-1])
        self._arm.set_xy(outline(joints))
        self._joints.set_data(*joints[1:-1].T)
        self._tip.set_data(*joints[-1:].T)
        self._path.set_data(*np.array(self._trail).T)
        self._cart.set_xy((view.cart_y_m - _CART_M[0] / 2, self._height_m - _CART_M[1] / 2))
        colour = _REACHED if view.success else _REQUESTED
        self._target.set(center=tuple(view.target_m), edgecolor=colour, facecolor=f"{colour}2c")
        self._middle.set_data(*view.target_m[:, None])
        self._middle.set_color(colour)
        for board, bottom_m in zip(self._boards, (-THICKNESS_M, APART_M), strict=True):
            board.set_visible(view.shelf_m is not None)
            if view.shelf_m is not None:  # the board extends to -y from its front edge
                edge, top = view.shelf_m
                board.set_xy((edge - DEPTH_M, top + bottom_m))
        apart_cm = 100.0 * float(np.hypot(*(view.ends_m[-1] - view.target_m)))
        self._words.set_text(f"{view.time_s:4.1f} s   {'reached' if view.success else f'{apart_cm:.0f} cm off'}")

    def pixels(self) -> Pixels:
        """Return the drawing as uint8 [height, width, 3]."""
        self._canvas.draw()
        return np.array(self._canvas.buffer_rgba())[:, :, :3]

    def _stage(self, travel_m: float, limit_m: float, half_m: float) -> None:
        """Draw the background, the rail and its limits."""
        self.figure.set_facecolor(PAPER)
        for side in (-1.0, 1.0):
            self._axes.axvspan(*sorted((side * limit_m, side * half_m)), color=_BEYOND, linewidth=0, zorder=0)
            stop = (side * travel_m, side * travel_m)
            self._axes.plot(stop, (self._height_m - 0.02, self._height_m + 0.02), color=_INK, linewidth=2)
        self._axes.plot((-travel_m, travel_m), (self._height_m, self._height_m), color=_SOFT, linewidth=3, zorder=1)

    def _moving_parts(self) -> None:
        """Create the moving parts of the drawing."""
        from matplotlib.patches import Circle, Polygon, Rectangle

        add = self._axes.plot
        self._arm = Polygon(np.zeros((3, 2)), facecolor=_ARM, edgecolor=_INK, linewidth=1.0, zorder=2.5)
        (self._joints,) = add([], [], ".", color=_FLOOR, markersize=4, zorder=4)
        (self._tip,) = add([], [], "o", color=_MEASURED, markersize=6, zorder=4)
        (self._path,) = add([], [], color=_MEASURED, linewidth=1.0)
        (self._middle,) = add([], [], "+", markersize=8, zorder=4)
        self._cart = Rectangle((0.0, 0.0), *_CART_M, facecolor=_INK, zorder=5)
        self._target = Circle((0.0, 0.0), self._radius_m, linewidth=1.5, zorder=3)
        self._boards = [
            Rectangle((0.0, 0.0), DEPTH_M, THICKNESS_M, facecolor=_BOARD, zorder=2, visible=False) for _ in range(2)
        ]
        for patch in (self._arm, self._cart, self._target, *self._boards):
            self._axes.add_patch(patch)
        self._words = self._axes.text(
            0.015, 0.965, "", transform=self._axes.transAxes, va="top", color=_INK, fontsize=11, family="monospace"
        )


def no_window() -> str | None:
    """Return why no window can be opened, or None. MPLBACKEND allows another canvas than a display."""
    if any(os.environ.get(name) for name in ("MPLBACKEND", "DISPLAY", "WAYLAND_DISPLAY")):
        return None
    return (
        "render_mode 'human' needs a display, and neither DISPLAY nor WAYLAND_DISPLAY names one: use "
        "render_mode='rgb_array' (gymnasium.wrappers.RecordVideo makes a film of it), or set MPLBACKEND"
    )


class Window:
    """Window that shows a robot in real time."""

    def __init__(self, model: Model, rail_limit_m: float, radius_m: float, fps: float) -> None:
        """Open the window. Raises RuntimeError without a display, unless MPLBACKEND names another canvas."""
        if (reason := no_window()) is not None:
            raise RuntimeError(reason)
        from matplotlib import pyplot

        if chosen := os.environ.get("MPLBACKEND"):  # matplotlib reads it only when it is imported first
            pyplot.switch_backend(chosen)
        elif pyplot.get_backend().lower() == "agg":
            raise RuntimeError(
                "render_mode 'human' needs a window, and matplotlib finds no toolkit for windows: install python3-tk "
                "or `pip install PySide6`, or use render_mode='rgb_array'"
            )
        self._pyplot, self._period_s, self._due_s = pyplot, 1.0 / fps, 0.0
        figure = pyplot.figure("softarm", figsize=(SIZE[0] / _DPI, SIZE[1] / _DPI), dpi=_DPI)
        self.picture = Picture(model, rail_limit_m, radius_m, figure)
        self.is_seen = pyplot.get_backend().lower() not in ("agg", "pdf", "ps", "svg", "cairo")
        if self.is_seen:
            figure.show()

    def show(self, view: View) -> None:
        """Draw and wait for the end of the frame. A window that a person has closed stays closed."""
        figure = self.picture.figure
        if not self._pyplot.fignum_exists(figure.number):
            return
        self.picture.draw(view)
        figure.canvas.draw()
        if self.is_seen:
            figure.canvas.flush_events()
            now_s = time.monotonic()
            self._due_s = max(self._due_s + self._period_s, now_s)
            time.sleep(self._due_s - now_s)

    def close(self) -> None:
        """Close the window and free its figure."""
        self._pyplot.close(self.picture.figure)
