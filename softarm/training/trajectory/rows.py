"""Results of plans and of the ceiling's search as plain rows, one per target and start."""

from collections.abc import Callable, Sequence
from statistics import fmean
from typing import NamedTuple, TypedDict

from softarm.schemas.flights import in_range
from softarm.schemas.model import Model
from softarm.training.trajectory.ceiling import search
from softarm.training.trajectory.planner import Report
from softarm.training.trajectory.problem import Array


class Row(TypedDict):
    """Result of one target from one start, with distances of the tip from the target."""

    y: float
    z: float
    start: float
    planned: bool | None  # reached in the plan with the cart within its limit; None for a search
    planned_miss_m: float | None
    miss_m: float
    reached: bool
    time_s: float | None  # until it was reached


class Part(NamedTuple):
    """Summary of several rows."""

    rows: int
    planned: float | None  # share; None for a search
    reached: float  # share
    mean_time_s: float | None  # of reached targets, if any


def of_plans(report: Report) -> list[Row]:
    """Return a row per plan, start by start."""
    plans = report.plans
    flown = zip(plans.target_m, plans.cart_start_m, plans.miss_m, report.reached_s, strict=True)
    rows = [_row(*each) for each in flown]
    for row, planned, miss_m in zip(rows, report.planned, report.planned_miss_m, strict=True):
        row["planned"], row["planned_miss_m"] = bool(planned), float(miss_m)
    return rows


def of_searches(
    targets_m: Array,
    starts_m: Sequence[float],
    model: Model | None = None,
    seed: int = 0,
    on_round: Callable[[], None] = lambda: None,
) -> list[Row]:
    """Search open-loop commands for every target [G, 2] from every start, start by start."""
    rows = []
    for start_m in starts_m:
        found = search(targets_m, start_m, model, seed, on_round=on_round)
        columns = zip(targets_m, found.closest_m, found.reached_s, strict=True)
        rows += [_row(target, start_m, miss_m, reached_s) for target, miss_m, reached_s in columns]
    return rows


def by_height(rows: Sequence[Row]) -> dict[str, Part]:
    """Summarise rows by height of their targets, and all rows; empty parts are left out."""
    low, above = ([row for row in rows if in_range(row["z"]) == inside] for inside in (True, False))
    parts = {"z <= 0.70 m": low, "z > 0.70 m": above, "all": rows}
    return {label: _part(part) for label, part in parts.items() if part}


def _part(rows: Sequence[Row]) -> Part:
    hits = [row["planned"] for row in rows if row["planned"] is not None]
    times_s = [row["time_s"] for row in rows if row["time_s"] is not None]
    return Part(
        rows=len(rows),
        planned=fmean(hits) if hits else None,
        reached=len(times_s) / len(rows),
        mean_time_s=fmean(times_s) if times_s else None,
    )


def _row(target_m: Array, start_m: float, miss_m: float, reached_s: float) -> Row:
    """Return a row of plain numbers; `reached_s` is NaN for a missed target."""
    reached = bool(reached_s == reached_s)
    return Row(
        y=round(float(target_m[0]), 6),
        z=round(float(target_m[1]), 6),
        start=round(float(start_m), 6),
        planned=None,
        planned_miss_m=None,
        miss_m=float(miss_m),
        reached=reached,
        time_s=float(reached_s) if reached else None,
    )
