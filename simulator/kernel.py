"""The batch kernel: numbers in a block of memory in, numbers out. Imports numpy and numba and nothing else.

Robots stand side by side along the SIMD lanes (simulator/simd.py), so the code reads as if for one. A block
holds one group of lanes as a flat array of rows (`rows`): parameters, state, command history and scratch, one
value a lane.

Equations: n rigid links hanging from a cart, in absolute link angles phi (0 hangs straight down), coordinates
q = (cart y, phi_1 .. phi_n), with S_i = m_i l_i / 2 + l_i sum_{k>i} m_k:

    M_00 = m_cart + sum m_i,  M_0i = S_i cos phi_i,  M_ij = C_ij cos(phi_i - phi_j),
    C_ij = l_j S_i (i > j),   C_ii = I_i + m_i l_i^2 / 4 + l_i^2 sum_{k>i} m_k

and joint torques -K theta - D theta' - (b p + offset) on theta_i = phi_i - phi_{i-1} (paper, eq. 1).

Scheme: midpoint rule, second order. With h = dt / 2, geometry is taken at q + h v, the centrifugal terms at
v + h a_previous; springs, dampers and the cart's drive are linear and solved implicitly at the midpoint, so
the step is chosen for accuracy, not for stability: (M + h D + h^2 K) a = forces at (q + h v, v).

The numbers of links and lanes are the lengths of two tuples: constants to the compiler, so one source serves
any n, and both a large batch and a single robot. float32 in use; float64 compiles from the same source. No
fast-math: a robot's numbers are the same bit for bit in any batch and lane, and a NaN stays visible.
"""

# numba types these functions, from what they are called with.
# mypy: allow-untyped-defs, allow-untyped-calls
import math
from collections import namedtuple

from numba import njit, prange

from simulator.simd import fill, floor, load, select, store

# The largest number of rail commands that may be on their way at once.
HISTORY = 8
# The age, in seconds, after which a command only counts as old.
OLD = 1.0


# What a row of the block holds; where a size is given, so many rows.
Rows = namedtuple(
    "Rows",
    [
        # Parameters, packed once (simulator/pack.py).
        "mass",  # cart and links, kg
        "drive_force",  # the acceleration tracker's constant part, N
        "drive_inertia",  # its feedback on the cart's acceleration, kg
        "velocity_gain",  # N s/m
        "switch",  # velocity error above which the acceleration tracker acts, m/s
        "travel",  # m
        "stop_stiffness",  # N/m
        "stop_damping",  # N s/m
        "rail_delay",  # s
        "inflate",  # time constants, s
        "deflate",
        "base_height",  # m
        "length",  # [n] m
        "moment",  # [n] S_i, kg m
        "weight",  # [n] g S_i, N m
        "stiffness",  # [n] N m/rad
        "damping",  # [n] N m s/rad
        "muscle",  # [n] N m/kPa
        "offset",  # [n] N m
        "coupling",  # [n, n] C_ij, kg m^2; i >= j is used
        # State.
        "q",  # [n + 1] cart y (m), absolute link angles (rad); also where the parameters end
        "v",  # [n + 1] their rates
        "a",  # [n + 1] their mean accelerations over the last substep
        "pressure",  # kPa
        "history",  # [HISTORY] rail commands, newest first, m/s
        "age",  # [HISTORY] seconds since each was issued
        # The commands of this step.
        "cart_command",  # m/s
        "pressure_command",  # kPa
        # Set by `prepare` for one length of substep.
        "keep_inflate",  # share of the distance to the command that is left after a substep
        "keep_deflate",
        "mean_inflate",  # share that is left on average over a substep
        "mean_deflate",
        "implicit",  # [n] h D + h^2 K of each joint
        "diagonal",  # [n] C_ii and what the joints add to it
        # Where things are, set by `locate`.
        "end_y",  # [n] m
        "end_z",  # [n] m
        "end_vy",  # [n] m/s
        "end_vz",  # [n] m/s
        # Scratch.
        "sine",  # [n]
        "cosine",  # [n]
        "square",  # [n] squared link rates
        "rhs",  # [n + 1] forces, then the accelerations that they cause
        "pivot",  # [n + 1] 1 / d of L D L^T
        "matrix",  # [n + 1, n + 1], lower triangle
        "end",
    ],
)


