"""Entry points of the kernel for a whole recording of one stage alone.

A recording is run block after block, so that a block's rows stay in the nearest cache, and without Python's lock.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import numpy as np

from softarm.simulator.kernel.arm import locate_block
from softarm.simulator.kernel.compiled import compiled, entry
from softarm.simulator.kernel.layout import CART_GIVEN, PRESSURE_GIVEN, RAIL, rows
from softarm.simulator.kernel.pressure import regulate
from softarm.simulator.kernel.rail import drive, gives_way, lacking, settle_cart
from softarm.simulator.kernel.run import advance_block, grow_older, issue_commands
from softarm.simulator.simd import block, load, store


@compiled
def _advance_pressure(m, lanes, at, active, substeps, dt):
    active = active | CART_GIVEN
    issue_commands(m, lanes, at, active)
    for substep in range(substeps):
        regulate(m, lanes, at, active, (substep + 1) * dt, dt)
    grow_older(m, lanes, at, active, substeps * dt)


@compiled
def _advance_cart(m, lanes, at, active, substeps, dt):
    h, active = 0.5 * dt, active | PRESSURE_GIVEN
    issue_commands(m, lanes, at, active)
    for substep in range(substeps):
        force, mass = drive(m, lanes, at, active, (substep + 1) * dt, dt)
        inertia = load(m, at.cart_mass, lanes) + mass
        a = (force + load(m, at.cart_push, lanes)) / inertia
        if active & RAIL:
            response = 1.0 / inertia
            a = a + response * gives_way(m, lanes, at, lacking(m, lanes, at, a), response)
        v = load(m, at.v, lanes)
        way = dt * (v + h * a)
        if active & RAIL:
            settle_cart(m, lanes, at, way)
        store(m, at.a, lanes, a)
        store(m, at.q, lanes, load(m, at.q, lanes) + way)
        store(m, at.v, lanes, v + dt * a)
    grow_older(m, lanes, at, active, substeps * dt)


@entry(nogil=True)
def fly_pressure(memory, links, lanes, parts, active, substeps, dt, first, command, late, path):
    """Run a recording of the pressure alone; the first seven arguments are those of `advance`.

    Args:
        first: number of the first robot of the memory.
        command: commands [steps, robots], kPa.
        late: delay of each command [steps, robots], s.
        path: [steps, robots], set to the pressure at the start of every step, kPa.
    """
    at, width = rows(links), len(lanes)
    for number in range(memory.shape[0]):
        m, robot = block(memory, number, lanes), first + number * width
        for step in range(command.shape[0]):
            for k in range(min(width, command.shape[1] - robot)):
                path[step, robot + k] = m[at.pressure * width + k]
                m[at.pressure_command * width + k] = command[step, robot + k]
                m[at.late * width + k] = late[step, robot + k]
            _advance_pressure(m, lanes, at, active, substeps, dt)


@entry(nogil=True)
def fly_cart(memory, links, lanes, parts, active, substeps, dt, first, command, push, late, path):
    """Run a recording of the cart alone; the first seven arguments are those of `advance`.

    Args:
        first: number of the first robot of the memory.
        command: commands [steps, robots], m/s.
        push: force of the arm [steps, robots], N.
        late: delay of each command [steps, robots], s.
        path: [steps, robots], set to the velocity at the start of every step, m/s.
    """
    at, width = rows(links), len(lanes)
    for number in range(memory.shape[0]):
        m, robot = block(memory, number, lanes), first + number * width
        for step in range(command.shape[0]):
            for k in range(min(width, command.shape[1] - robot)):
                path[step, robot + k] = m[at.v * width + k]
                m[at.cart_command * width + k] = command[step, robot + k]
                m[at.cart_push * width + k] = push[step, robot + k]
                m[at.late * width + k] = late[step, robot + k]
            _advance_cart(m, lanes, at, active, substeps, dt)


@entry(nogil=True)
def fly_arm(memory, links, lanes, parts, active, substeps, dt, first, position, velocity, pressure, duration, path):
    """Run a recording of the arm alone; the first seven arguments are those of `advance`.

    Within a step the cart follows the cubic through both ends and the pressure a straight line.

    Args:
        first: number of the first robot of the memory.
        position: of the cart at the start of every step [steps, robots], m.
        velocity: of the cart likewise, m/s.
        pressure: likewise, kPa.
        duration: length of a step, s.
        path: [steps, 2 links, robots], set to y, then z of every link's end at the start of every step, m.
    """
    at, n, width = rows(links), len(links), len(lanes)
    steps, robots = position.shape
    for number in range(memory.shape[0]):
        m, robot = block(memory, number, lanes), first + number * width
        for step in range(steps):
            for k in range(min(width, robots - robot)):
                m[at.q * width + k] = position[step, robot + k]
                m[at.v * width + k] = velocity[step, robot + k]
                m[at.pressure * width + k] = pressure[step, robot + k]
            locate_block(m, links, lanes)
            for k in range(min(width, robots - robot)):
                for i in range(n):
                    path[step, i, robot + k] = m[(at.end_y + i) * width + k]
                    path[step, n + i, robot + k] = m[(at.end_z + i) * width + k]
            if step + 1 == steps:
                break
            for k in range(min(width, robots - robot)):
                # In double precision: the position's difference is small.
                before, after = np.float64(velocity[step, robot + k]), np.float64(velocity[step + 1, robot + k])
                way = np.float64(position[step + 1, robot + k]) - np.float64(position[step, robot + k])
                rise = np.float64(pressure[step + 1, robot + k]) - np.float64(pressure[step, robot + k])
                m[at.cart_acceleration * width + k] = (6 * way / duration - 4 * before - 2 * after) / duration
                m[at.cart_jerk * width + k] = (6 * (before + after) - 12 * way / duration) / (duration * duration)
                m[at.pressure_slope * width + k] = rise / duration
                m[at.cart_push * width + k] = 0.0
            advance_block(m, links, lanes, parts, active, substeps, dt)
