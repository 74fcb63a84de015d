"""Assembly and solution of the arm's equations of motion.

n rigid links hanging from a cart, in absolute link angles phi (0 hangs straight down), coordinates
q = (cart y, phi_1 .. phi_n), with S_i = m_i l_i / 2 + l_i sum_{k>i} m_k:

    M_00 = m_cart + sum m_i,  M_0i = S_i cos phi_i,  M_ij = l_j S_i cos(phi_i - phi_j) (i > j),
    M_ii = I_i + m_i l_i^2 / 4 + l_i^2 sum_{k>i} m_k

and joint torques -K theta - D theta' - (b p + offset) on theta_i = phi_i - phi_{i-1} (paper, eq. 1).

Every M_ij is (S_i cos phi_i)(l_j cos phi_j) + (S_i sin phi_i)(l_j sin phi_j), so the centrifugal
forces are two running sums, from the cart to the tip and back.

Scheme: midpoint rule, second order. With h = dt / 2, geometry is taken at q + h v, the centrifugal terms at
v + h a_previous; springs, dampers and the cart's drive are linear and solved implicitly at the midpoint, so
the step is chosen for accuracy, not for stability: (M + h D + h^2 K) a = forces at (q + h v, v).
"""

# mypy: allow-untyped-defs, allow-untyped-calls
from softarm.simulator.kernel.compiled import compiled
from softarm.simulator.kernel.layout import CART_GIVEN, rows
from softarm.simulator.kernel.numerics import sine_cosine
from softarm.simulator.kernel.pressure import pull, regulate
from softarm.simulator.kernel.rail import drive, gives_way, lacking
from softarm.simulator.simd import fill, load, some, store

# Mass of a cart whose motion is given, kg: no arm can move it.
IMMOVABLE_KG = 1e12


@compiled
def assemble(m, w, links, lanes, active, end, dt):
    """Advance the actuators and fill matrix and right-hand side of the equations of motion."""
    n, h = len(links), 0.5 * dt
    at, order = rows(links), n + 1
    before = load(m, at.pressure, lanes)
    pressure = regulate(m, lanes, at, active, end, dt)
    pressure = pull(m, lanes, at, active, before, pressure)
    if active & CART_GIVEN:
        acceleration = load(m, at.cart_acceleration, lanes) + (end - h) * load(m, at.cart_jerk, lanes)
        force, mass = IMMOVABLE_KG * acceleration, fill(acceleration, IMMOVABLE_KG)
    else:
        force, mass = drive(m, lanes, at, active, end, dt)
    total, along = load(m, at.mass, lanes), load(m, at.gravity_along, lanes)
    store(w, at.matrix, lanes, total + mass)
    # Apparent gravity at the current joint: down, and along the rail.
    down, aside = load(m, at.gravity, lanes), 0.0 - along
    angle_before = rate_before = fill(pressure, 0.0)
    for i in range(n):
        rate = load(m, at.v + 1 + i, lanes)
        angle = load(m, at.q + 1 + i, lanes) + h * rate
        sine, cosine = sine_cosine(angle)
        middle = rate + h * load(m, at.a + 1 + i, lanes)
        square = middle * middle
        torque = (
            load(m, at.stiffness + i, lanes) * (angle_before - angle)
            + load(m, at.damping + i, lanes) * (rate_before - rate)
            - load(m, at.muscle + i, lanes) * pressure
            - load(m, at.offset + i, lanes)
        )
        angle_before, rate_before = angle, rate
        if i > 0:  # the joint pushes back on the link before; before the first is the rail
            store(w, at.rhs + i, lanes, load(w, at.rhs + i, lanes) - torque)
        length, moment = load(m, at.length + i, lanes), load(m, at.moment + i, lanes)
        moment_y, moment_z = moment * cosine, moment * sine
        reach_y, reach_z = length * cosine, length * sine
        store(w, at.rhs + i + 1, lanes, torque - moment_z * down + moment_y * aside)
        row = at.matrix + (i + 1) * order
        store(w, row, lanes, moment_y)
        for j in range(i):
            entry = moment_y * load(w, at.reach_y + j, lanes) + moment_z * load(w, at.reach_z + j, lanes)
            if j == i - 1:
                entry = entry - load(m, at.implicit + i, lanes)
            store(w, row + j + 1, lanes, entry)
        store(w, row + i + 1, lanes, load(m, at.diagonal + i, lanes))
        down, aside = down + reach_y * square, aside + reach_z * square
        store(w, at.sine + i, lanes, sine)
        store(w, at.cosine + i, lanes, cosine)
        store(w, at.rate + i, lanes, middle)
        store(w, at.square + i, lanes, square)
        store(w, at.reach_y + i, lanes, reach_y)
        store(w, at.reach_z + i, lanes, reach_z)
        store(w, at.moment_z + i, lanes, moment_z)
    store(w, at.tip_down, lanes, down)
    store(w, at.tip_aside, lanes, aside)
    # Centrifugal forces of the links beyond each one.
    pull_y = pull_z = fill(pressure, 0.0)
    for i in range(n - 1, -1, -1):
        reach_y, reach_z = load(w, at.reach_y + i, lanes), load(w, at.reach_z + i, lanes)
        square = load(w, at.square + i, lanes)
        store(w, at.rhs + i + 1, lanes, load(w, at.rhs + i + 1, lanes) + reach_y * pull_z - reach_z * pull_y)
        pull_y = pull_y + load(w, at.matrix + (i + 1) * order, lanes) * square
        pull_z = pull_z + load(w, at.moment_z + i, lanes) * square
    store(w, at.rhs, lanes, force + pull_z - total * along)


