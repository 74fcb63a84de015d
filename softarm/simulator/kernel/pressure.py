"""Delayed commands, and the pressure stage from the command to the muscle's effective pressure."""

# mypy: allow-untyped-defs, allow-untyped-calls
from softarm.simulator.kernel.compiled import compiled
from softarm.simulator.kernel.layout import HISTORY, MUSCLE, OLD, PRESSURE, PRESSURE_GIVEN
from softarm.simulator.kernel.numerics import clip, loss_over, tanh_over
from softarm.simulator.simd import load, magnitude, select, some, store


@compiled
def issue(m, lanes, command, history, width, late):
    """Put each lane's command at the head of its history, unless it is within `width` of the newest.

    Args:
        history: the first of HISTORY rows of commands, which HISTORY rows of ages follow.
        late: seconds from the start of the step to the issue of the command.
    """
    change = command - load(m, history, lanes)
    fresh = change - clip(change, 0.0 - width, width) != 0.0  # a NaN is always fresh
    if some(fresh):
        for first in (history, history + HISTORY):
            for i in range(first + HISTORY - 1, first, -1):
                store(m, i, lanes, select(fresh, load(m, i - 1, lanes), load(m, i, lanes)))
        store(m, history, lanes, select(fresh, command, load(m, history, lanes)))
        store(m, history + HISTORY, lanes, select(fresh, 0.0 - late, load(m, history + HISTORY, lanes)))


@compiled
def age(m, lanes, history, duration):
    """Add a step's duration to the ages of a history, capped so that they keep their digits."""
    for i in range(history + HISTORY, history + 2 * HISTORY):
        older = load(m, i, lanes) + duration
        store(m, i, lanes, select(older > OLD, OLD, older))


@compiled
def due(m, lanes, history, delay, end, dt):
    """Return the commands in force at the end and at the start of a substep, and the later one's share of it.

    The share makes the motion depend smoothly on delays.

    Args:
        end: seconds from the start of the step to the end of the substep.
    """
    latest = load(m, history, lanes)
    wait = delay - load(m, history + HISTORY, lanes)  # from the start of the step
    limit = end - 1e-3 * dt  # so that rounding does not start a command a substep early
    for i in range(1, HISTORY):
        early = wait > limit
        if not some(early):
            break
        latest = select(early, load(m, history + i, lanes), latest)
        wait = select(early, delay - load(m, history + HISTORY + i, lanes), wait)
    before = load(m, history + 2 * HISTORY, lanes)
    store(m, history + 2 * HISTORY, lanes, latest)
    share = select(latest != before, (end - wait) * (1.0 / dt), 1.0)
    return latest, before, clip(share, 0.0, 1.0)


@compiled
def regulate(m, lanes, at, active, end, dt):
    """Advance the pressure by a substep and return its mean over the substep, kPa."""
    old = load(m, at.pressure, lanes)
    if active & PRESSURE_GIVEN:
        slope = load(m, at.pressure_slope, lanes)
        store(m, at.pressure, lanes, old + dt * slope)
        return old + (0.5 * dt) * slope
    target = load(m, at.pressure_command, lanes)
    if active & PRESSURE:
        target, before, share = due(m, lanes, at.pressure_history, load(m, at.dead_time, lanes), end, dt)
        target = select(share < 1.0, before + share * (target - before), target)
        target = target * load(m, at.pressure_gain, lanes) + load(m, at.pressure_offset, lanes)
        ceiling = load(m, at.ceiling, lanes)
        target = select(target > ceiling, ceiling, target)
    inflating = old < target
    if active & PRESSURE:
        target = target * select(inflating, load(m, at.reach_inflate, lanes), load(m, at.reach_deflate, lanes))
    # An exact first-order lag; `prepare` has put the leak into its time constants.
    gap = old - target
    keep = select(inflating, load(m, at.keep_inflate, lanes), load(m, at.keep_deflate, lanes))
    mean = select(inflating, load(m, at.mean_inflate, lanes), load(m, at.mean_deflate, lanes))
    new, mean = target + keep * gap, target + mean * gap
    if active & PRESSURE:
        most = load(m, at.pressure_rate, lanes) * dt
        lost = load(m, at.leak, lanes) * dt * old
        flow = new - old + lost
        limited = clip(flow, 0.0 - most, most)
        choked = limited != flow
        new = select(choked, old + (limited - lost), new)
        mean = select(choked, old + 0.5 * (limited - lost), mean)
    store(m, at.pressure, lanes, new)
    return mean


@compiled
def pull(m, lanes, at, active, before, mean):
    """Return the muscle's effective pressure after hysteresis and saturation, kPa.

    Hysteresis is Bouc-Wen's with exponent 1 in its closed form: the loop's state approaches the direction of change
    by exp(-|change| / width), at any rate.

    Args:
        before: the pressure at the start of the substep, kPa.
        mean: the mean pressure over the substep, kPa.
    """
    if not active & MUSCLE:
        return mean
    change = load(m, at.pressure, lanes) - before
    path = magnitude(change) * load(m, at.muscle_width, lanes)
    loop = load(m, at.loop, lanes)
    nearer = (select(change > 0.0, 1.0 + 0.0 * loop, -1.0) - loop) * (path * loss_over(path))
    store(m, at.loop, lanes, loop + nearer)
    pulling = mean - load(m, at.muscle_loop, lanes) * (loop + 0.5 * nearer)
    return pulling * tanh_over(pulling * load(m, at.saturation, lanes))