@njit(cache=True)
def rows(n):
    """Return the row at which each thing begins in the block of an arm of `n` links."""
    link = 12  # one row each before
    q = link + 7 * n + n * n
    pressure = q + 3 * (n + 1)
    step = pressure + 1 + 2 * HISTORY
    end = step + 6 + 2 * n
    scratch = end + 4 * n
    matrix = scratch + 3 * n + 2 * (n + 1)
    parameters = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11)
    per_link = (
        link,
        link + n,
        link + 2 * n,
        link + 3 * n,
        link + 4 * n,
        link + 5 * n,
        link + 6 * n,
        link + 7 * n,
    )
    state = (q, q + n + 1, q + 2 * (n + 1), pressure, pressure + 1, pressure + 1 + HISTORY)
    command = (step, step + 1, step + 2, step + 3, step + 4, step + 5, step + 6, step + 6 + n)
    ends = (end, end + n, end + 2 * n, end + 3 * n)
    solver = (scratch, scratch + n, scratch + 2 * n, scratch + 3 * n, scratch + 4 * n + 1, matrix)
    return Rows(*parameters, *per_link, *state, *command, *ends, *solver, matrix + (n + 1) * (n + 1))


@njit(cache=True)
def _sine_cosine(x):
    """Return sin x and cos x, to float32's rounding for |x| up to ten thousand turns.

    Half of the angle is brought to -pi/2 .. pi/2, where two polynomials (minimax, own fit) hold to 5e-9; the
    double-angle rule then needs no case for the quadrant.
    """
    turns = floor(x * 0.15915494309189535 + 0.5)
    # 2 pi in two parts, the first of so few bits that its multiples are exact.
    half = 0.5 * ((x - turns * 6.28125) - turns * 0.0019353071795864769)
    z = half * half
    sine = 2.6089183613938353e-06 * z - 1.9811106825219228e-04
    sine = sine * z + 8.333088094716652e-03
    sine = sine * z - 1.6666660459915678e-01
    sine = half + half * z * sine
    cosine = -2.6076961033025607e-07 * z + 2.4761878439515466e-05
    cosine = cosine * z - 1.3888403364380765e-03
    cosine = cosine * z + 4.166664071778332e-02
    cosine = cosine * z - 4.9999999549333823e-01
    cosine = 1.0 + z * cosine
    return 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine


@njit(cache=True)
def _clip(x, low, high):
    x = select(x < low, low, x)
    return select(x > high, high, x)


@njit(cache=True)
def _issue(m, lanes, at):
    """Put each lane's rail command at the head of its history, unless it repeats the newest."""
    command = load(m, at.cart_command, lanes)
    fresh = command != load(m, at.history, lanes)
    for first in (at.history, at.age):
        for i in range(first + HISTORY - 1, first, -1):
            store(m, i, lanes, select(fresh, load(m, i - 1, lanes), load(m, i, lanes)))
    store(m, at.history, lanes, command)
    store(m, at.age, lanes, select(fresh, 0.0, load(m, at.age, lanes)))


@njit(cache=True)
def _press(m, lanes, at):
    """Advance the pressure by a substep, an exact first-order lag; returns its mean over the substep, kPa."""
    command = load(m, at.pressure_command, lanes)
    gap = load(m, at.pressure, lanes) - command
    inflating = gap < 0.0
    keep = select(inflating, load(m, at.keep_inflate, lanes), load(m, at.keep_deflate, lanes))
    mean = select(inflating, load(m, at.mean_inflate, lanes), load(m, at.mean_deflate, lanes))
    store(m, at.pressure, lanes, command + keep * gap)
    return command + mean * gap


