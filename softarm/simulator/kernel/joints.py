"""Nonlinear joint torques, the payload's tension and air drag."""

# mypy: allow-untyped-defs, allow-untyped-calls
from softarm.simulator.kernel.compiled import compiled
from softarm.simulator.kernel.layout import rows
from softarm.simulator.kernel.numerics import clip, grip
from softarm.simulator.simd import fill, load, root, select, store

# Elastic deflection of a joint's dry friction before it slips, rad.
REACH_RAD = 3e-4


@compiled
def add_joints(m, w, links, lanes, dt):
    """Add stiffening, creep and dry friction of every joint to the equations of motion.

    Stiffening K cubic theta^3 is linearised about the midpoint. Creep is a spring and a slow damper in series
    parallel to each joint: a standard linear solid, whose stiffness falls from K to K (1 - strength) over time.
    """
    at, order, h = rows(links), len(links) + 1, 0.5 * dt
    cubic, friction = load(m, at.cubic, lanes), load(m, at.joint_friction, lanes)
    strength, keep, mean = load(m, at.creep, lanes), load(m, at.keep_creep, lanes), load(m, at.mean_creep, lanes)
    angle_before = rate_before = last_before = fill(cubic, 0.0)
    for i in range(len(links)):
        rate = load(m, at.v + 1 + i, lanes)
        angle = load(m, at.q + 1 + i, lanes) + h * rate
        last = load(m, at.a + 1 + i, lanes)
        bend, turn, speeding = angle - angle_before, rate - rate_before, last - last_before
        angle_before, rate_before, last_before = angle, rate, last
        stiffness = load(m, at.stiffness + i, lanes)
        steeper = cubic * bend * bend * stiffness
        behind = load(m, at.crept + i, lanes) - bend
        store(m, at.crept + i, lanes, bend + keep * behind)
        held, holding = grip(m, lanes, at.bristle + i, friction, REACH_RAD, turn, speeding, dt)
        torque = held - steeper * bend + stiffness * strength * (bend + mean * behind)
        inertia = holding + select(steeper > 0.0, (3.0 * h * h) * steeper, 0.0)
        own = at.matrix + (i + 1) * (order + 1)
        store(w, own, lanes, load(w, own, lanes) + inertia)
        store(w, at.rhs + i + 1, lanes, load(w, at.rhs + i + 1, lanes) + torque)
        if i > 0:
            store(w, own - 1, lanes, load(w, own - 1, lanes) - inertia)
            above = own - order - 1
            store(w, above, lanes, load(w, above, lanes) + inertia)
            store(w, at.rhs + i, lanes, load(w, at.rhs + i, lanes) - torque)


@compiled
def settle_joints(m, w, links, lanes, dt):
    """Shear the joints' dry friction by the way of a substep; before the rates are advanced."""
    at, h = rows(links), 0.5 * dt
    before = fill(load(m, at.q, lanes), 0.0)
    for i in range(len(links)):
        mean = load(m, at.v + 1 + i, lanes) + h * load(w, at.rhs + 1 + i, lanes)
        bristle = load(m, at.bristle + i, lanes) + dt * (mean - before)
        store(m, at.bristle + i, lanes, clip(bristle, -REACH_RAD, REACH_RAD))
        before = mean


@compiled
def add_payload(m, w, links, lanes, dt):
    """Add the implicit straightening of the links by the payload's weight and centrifugal force.

    The payload's mass is already in the parameters. It makes the light links a string under tension, with transverse
    modes that no training step resolves. A stiffness keeps them stable.
    """
    at, order, h = rows(links), len(links) + 1, 0.5 * dt
    payload = (h * h) * load(m, at.payload, lanes)
    down, aside = payload * load(w, at.tip_down, lanes), payload * load(w, at.tip_aside, lanes)
    for i in range(len(links)):
        pull = load(w, at.reach_y + i, lanes) * down + load(w, at.reach_z + i, lanes) * aside
        own = at.matrix + (i + 1) * (order + 1)
        store(w, own, lanes, load(w, own, lanes) + select(pull > 0.0, pull, 0.0))


@compiled
def add_drag(m, w, links, lanes, dt):
    """Add drag -c |v| v at every link's centre, at the midpoint as predicted from the last acceleration.

    The force is explicit, so a substep takes at most half of a link's own momentum. At 240 Hz this cap only acts on
    shells of 5 g beyond c |v| = 0.6 N s/m.
    """
    at, n, h = rows(links), len(links), 0.5 * dt
    coefficient, slowest = load(m, at.drag, lanes), 1.0 / dt
    vy = load(m, at.v, lanes) + h * load(m, at.a, lanes)
    vz = fill(vy, 0.0)
    for i in range(n):
        half = 0.5 * load(w, at.rate + i, lanes)
        reach_y, reach_z = load(w, at.reach_y + i, lanes), load(w, at.reach_z + i, lanes)
        vy, vz = vy + half * reach_y, vz + half * reach_z  # the centre
        slowing = coefficient * root(vy * vy + vz * vz)
        most = load(m, at.drag_most + i, lanes) * slowest
        slowing = select(slowing > most, most, slowing)
        store(w, at.drag_y + i, lanes, 0.0 - slowing * vy)
        store(w, at.drag_z + i, lanes, 0.0 - slowing * vz)
        vy, vz = vy + half * reach_y, vz + half * reach_z  # the end
    beyond_y = beyond_z = fill(vy, 0.0)  # the forces on all links after this one
    for i in range(n - 1, -1, -1):
        fy, fz = load(w, at.drag_y + i, lanes), load(w, at.drag_z + i, lanes)
        torque = load(w, at.reach_y + i, lanes) * (beyond_y + 0.5 * fy)
        torque = torque + load(w, at.reach_z + i, lanes) * (beyond_z + 0.5 * fz)
        store(w, at.rhs + i + 1, lanes, load(w, at.rhs + i + 1, lanes) + torque)
        beyond_y, beyond_z = beyond_y + fy, beyond_z + fz
    store(w, at.rhs, lanes, load(w, at.rhs, lanes) + beyond_y)
