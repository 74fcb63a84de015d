"""Compiled law of an actuator that follows a command: a loop with lag and limits, a resonance, play and a sensor."""

# mypy: allow-untyped-defs, allow-untyped-calls
import math
from pathlib import Path

from softarm.simulator.compiled import compiler

compiled = compiler(Path(__file__))

# Columns of the parameters. DOWN: rate limit downwards; PERIOD: inverse of the natural frequency, s/rad; COUPLING:
# share of the damping between drive and sensor; LOOP: width of the hysteresis; DRY: dry friction.
SCALE, OFFSET, CEILING, WIDTH, RISE, FALL, RATE, DOWN, ACCELERATION = range(9)
PERIOD, DAMPING, COUPLING, GAP, STRENGTH, LOOP, BIAS, DRY = range(9, 17)
COLUMNS = 17
# Time constants shorter than this share of a substep count as zero.
FAST = 0.02
# Share of a limit from which a value equals it, up to rounding.
SAME = 1.0 - 1e-9


@compiled
def follow(command, edges, start, law, step_s, each, out):
    """Simulate an actuator that closes the error beyond its dead zone with a lag, within rate and acceleration limits.

    Behind the loop come a resonance, play, a rate-independent loop and the sensor's zero. A velocity loop with dry
    friction stays behind by DRY, and at rest under small commands. Neutral parameters change no bit of the result.

    Args:
        command: mean of the delayed command over each of the substeps (`each` per sample), measured unit, [n each].
        edges: command just before each edge of a substep, [n each + 1].
        start: first reading.
        law: parameters by the columns above.
        step_s: length of a substep.
        each: substeps per sample.
        out: measured value before each sample's substeps, [n].
    """
    y = x = start - law[BIAS]
    v = swing = 0.0
    seen, half = y, 0.5 * law[GAP]
    up, down = _closing(law[RISE], step_s), _closing(law[FALL], step_s)
    bent_up, bent_down = _straight(up, law[RISE], step_s), _straight(down, law[FALL], step_s)
    change = law[ACCELERATION] * step_s
    rings, late = law[PERIOD] > FAST * step_s, 2.0 * law[DAMPING] * law[PERIOD] * (1.0 - law[COUPLING])
    keep, gain, fall, hold = _ring(law[PERIOD], law[DAMPING], step_s) if rings else (0.0, 0.0, 0.0, 0.0)
    kick = 2.0 * law[DAMPING] * law[COUPLING] / law[PERIOD] * step_s if rings else 0.0
    near = min(_slower(law[RATE], law[RISE]), _slower(law[DOWN], law[FALL]))
    turned, height, dry = 0.0, law[STRENGTH] * law[LOOP], law[DRY]
    for i in range(len(out)):
        before = seen
        seen = min(max(seen, y - half), y + half)
        if height > 0.0 and seen != before:
            towards = 1.0 if seen > before else -1.0
            turned += (towards - turned) * (1.0 - math.exp(-abs(seen - before) / law[LOOP]))
        out[i] = seen - height * turned + law[BIAS]
        for s in range(each):
            end, was = _end(command[i * each + s], law), x
            beyond = _beyond((end if dry == 0.0 else _rubbed(end, x, dry)) - x, law[WIDTH])
            closing, straight = (up, bent_up) if beyond > 0.0 else (down, bent_down)
            wanted, k = beyond * closing, i * each + s
            if near < math.inf and (abs(_end(edges[k], law) - x) > near or abs(_end(edges[k + 1], law) - x) > near):
                wanted = _limited(command, edges, k, x, law, step_s)
            held = abs(wanted - v) > change
            v = v + (change if wanted > v else -change) if held else wanted
            x += v * step_s
            if dry > 0.0 and x * was < 0.0:  # the speed changes sign: friction reverses or holds
                beyond = _beyond((end + dry if was > 0.0 else end - dry) - was, law[WIDTH])
                away = min(max(beyond * closing, -law[DOWN]), law[RATE]) * step_s
                x = min(max(x, was + away), 0.0) if was > 0.0 else max(min(x, was + away), 0.0)
                v = (x - was) / step_s
            if rings:  # the resonance is led along a straight line after a jump
                lead = v if held or wanted >= SAME * law[RATE] or wanted <= -SAME * law[DOWN] else straight * v
                away, faster = y - (x - lead * (step_s + late)), swing - lead + kick * (v - lead)
                y = x - lead * late + keep * away + gain * faster
                swing = lead + fall * away + hold * faster
            else:
                y = x


