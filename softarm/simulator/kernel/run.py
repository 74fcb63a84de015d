"""Entry points of the kernel: a step of every block of a batch."""

# mypy: allow-untyped-defs, allow-untyped-calls
import math

from numba import prange

from softarm.simulator.kernel.arm import assemble, limit_drive, locate_block, solve
from softarm.simulator.kernel.compiled import compiled, entry
from softarm.simulator.kernel.contact import add_shelf
from softarm.simulator.kernel.joints import add_drag, add_joints, add_payload, settle_joints
from softarm.simulator.kernel.layout import (
    AIR,
    CART_GIVEN,
    JOINTS,
    PAYLOAD,
    PRESSURE,
    PRESSURE_GIVEN,
    RAIL,
    SHELF,
    rows,
    scratch,
)
from softarm.simulator.kernel.numerics import clip
from softarm.simulator.kernel.pressure import age, issue
from softarm.simulator.kernel.rail import settle_cart
from softarm.simulator.simd import block, load, store

# Cap on rates, far beyond the robot's (its links turn at up to 30 rad/s). It keeps a light link finite when a
# parameter within its bounds makes the step too coarse.
FASTEST_RAD_S, FASTEST_M_S = 80.0, 20.0


@compiled
def issue_commands(m, lanes, at, active):
    """Put the commands of a block into the histories of what is not given."""
    late = load(m, at.late, lanes)
    if not active & CART_GIVEN:
        issue(m, lanes, load(m, at.cart_command, lanes), at.rail_history, 0.0, late)
    if active & PRESSURE and not active & PRESSURE_GIVEN:
        issue(m, lanes, load(m, at.pressure_command, lanes), at.pressure_history, load(m, at.deadband, lanes), late)


@compiled
def grow_older(m, lanes, at, active, duration):
    """Age the histories of a block's commands by a duration, s."""
    if not active & CART_GIVEN:
        age(m, lanes, at.rail_history, duration)
    if active & PRESSURE and not active & PRESSURE_GIVEN:
        age(m, lanes, at.pressure_history, duration)


@compiled
def advance_block(m, links, lanes, parts, active, substeps, dt):
    """Advance one block by `substeps` substeps of `dt` seconds under its commands."""
    at, h, w = rows(links), 0.5 * dt, scratch(m, links, lanes)
    if len(parts) == 0:
        active = 0  # a constant to the compiler, which removes all effects
    issue_commands(m, lanes, at, active)
    for substep in range(substeps):
        assemble(m, w, links, lanes, active, (substep + 1) * dt, dt)
        if active & JOINTS:
            add_joints(m, w, links, lanes, dt)
        if active & PAYLOAD:
            add_payload(m, w, links, lanes, dt)
        if active & AIR:
            add_drag(m, w, links, lanes, dt)
        if active & SHELF:
            add_shelf(m, w, links, lanes, dt)
        solve(w, links, lanes)
        if active & RAIL and not active & CART_GIVEN:
            limit_drive(m, w, links, lanes)
        if active & JOINTS:
            settle_joints(m, w, links, lanes, dt)
        if active & RAIL:
            settle_cart(m, lanes, at, dt * (load(m, at.v, lanes) + h * load(w, at.rhs, lanes)))
        for i in range(len(links) + 1):
            most = FASTEST_M_S if i == 0 else FASTEST_RAD_S
            v = load(m, at.v + i, lanes)
            a = clip(load(w, at.rhs + i, lanes), -most * (1.0 / dt), most * (1.0 / dt))
            after = clip(v + dt * a, -most, most)
            store(m, at.a + i, lanes, a)
            store(m, at.q + i, lanes, load(m, at.q + i, lanes) + h * (v + after))
            store(m, at.v + i, lanes, after)
    grow_older(m, lanes, at, active, substeps * dt)


@entry
def advance(memory, links, lanes, parts, active, substeps, dt):
    """Advance every block on this thread. `prepare` must have been called for this dt.

    Args:
        memory: [blocks, rows * lanes], changed in place.
        links: tuple with one entry a link; only its length counts.
        lanes: tuple with one entry a lane; only its length counts.
        parts: an empty tuple if `active` is 0, else (0,).
        active: the bits of layout.py.
        substeps: number of substeps.
        dt: length of a substep, s, a scalar of the memory's type.
    """
    for number in range(memory.shape[0]):
        advance_block(block(memory, number, lanes), links, lanes, parts, active, substeps, dt)


@entry(parallel=True)
def advance_parallel(memory, links, lanes, parts, active, substeps, dt):
    """Advance every block on all cores, with the arguments of `advance`."""
    for number in prange(memory.shape[0]):
        advance_block(block(memory, number, lanes), links, lanes, parts, active, substeps, dt)


@entry(nogil=True)
def fly(memory, links, lanes, parts, active, substeps, dt, first, velocity, pressure, path):
    """Advance every block on this thread through a whole plan, without holding Python's lock.

    Blocks are advanced one after the other, so that a block's rows stay in the nearest cache. The first seven
    arguments are those of `advance`.

    Args:
        first: number of the first robot of the memory.
        velocity: commands of the cart [steps, robots], m/s.
        pressure: commands [steps, robots], kPa.
        path: [steps, 4, robots], set to the cart's y and velocity and the tip's y and z at the end of every step.
    """
    at, n, width = rows(links), len(links), len(lanes)
    for number in range(memory.shape[0]):
        m, robot = block(memory, number, lanes), first + number * width
        for step in range(velocity.shape[0]):
            for k in range(min(width, velocity.shape[1] - robot)):
                m[at.cart_command * width + k] = velocity[step, robot + k]
                m[at.pressure_command * width + k] = pressure[step, robot + k]
            advance_block(m, links, lanes, parts, active, substeps, dt)
            locate_block(m, links, lanes)
            for k in range(min(width, velocity.shape[1] - robot)):
                path[step, 0, robot + k] = m[at.q * width + k]
                path[step, 1, robot + k] = m[at.v * width + k]
                path[step, 2, robot + k] = m[(at.end_y + n - 1) * width + k]
                path[step, 3, robot + k] = m[(at.end_z + n - 1) * width + k]


@entry
def prepare(memory, links, lanes, dt):
    """Set the rows of every block that depend only on parameters and the length of the substep."""
    n, width = len(links), len(lanes)
    at = rows(links)
    real = type(dt)
    h = real(0.5) * dt
    times = (at.inflate, at.deflate, at.rail_lag, at.creep_time)
    for number in range(memory.shape[0]):
        m = block(memory, number, lanes)
        for k in range(width):
            for lag in range(4):
                time = m[times[lag] * width + k]
                if lag < 2:
                    reach = real(1.0) / (real(1.0) + m[at.leak * width + k] * time)
                    m[(at.reach_inflate + lag) * width + k] = reach
                    time = time * reach
                lost = -math.expm1(-dt / time) if time > 0 else real(1.0)
                m[(at.keep_inflate + lag) * width + k] = real(1.0) - lost
                m[(at.mean_inflate + lag) * width + k] = lost * time / dt
            for i in range(n):
                implicit = h * (m[(at.damping + i) * width + k] + h * m[(at.stiffness + i) * width + k])
                m[(at.implicit + i) * width + k] = implicit
                m[(at.diagonal + i) * width + k] = m[(at.inertia + i) * width + k] + implicit
                if i > 0:
                    m[(at.diagonal + i - 1) * width + k] += implicit


@entry
def locate(memory, links, lanes):
    """Set position and velocity of every link's far end."""
    for number in range(memory.shape[0]):
        locate_block(block(memory, number, lanes), links, lanes)
