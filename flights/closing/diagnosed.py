"""The rail's limits where a campaign shows too little of them, but its diagnosis says how late the rail is."""

import math
from dataclasses import replace

from softarm.common.keys import find
from softarm.daemon.limits.findings import LATENCY_TOLERANCE_S, LimitRow, RailFindings
from softarm.schemas.config import Config
from softarm.schemas.verdict import Verdict


def with_diagnosed(rail: RailFindings, verdict: Verdict) -> RailFindings:
    """A named `rail.delay` counts as the latency, to its interval's end, where too few set-points stepped to see it.

    Never milder than configured. What no configuration may hold is left without advice, as elsewhere.
    """
    named = next((effect.parameters.get("delay") for effect in verdict.effects if effect.name == "rail.delay"), None)
    if named is None:
        return rail
    late_s = math.ceil(1e3 * max(named.value, named.high) - 1e-6) / 1e3
    said = f"the diagnosis names rail.delay, {1e3 * named.value:.0f} ms, {1e3 * named.high:.0f} at most"

    def row(old: LimitRow) -> LimitRow:
        if old.key != "latency_s" or old.bound is not None or late_s <= old.configured + LATENCY_TOLERANCE_S:
            return old
        allowed = find(Config, ("limits", "rail", "latency_s"))
        takes = allowed is not None and allowed.quantity is not None and allowed.quantity.takes(late_s)
        return replace(old, advised=late_s if takes else None, why=f"{said}; {old.why}")

    return replace(rail, rows=tuple(row(old) for old in rail.rows))