@njit(cache=True)
def _drive(m, lanes, at, since, dt):
    """Return what the cart's drive and the end stops put into its row: force (N) and implicit mass (kg).

    since: seconds from the start of the step to the middle of the substep.
    """
    h = 0.5 * dt
    # The newest command that is old enough at the middle of the substep.
    due = load(m, at.rail_delay, lanes) - since
    command = load(m, at.history + HISTORY - 1, lanes)
    for i in range(HISTORY - 2, -1, -1):
        command = select(load(m, at.age + i, lanes) >= due, load(m, at.history + i, lanes), command)

    # Above the switch the drive tracks a fixed acceleration, below it the velocity. `share` is the part of
    # the substep before the crossing, foreseen from the last acceleration: else every crossing is late.
    v = load(m, at.v, lanes)
    error = command - v
    sign = select(error > 0.0, fill(error, 1.0), -1.0)
    closing = load(m, at.a, lanes) * sign * dt
    closing = select(closing > 1e-6, closing, 1e-6)
    share = _clip((error * sign - load(m, at.switch, lanes)) / closing, 0.0, 1.0)
    gain = (1.0 - share) * load(m, at.velocity_gain, lanes)
    force = share * sign * load(m, at.drive_force, lanes) + gain * error
    mass = load(m, at.mass, lanes) + share * load(m, at.drive_inertia, lanes) + h * gain

    # The end stops are stiff: taken at the end of the substep, where the midpoint would let the cart bounce.
    foreseen = load(m, at.q, lanes) + dt * v
    travel = load(m, at.travel, lanes)
    beyond = foreseen - _clip(foreseen, 0.0 - travel, travel)
    stiffness = select(beyond != 0.0, load(m, at.stop_stiffness, lanes), 0.0)
    damping = select(beyond != 0.0, load(m, at.stop_damping, lanes), 0.0)
    return force - stiffness * beyond - damping * v, mass + dt * (damping + h * stiffness)


@njit(cache=True)
def _assemble(m, links, lanes, since, dt):
    """Advance the actuators and fill matrix and right-hand side of the equations of motion."""
    n, h = len(links), 0.5 * dt
    at, order = rows(n), n + 1
    pressure = _press(m, lanes, at)
    force, mass = _drive(m, lanes, at, since, dt)
    store(m, at.matrix, lanes, mass)
    angle_before = rate_before = fill(pressure, 0.0)
    for i in range(n):
        rate = load(m, at.v + 1 + i, lanes)
        angle = load(m, at.q + 1 + i, lanes) + h * rate
        sine, cosine = _sine_cosine(angle)
        rate_middle = rate + h * load(m, at.a + 1 + i, lanes)
        square = rate_middle * rate_middle
        moment = load(m, at.moment + i, lanes)
        torque = (
            load(m, at.stiffness + i, lanes) * (angle_before - angle)
            + load(m, at.damping + i, lanes) * (rate_before - rate)
            - load(m, at.muscle + i, lanes) * pressure
            - load(m, at.offset + i, lanes)
        )
        angle_before, rate_before = angle, rate
        force = force + moment * sine * square
        store(m, at.sine + i, lanes, sine)
        store(m, at.cosine + i, lanes, cosine)
        store(m, at.square + i, lanes, square)
        store(m, at.matrix + (i + 1) * order, lanes, moment * cosine)
        if i > 0:  # the joint pushes back on the link before; before the first is the rail
            store(m, at.rhs + i, lanes, load(m, at.rhs + i, lanes) - torque)
        own = torque - load(m, at.weight + i, lanes) * sine
        for j in range(i):
            sine_j, cosine_j = load(m, at.sine + j, lanes), load(m, at.cosine + j, lanes)
            coupling = load(m, at.coupling + i * n + j, lanes)
            entry = coupling * (cosine * cosine_j + sine * sine_j)
            if j == i - 1:
                entry = entry - load(m, at.implicit + i, lanes)
            store(m, at.matrix + (i + 1) * order + j + 1, lanes, entry)
            across = coupling * (sine * cosine_j - cosine * sine_j)
            own = own - across * load(m, at.square + j, lanes)
            store(m, at.rhs + j + 1, lanes, load(m, at.rhs + j + 1, lanes) + across * square)
        store(m, at.rhs + i + 1, lanes, own)
        store(m, at.matrix + (i + 1) * (order + 1), lanes, load(m, at.diagonal + i, lanes))
    store(m, at.rhs, lanes, force)


