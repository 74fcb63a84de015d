"""What a Gymnasium environment renders: the robot from the side, as an array of pixels or in a window."""

import os
import time
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.pages.colours import LIGHT
from softarm.schemas.model import Model
from softarm.simulator.kernel.contact import APART_M, DEPTH_M, RADIUS_M, THICKNESS_M
from softarm.training.record.curve import BLUE, ORANGE, PAPER

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float32]
Pixels = NDArray[np.uint8]

SIZE = (640, 360)  # width and height in pixels
_DPI = 100
_TRAIL = 45  # places of the tip: a second and a half
_ROOM_M = 0.06  # around what the arm may reach
_CART_M = (0.07, 0.035)
_INK, _SOFT, _LINE = (LIGHT[name] for name in ("ink", "soft", "line"))
_BEYOND, _BOARD, _ARM = "#f3f1ec", "#b9ae9a", "#5a7d9a"


class View(NamedTuple):
    """One robot at one instant."""

    time_s: float  # since the episode began
    cart_y_m: float
    ends_m: Array  # y, z of each link's far end, [n, 2]
    target_m: Array  # [2]
    success: bool
    shelf_m: Array | None = None  # y of the front edge, z of the lower board's top


class Picture:
    """One robot's drawing, redrawn at each `draw`."""

    def __init__(self, model: Model, rail_limit_m: float, radius_m: float, figure: "Figure | None" = None) -> None:
        """radius_m: of the target; figure: a window's, otherwise one in memory."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self._height_m, self._radius_m = model.arm.base_height_m, radius_m
        self.figure = figure or Figure(figsize=(SIZE[0] / _DPI, SIZE[1] / _DPI), dpi=_DPI)
        if figure is None:
            self._canvas = FigureCanvasAgg(self.figure)
        arm = sum(model.arm.link_length_m)
        half = model.cart.travel_m + arm + _ROOM_M
        low = self._height_m - arm - 2 * _ROOM_M
        self._axes = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set_axis_off()
        self._axes.set(xlim=(-half, half), ylim=(low, low + 2 * half * SIZE[1] / SIZE[0]))
        self._points_per_m = SIZE[0] / (2 * half) * 72 / _DPI
        self._trail: deque[Array] = deque(maxlen=_TRAIL)
        self._drawn_s = 0.0
        self._stage(model.cart.travel_m, rail_limit_m, half)
        self._actors()

    def draw(self, view: View) -> None:
        """Show a robot."""
        joints = np.vstack(((view.cart_y_m, self._height_m), view.ends_m))
        if view.time_s == 0.0 or view.time_s < self._drawn_s:
            self._trail.clear()  # another episode
        self._drawn_s = view.time_s
        self._trail.append(view.ends_m[-1])
        for line, points in ((self._arm, joints), (self._axis, joints), (self._path, np.array(self._trail))):
            line.set_data(*points.T)
        self._cart.set_xy((view.cart_y_m - _CART_M[0] / 2, self._height_m - _CART_M[1] / 2))
        colour = BLUE if view.success else ORANGE
        self._target.set(center=tuple(view.target_m), edgecolor=colour, facecolor=f"{colour}2c")
        self._middle.set_data(*view.target_m[:, None])
        self._middle.set_color(colour)
        for board, bottom_m in zip(self._boards, (-THICKNESS_M, APART_M), strict=True):
            board.set_visible(view.shelf_m is not None)
            if view.shelf_m is not None:  # it stands at -y of its front edge
                edge, top = view.shelf_m
                board.set_xy((edge - DEPTH_M, top + bottom_m))
        apart_cm = 100.0 * float(np.hypot(*(view.ends_m[-1] - view.target_m)))
        self._words.set_text(f"{view.time_s:4.1f} s   {'reached' if view.success else f'{apart_cm:.0f} cm off'}")

    def pixels(self) -> Pixels:
        """What was drawn, uint8 [height, width, 3]."""
        self._canvas.draw()
        return np.array(self._canvas.buffer_rgba())[:, :, :3]

    def _stage(self, travel_m: float, limit_m: float, half_m: float) -> None:
        """Paper, rail and its limits."""
        self.figure.set_facecolor(PAPER)
        for side in (-1.0, 1.0):
            self._axes.axvspan(*sorted((side * limit_m, side * half_m)), color=_BEYOND, linewidth=0, zorder=0)
            stop = (side * travel_m, side * travel_m)
            self._axes.plot(stop, (self._height_m - 0.02, self._height_m + 0.02), color=_INK, linewidth=2)
        self._axes.plot((-travel_m, travel_m), (self._height_m, self._height_m), color=_SOFT, linewidth=3, zorder=1)

    def _actors(self) -> None:
        """What moves."""
        from matplotlib.patches import Circle, Rectangle

        width = 2 * RADIUS_M * self._points_per_m
        add = self._axes.plot
        (self._arm,) = add(
            [], [], color=_ARM, alpha=0.35, linewidth=width, solid_capstyle="round", solid_joinstyle="round"
        )
        (self._axis,) = add([], [], ".-", color=_ARM, linewidth=1.5, markersize=5)
        (self._path,) = add([], [], color=_SOFT, linewidth=1.0)
        (self._middle,) = add([], [], "+", markersize=8, zorder=4)
        self._cart = Rectangle((0.0, 0.0), *_CART_M, facecolor=_INK, zorder=5)
        self._target = Circle((0.0, 0.0), self._radius_m, linewidth=1.5, zorder=3)
        self._boards = [
            Rectangle((0.0, 0.0), DEPTH_M, THICKNESS_M, facecolor=_BOARD, zorder=2, visible=False) for _ in range(2)
        ]
        for patch in (self._cart, self._target, *self._boards):
            self._axes.add_patch(patch)
        self._words = self._axes.text(
            0.015, 0.965, "", transform=self._axes.transAxes, va="top", color=_INK, fontsize=11, family="monospace"
        )


class Window:
    """A window that shows a picture in real time."""

    def __init__(self, model: Model, rail_limit_m: float, radius_m: float, fps: float) -> None:
        """Raises RuntimeError where there is no display, unless MPLBACKEND names what to draw on instead."""
        chosen = os.environ.get("MPLBACKEND")
        if not chosen and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise RuntimeError(
                "render_mode 'human' needs a display, and neither DISPLAY nor WAYLAND_DISPLAY names one: use "
                "render_mode='rgb_array' (gymnasium.wrappers.RecordVideo makes a film of it), or set MPLBACKEND"
            )
        from matplotlib import pyplot

        if chosen:  # which matplotlib has not seen where it was imported before
            pyplot.switch_backend(chosen)
        elif pyplot.get_backend().lower() == "agg":
            raise RuntimeError(
                "render_mode 'human' needs a window, and matplotlib finds nothing to make one with: install python3-tk "
                "or `pip install PySide6`, or use render_mode='rgb_array'"
            )
        self._pyplot, self._period_s, self._due_s = pyplot, 1.0 / fps, 0.0
        figure = pyplot.figure("softarm", figsize=(SIZE[0] / _DPI, SIZE[1] / _DPI), dpi=_DPI)
        self.picture = Picture(model, rail_limit_m, radius_m, figure)
        self.is_seen = pyplot.get_backend().lower() not in ("agg", "pdf", "ps", "svg", "cairo")
        if self.is_seen:
            figure.show()

    def show(self, view: View) -> None:
        """Draw, and wait until the frame's time is over. A window that a person has closed stays closed."""
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
        """Take it away."""
        self._pyplot.close(self.picture.figure)
