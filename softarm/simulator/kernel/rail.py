"""The rail stage: from velocity command to the force on the cart."""

# mypy: allow-untyped-defs, allow-untyped-calls
from softarm.simulator.kernel.compiled import compiled
from softarm.simulator.kernel.layout import RAIL
from softarm.simulator.kernel.numerics import clip, grip
from softarm.simulator.kernel.pressure import due
from softarm.simulator.simd import fill, load, magnitude, select, some, store

# Elastic deflection of dry friction before it slips, m.
REACH_M = 5e-5


@compiled
def _law(m, lanes, at, command, v, dt):
    """Return the drive's force (N) and implicit mass (kg).

    Above the switch the drive tracks a fixed acceleration, below it the velocity. `share` is the part of the substep
    before the crossing, predicted from the last acceleration; without the prediction every crossing is late.
    """
    error = command - v
    sign = select(error > 0.0, fill(error, 1.0), -1.0)
    closing = load(m, at.a, lanes) * sign * dt
    closing = select(closing > 1e-6, closing, 1e-6)
    share = clip((error * sign - load(m, at.switch, lanes)) / closing, 0.0, 1.0)
    gain = (1.0 - share) * load(m, at.velocity_gain, lanes)
    force = share * sign * load(m, at.drive_force, lanes) + gain * error
    return force, share * load(m, at.drive_inertia, lanes) + 0.5 * dt * gain


@compiled
def _follow(m, lanes, at, command, before, share):
    """Pass a command through the feed constant and the lag; return its mean over the substep, m/s."""
    gain, lagged = load(m, at.rail_gain, lanes), load(m, at.lagged, lanes)
    command, before = command * gain, before * gain
    target = select(share < 1.0, before + share * (command - before), command)
    store(m, at.lagged, lanes, target + load(m, at.keep_rail, lanes) * (lagged - target))
    return command + load(m, at.mean_rail, lanes) * (lagged - command)


@compiled
def _serve(m, lanes, at, command, before, share, v, dt):
    """Return the servo's mean reference (m/s), its force (N) and implicit mass (kg): a ramp, a lag, a velocity loop.

    The loop's force is a feed-forward of the reference's acceleration plus a gain on the velocity error. The cart does
    not feed back to the ramp: the ramp continues where the motor cannot follow.
    """
    gain, most = load(m, at.rail_gain, lanes), dt * load(m, at.ramp, lanes)
    first = load(m, at.ramped, lanes)
    earlier, later = (1.0 - share) * most, share * most
    way = clip(before * gain - first, 0.0 - earlier, earlier)
    turn = first + way
    further = clip(command * gain - turn, 0.0 - later, later)
    last = turn + further
    store(m, at.ramped, lanes, last)
    # A straight ramp behind the lag is exact; a ramp with corners adds its mean lead over the straight one.
    rising = 0.5 * (way * magnitude(way) + further * magnitude(further)) / most
    ahead = turn + share * further - rising - 0.5 * (first + last)
    old, keep, left = load(m, at.reference, lanes), load(m, at.keep_rail, lanes), load(m, at.mean_rail, lanes)
    new = last - left * (last - first) + keep * (old - first) + (1.0 - keep) * left * ahead
    store(m, at.reference, lanes, new)
    mean, loop = 0.5 * (old + new), load(m, at.velocity_gain, lanes)
    force = loop * (mean - v) + load(m, at.feedforward, lanes) * ((new - old) * (1.0 / dt))
    return mean, force, 0.5 * dt * loop


@compiled
def _engage(m, lanes, at, error, force, dt):
    """Return the share of the substep in which the drive touches the cart, and move within the backlash.

    Between the flanks the drive runs at its commanded velocity and the cart feels nothing.
    """
    half = 0.5 * load(m, at.backlash, lanes)
    play = load(m, at.play, lanes)
    sign = select(force > 0.0, fill(force, 1.0), -1.0)
    left = half - play * sign  # way to the flank that transmits the force
    way = error * dt
    store(m, at.play, lanes, clip(play + way, 0.0 - half, half))
    closing = way * sign
    closing = select(closing > 1e-9, closing, 1e-9)
    return clip(1.0 - left / closing, 0.0, 1.0)