@compiled
def _end(command, law):
    """Final value under a command."""
    return min(command * (1.0 + law[SCALE]) + law[OFFSET], law[CEILING])


@compiled
def _slower(rate, lag_s):
    """Error up to which a lag is slower than a rate limit."""
    return rate * lag_s if rate < math.inf else math.inf


@compiled
def _beyond(error, width):
    """Part of an error beyond a dead zone."""
    return error - min(max(error, -width), width)


@compiled
def _rubbed(end, speed, dry):
    """Final speed with dry friction, which opposes the motion or holds a mass at rest."""
    if speed > 0.0:
        return end - dry
    return end + dry if speed < 0.0 else _beyond(end, dry)


@compiled
def _closing(lag_s, step_s):
    """Share of an error that closes in a substep, per second."""
    return (1.0 - math.exp(-step_s / lag_s)) / step_s if lag_s > FAST * step_s else 1.0 / step_s


@compiled
def _limited(command, edges, k, x, law, step_s):
    """Mean speed in a substep with a rate limit, before and after the command's change in it.

    With the mean of the command the motion would begin at the start of the substep instead of at the change, and every
    fitted limit would be too low.
    """
    before, after = edges[k], edges[k + 1]
    if before == after or law[DRY] > 0.0:
        before = after = command[k]
    first = min(max((after - command[k]) / (after - before), 0.0), 1.0) * step_s if before != after else 0.0
    at = x
    for end, time in ((before, first), (after, step_s - first)):
        if time > 0.0:
            end = _end(end, law)
            at += _closed((end if law[DRY] == 0.0 else _rubbed(end, at, law[DRY])) - at, law, time)
    return (at - x) / step_s


@compiled
def _closed(error, law, time_s):
    """Distance that is closed in a time: at the rate limit until the lag alone is slower, then as a lag."""
    beyond = _beyond(error, law[WIDTH])
    lag_s, rate = (law[RISE], law[RATE]) if beyond > 0.0 else (law[FALL], law[DOWN])
    size = abs(beyond)
    if lag_s <= FAST * time_s:
        distance = min(size, rate * time_s)
    else:
        full_s = max(size / rate - lag_s, 0.0)
        gone = min(full_s, time_s) * rate if full_s > 0.0 else 0.0
        distance = gone + (size - gone) * (1.0 - math.exp(min(full_s - time_s, 0.0) / lag_s))
    return distance if beyond > 0.0 else -distance


@compiled
def _straight(closing, lag_s, step_s):
    """Share of a substep's distance on a straight line; the rest is a jump at its start, so that the mean is right."""
    return 2.0 * (1.0 - 1.0 / (closing * step_s) + lag_s / step_s) if lag_s > FAST * step_s else 0.0


@compiled
def _ring(period, damping, step_s):
    """Exact transition matrix of a damped oscillator's distance and speed over a step."""
    w = 1.0 / period
    decay = math.exp(-damping * w * step_s)
    if damping < 1.0 - 1e-6:
        root = math.sqrt(1.0 - damping * damping) * w
        c, s = math.cos(root * step_s), math.sin(root * step_s) / root
    elif damping > 1.0 + 1e-6:
        root = math.sqrt(damping * damping - 1.0) * w
        c, s = math.cosh(root * step_s), math.sinh(root * step_s) / root
    else:
        c, s = 1.0, step_s
    slow = damping * w * s
    return decay * (c + slow), decay * s, -decay * w * w * s, decay * (c - slow)