@njit(cache=True)
def _solve(m, links, lanes):
    """Solve matrix a = rhs by L D L^T in place; leaves the solution in `rhs`."""
    order, at = len(links) + 1, rows(len(links))
    matrix = at.matrix
    for i in range(order):
        # Row i of L, each entry still times its pivot until the row's end.
        for j in range(i):
            entry = load(m, matrix + i * order + j, lanes)
            for c in range(j):
                entry = entry - load(m, matrix + i * order + c, lanes) * load(m, matrix + j * order + c, lanes)
            store(m, matrix + i * order + j, lanes, entry)
        pivot = load(m, matrix + i * (order + 1), lanes)
        right = load(m, at.rhs + i, lanes)
        for j in range(i):
            scaled = load(m, matrix + i * order + j, lanes)
            entry = scaled * load(m, at.pivot + j, lanes)
            pivot = pivot - scaled * entry
            right = right - entry * load(m, at.rhs + j, lanes)
            store(m, matrix + i * order + j, lanes, entry)
        store(m, at.pivot + i, lanes, 1.0 / pivot)
        store(m, at.rhs + i, lanes, right)
    for i in range(order - 1, -1, -1):
        right = load(m, at.rhs + i, lanes) * load(m, at.pivot + i, lanes)
        for j in range(i + 1, order):
            right = right - load(m, matrix + j * order + i, lanes) * load(m, at.rhs + j, lanes)
        store(m, at.rhs + i, lanes, right)


@njit(cache=True)
def _advance_block(m, links, lanes, substeps, dt):
    """Advance one block by `substeps` substeps of `dt` seconds under its commands."""
    at, h = rows(len(links)), 0.5 * dt
    _issue(m, lanes, at)
    for substep in range(substeps):
        _assemble(m, links, lanes, substep * dt + h, dt)
        _solve(m, links, lanes)
        for i in range(len(links) + 1):
            a = load(m, at.rhs + i, lanes)
            v = load(m, at.v + i, lanes)
            store(m, at.a + i, lanes, a)
            store(m, at.q + i, lanes, load(m, at.q + i, lanes) + dt * (v + h * a))
            store(m, at.v + i, lanes, v + dt * a)
    for i in range(HISTORY):
        # An old command is old; its age need not grow until it loses its digits.
        age = load(m, at.age + i, lanes) + substeps * dt
        store(m, at.age + i, lanes, select(age > OLD, OLD, age))


@njit(cache=True)
def prepare(memory, links, lanes, dt):
    """Set, in every block, what depends on the length of the substep alone."""
    n, width = len(links), len(lanes)
    at = rows(n)
    real = type(dt)
    one, h = real(1.0), real(0.5) * dt
    for block in range(memory.shape[0]):
        m = memory[block]
        for k in range(width):
            for lag in range(2):
                time = m[(at.inflate + lag) * width + k]
                keep = math.exp(-dt / time) if time > 0 else real(0.0)
                m[(at.keep_inflate + lag) * width + k] = keep
                m[(at.mean_inflate + lag) * width + k] = (one - keep) * time / dt
            for i in range(n):
                implicit = h * (m[(at.damping + i) * width + k] + h * m[(at.stiffness + i) * width + k])
                m[(at.implicit + i) * width + k] = implicit
                m[(at.diagonal + i) * width + k] = m[(at.coupling + i * n + i) * width + k] + implicit
                if i > 0:
                    m[(at.diagonal + i - 1) * width + k] += implicit


@njit(cache=True)
def advance(memory, links, lanes, substeps, dt):
    """Advance every block on this thread.

    memory: [blocks, rows * lanes], changed in place; links, lanes: tuples whose lengths count; dt: seconds, a
    scalar of the memory's type. `prepare` must have been called for this dt.
    """
    for block in range(memory.shape[0]):
        _advance_block(memory[block], links, lanes, substeps, dt)


@njit(cache=True, parallel=True)
def advance_parallel(memory, links, lanes, substeps, dt):
    """Advance every block on all cores; as `advance`."""
    for block in prange(memory.shape[0]):
        _advance_block(memory[block], links, lanes, substeps, dt)


@njit(cache=True)
def locate(memory, links, lanes):
    """Set position and velocity of every link's far end."""
    at = rows(len(links))
    for block in range(memory.shape[0]):
        m = memory[block]
        y, z = load(m, at.q, lanes), load(m, at.base_height, lanes)
        vy, vz = load(m, at.v, lanes), fill(y, 0.0)
        for i in range(len(links)):
            sine, cosine = _sine_cosine(load(m, at.q + 1 + i, lanes))
            length, rate = load(m, at.length + i, lanes), load(m, at.v + 1 + i, lanes)
            y, vy = y + length * sine, vy + length * cosine * rate
            z, vz = z - length * cosine, vz + length * sine * rate
            store(m, at.end_y + i, lanes, y)
            store(m, at.end_z + i, lanes, z)
            store(m, at.end_vy + i, lanes, vy)
            store(m, at.end_vz + i, lanes, vz)