@compiled
def drive(m, lanes, at, active, end, dt):
    """Return the force (N) and implicit mass (kg) of drive, friction and end stops in the cart's row."""
    h, v = 0.5 * dt, load(m, at.v, lanes)
    issued, before, share = due(m, lanes, at.rail_history, load(m, at.rail_delay, lanes), end, dt)
    command = issued
    if active & RAIL:
        command = _follow(m, lanes, at, issued, before, share)
    force, mass = _law(m, lanes, at, command, v, dt)
    # Where the command changes within the substep, the earlier command's force of one substep ago gets its share.
    earlier, mass_earlier = load(m, at.drive_before, lanes), load(m, at.drive_mass_before, lanes)
    store(m, at.drive_before, lanes, force)
    store(m, at.drive_mass_before, lanes, mass)
    shared = share < 1.0
    force = select(shared, earlier + share * (force - earlier), force)
    mass = select(shared, mass_earlier + share * (mass - mass_earlier), mass)
    if active & RAIL:
        served = load(m, at.servo, lanes) > 0.0
        if some(served):
            mean, driving, inertia = _serve(m, lanes, at, issued, before, share, v, dt)
            command, force = select(served, mean, command), select(served, driving, force)
            mass = select(served, inertia, mass)
        touching = _engage(m, lanes, at, command - v, force, dt)
        force, mass = touching * force, touching * mass
        store(m, at.drive_given, lanes, force)
        store(m, at.drive_given_mass, lanes, mass)
        limit = load(m, at.force_limit, lanes)
        store(m, at.drive_most, lanes, select(touching > 0.0, touching * limit, 0.0))  # not 0 times infinity
        friction, last = load(m, at.cart_friction, lanes), load(m, at.a, lanes)
        held, holding = grip(m, lanes, at.cart_bristle, friction, REACH_M, v, last, dt)
        viscous = load(m, at.cart_viscous, lanes)
        force, mass = force + held - viscous * v, mass + holding + h * viscous

    # The end stops are stiff: taken at the end of the substep, since the midpoint would let the cart bounce.
    foreseen = load(m, at.q, lanes) + dt * v
    travel = load(m, at.travel, lanes)
    if some(magnitude(foreseen) > travel):
        beyond = foreseen - clip(foreseen, 0.0 - travel, travel)
        stiffness = select(beyond != 0.0, load(m, at.stop_stiffness, lanes), 0.0)
        damping = select(beyond != 0.0, load(m, at.stop_damping, lanes), 0.0)
        force = force - stiffness * beyond - damping * v
        mass = mass + dt * (damping + h * stiffness)
    return force, mass


@compiled
def lacking(m, lanes, at, acceleration):
    """Return the force that the limit takes from the drive at an acceleration of the cart, N; 0 within the limit."""
    force = load(m, at.drive_given, lanes) - load(m, at.drive_given_mass, lanes) * acceleration
    most = load(m, at.drive_most, lanes)
    return clip(force, 0.0 - most, most) - force


@compiled
def gives_way(m, lanes, at, lack, response):
    """Return the change of force on the cart's row that leaves the drive at its limit, N.

    The drive's implicit mass reacts to the change as well, so that the limit holds for the whole force and not only
    for its explicit part.

    Args:
        response: the cart's acceleration per newton on its row, 1/kg.
    """
    return lack / (1.0 - load(m, at.drive_given_mass, lanes) * response)


@compiled
def settle_cart(m, lanes, at, way):
    """Shear the cart's dry friction by the way of a substep, m."""
    store(m, at.cart_bristle, lanes, clip(load(m, at.cart_bristle, lanes) + way, -REACH_M, REACH_M))