@compiled
def _substitute_back(w, at, order, lanes, row):
    """Turn the solution of L x = b at `row` into that of L D L^T x = b, in place."""
    for i in range(order - 1, -1, -1):
        right = load(w, row + i, lanes) * load(w, at.pivot + i, lanes)
        for j in range(i + 1, order):
            right = right - load(w, at.matrix + j * order + i, lanes) * load(w, row + j, lanes)
        store(w, row + i, lanes, right)


@compiled
def solve(w, links, lanes):
    """Solve matrix a = rhs by L D L^T in place and leave the solution in `rhs`."""
    order, at = len(links) + 1, rows(links)
    matrix = at.matrix
    for i in range(order):
        # Row i of L, each entry still times its pivot until the row's end.
        for j in range(i):
            entry = load(w, matrix + i * order + j, lanes)
            for c in range(j):
                entry = entry - load(w, matrix + i * order + c, lanes) * load(w, matrix + j * order + c, lanes)
            store(w, matrix + i * order + j, lanes, entry)
        pivot = load(w, matrix + i * (order + 1), lanes)
        right = load(w, at.rhs + i, lanes)
        for j in range(i):
            scaled = load(w, matrix + i * order + j, lanes)
            entry = scaled * load(w, at.pivot + j, lanes)
            pivot = pivot - scaled * entry
            right = right - entry * load(w, at.rhs + j, lanes)
            store(w, matrix + i * order + j, lanes, entry)
        store(w, at.pivot + i, lanes, 1.0 / pivot)
        store(w, at.rhs + i, lanes, right)
    _substitute_back(w, at, order, lanes, at.rhs)


@compiled
def limit_drive(m, w, links, lanes):
    """Correct the solution in `rhs` for the drive's force limit.

    The correction is one more force on the cart's row, solved with the factors that `solve` left. It is exact, since
    the equations are linear in the force.
    """
    order, at = len(links) + 1, rows(links)
    matrix = at.matrix
    lack = lacking(m, lanes, at, load(w, at.rhs, lanes))
    if some(lack != 0.0):
        for i in range(order):
            right = fill(lack, 1.0 if i == 0 else 0.0)
            for j in range(i):
                right = right - load(w, matrix + i * order + j, lanes) * load(w, at.give + j, lanes)
            store(w, at.give + i, lanes, right)
        _substitute_back(w, at, order, lanes, at.give)
        change = gives_way(m, lanes, at, lack, load(w, at.give, lanes))
        for i in range(order):
            store(w, at.rhs + i, lanes, load(w, at.rhs + i, lanes) + change * load(w, at.give + i, lanes))


@compiled
def locate_block(m, links, lanes):
    """Set position and velocity of every link's far end."""
    at = rows(links)
    y, z = load(m, at.q, lanes), load(m, at.base_height, lanes)
    vy, vz = load(m, at.v, lanes), fill(y, 0.0)
    for i in range(len(links)):
        sine, cosine = sine_cosine(load(m, at.q + 1 + i, lanes))
        length, rate = load(m, at.length + i, lanes), load(m, at.v + 1 + i, lanes)
        y, vy = y + length * sine, vy + length * cosine * rate
        z, vz = z - length * cosine, vz + length * sine * rate
        store(m, at.end_y + i, lanes, y)
        store(m, at.end_z + i, lanes, z)
        store(m, at.end_vy + i, lanes, vy)
        store(m, at.end_vz + i, lanes, vz)
