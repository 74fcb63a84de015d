"""The last minutes as columns of numbers, for charts that survive a reload.

The recorder's thread writes and others read without blocking it: a row counts only when complete, and spare rows
separate the oldest row on offer from the next one to be written.
"""

import math
import threading
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.daemon.control.records import Mode, Outputs
from softarm.schemas.messages import BODY_NAMES, MocapFrame
from softarm.schemas.robot import CONTROL_RATE_HZ

KEPT_S = 600
BLOCK = CONTROL_RATE_HZ  # rows that are encoded together, once for all clients
KEPT, SPARE = KEPT_S * CONTROL_RATE_HZ, 20 * BLOCK  # rows

NAN = math.nan
# Column: decimal places and the value of a tick.
COLUMNS: dict[str, tuple[int, Callable[[Outputs], float | None]]] = {
    "tip_y_m": (4, lambda o: o.observed.values.tip_y_m if o.observed else NAN),
    "tip_z_m": (4, lambda o: o.observed.values.tip_z_m if o.observed else NAN),
    "cart_m": (4, lambda o: o.rail_position_m),
    "cart_velocity_m_s": (4, lambda o: o.rail_velocity_m_s),
    "action_velocity_m_s": (4, lambda o: o.action[0] if o.action else NAN),
    "sent_velocity_m_s": (4, lambda o: o.sent.cart_velocity_m_s),
    "pressure_kpa": (3, lambda o: o.observed.values.pressure_kpa if o.observed else NAN),
    "action_pressure_kpa": (3, lambda o: o.action[1] if o.action else NAN),
    "sent_pressure_kpa": (3, lambda o: o.sent.pressure_kpa),
    "late_ms": (3, lambda o: o.late_ns * 1e-6),
    "policy_ms": (3, lambda o: o.policy_ns * 1e-6),
    "mocap_age_ms": (2, lambda o: o.observed.mocap_age_ns * 1e-6 if o.observed else NAN),
    "pressure_age_ms": (2, lambda o: o.observed.pressure_age_ns * 1e-6 if o.observed else NAN),
    "rail_age_ms": (2, lambda o: o.observed.rail_age_ns * 1e-6 if o.observed else NAN),
}
MODES = tuple(Mode)
NAMES = ("tick", "time", *COLUMNS, "bodies", "mode")


class Recent:
    """Ring buffer of the newest `KEPT_S` seconds of ticks."""

    def __init__(self, monotonic_ns: Callable[[], int], wall_ns: Callable[[], int]) -> None:
        """Allocate the buffer; the clocks convert tick times to Unix time."""
        self._monotonic_ns, self._wall_ns = monotonic_ns, wall_ns
        rows = KEPT + SPARE
        self._values = np.full((rows, len(COLUMNS)), NAN)
        self._bodies = np.full((rows, len(BODY_NAMES), 2), NAN)
        self._frame: MocapFrame | None = None  # the newest
        self._stamps = np.zeros((rows, 3), dtype=np.int64)  # tick, start of the tick in ns, mode
        self._count = 0  # rows written so far
        self._texts: dict[int, tuple[str, ...]] = {}  # by block
        self._reading = threading.Lock()

    def take(self, outputs: Outputs, frames: Sequence[MocapFrame] = ()) -> None:
        """Add a tick with the frames that it received. For one thread only."""
        row = self._count % len(self._values)
        self._values[row] = [NAN if (value := of(outputs)) is None else value for _, of in COLUMNS.values()]
        self._frame = frames[-1] if frames else self._frame
        if self._frame is not None:
            self._bodies[row] = [(b.y_m, b.z_m) if b.tracked else (NAN, NAN) for b in self._frame.bodies]
        self._stamps[row] = outputs.tick, outputs.t_ns, MODES.index(outputs.mode)
        self._count += 1

    def json(self, seconds: float) -> str:
        """Return a JSON object of columns with at least the newest `seconds`, if kept; NaN and infinity are null.

        Encodes each block once and releases the interpreter every 30 numbers.
        """
        with self._reading:
            first, count = self._since(seconds), self._count
            texts = [self._text(block, count) for block in range(first // BLOCK, -(-count // BLOCK))]
            oldest = (count - KEPT) // BLOCK
            for block in [block for block in self._texts if block < oldest]:
                del self._texts[block]
        columns = (",".join(text) for text in zip(*texts, strict=True)) if texts else ("" for _ in NAMES)
        return "{" + ",".join(f'"{name}":[{column}]' for name, column in zip(NAMES, columns, strict=True)) + "}"

    def _since(self, seconds: float) -> int:
        """Return the first row of the block that is `seconds` older than the newest row."""
        count = self._count
        if count == 0:
            return 0
        oldest = max(0, -(-(count - KEPT) // BLOCK) * BLOCK)
        since_ns = self._stamps[(count - 1) % len(self._stamps), 1] - round(seconds * 1e9)
        wanted = count
        while wanted > oldest and self._stamps[(wanted - 1) % len(self._stamps), 1] >= since_ns:
            wanted = max(oldest, wanted - BLOCK)
        return wanted // BLOCK * BLOCK

    def _text(self, block: int, count: int) -> tuple[str, ...]:
        """Return a block's encoded columns, cached if the block is complete."""
        known = self._texts.get(block)
        if known is not None:
            return known
        rows = np.arange(block * BLOCK, min((block + 1) * BLOCK, count)) % len(self._values)
        text = tuple(self._columns(self._values[rows], self._bodies[rows], self._stamps[rows]))
        if len(rows) == BLOCK:
            self._texts[block] = text
        return text

    def _columns(
        self, values: NDArray[np.float64], bodies: NDArray[np.float64], stamps: NDArray[np.int64]
    ) -> Iterator[str]:
        wall_ns = self._wall_ns() - self._monotonic_ns()
        yield ",".join(map(str, stamps[:, 0].tolist()))
        yield ",".join(f"{(t_ns + wall_ns) * 1e-9:.3f}" for t_ns in stamps[:, 1].tolist())
        for column, (digits, _) in zip(values.T, COLUMNS.values(), strict=True):
            yield ",".join(f"{value:.{digits}f}" if math.isfinite(value) else "null" for value in column.tolist())
        yield ",".join(f"[{','.join(map(_spot, tick))}]" for tick in bodies.tolist())
        yield ",".join(f'"{MODES[place]}"' for place in stamps[:, 2].tolist())


def _spot(body: tuple[float, float]) -> str:
    """Return y and z of a body as JSON, or null if it is not tracked."""
    y_m, z_m = body
    return f"[{y_m:.4f},{z_m:.4f}]" if math.isfinite(y_m) and math.isfinite(z_m) else "null"
