"""Rail latency taken from the diagnosis where the campaign itself shows too little of it."""

import math
from dataclasses import replace

from softarm.common.keys import find
from softarm.daemon.limits.findings import LATENCY_TOLERANCE_S, MeasuredLimit, RailFindings
from softarm.schemas.config import Config
from softarm.schemas.verdict import Verdict


def with_diagnosed(rail: RailFindings, verdict: Verdict) -> RailFindings:
    """Use the upper bound of a named `rail.delay` as latency where too few set-point steps show the latency.

    The latency is never less strict than configured. A latency that no configuration allows has no advised value.
    """
    named = next((effect.parameters.get("delay") for effect in verdict.effects if effect.name == "rail.delay"), None)
    if named is None:
        return rail
    late_s = math.ceil(1e3 * max(named.value, named.high) - 1e-6) / 1e3
    reason = f"the diagnosis names rail.delay, {1e3 * named.value:.0f} ms, {1e3 * named.high:.0f} at most"

    def row(old: MeasuredLimit) -> MeasuredLimit:
        if old.key != "latency_s" or old.bound is not None or late_s <= old.configured + LATENCY_TOLERANCE_S:
            return old
        allowed = find(Config, ("limits", "rail", "latency_s"))
        takes = allowed is not None and allowed.quantity is not None and allowed.quantity.takes(late_s)
        return replace(old, advised=late_s if takes else None, why=f"{reason}; {old.why}")

    return replace(rail, rows=tuple(row(old) for old in rail.rows))
