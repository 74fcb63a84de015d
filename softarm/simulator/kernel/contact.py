"""The shelf: two boards that the arm's links press against.

A link is a bar of the arm's radius with rounded ends; the last link's round end lies within its length, as in the
inflated beam. A board is a plate with rounded edges. Each is a line with a thickness, and contact is the distance of
two lines: a link's end from a board, or a board's front edge from a link's side. Links without thickness would pass
through gaps that are narrower than the arm's 76 mm.

The normal force is a spring and a damper in parallel, both evaluated at the substep's end. A convex potential there
can only take energy out of the motion. Contact is predicted from the rates alone, and the force at the start of a
substep never pulls. Friction is a damper along the surface, limited by Coulomb's force at the present speed.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
from softarm.simulator.kernel.compiled import compiled
from softarm.simulator.kernel.layout import rows
from softarm.simulator.kernel.numerics import clip
from softarm.simulator.simd import load, magnitude, root, select, some, store

RADIUS_M = 0.0381  # of the arm [P]
DEPTH_M, THICKNESS_M, APART_M = 0.4, 0.01, 0.2  # of the boards, and between them [C]
REACH_M = RADIUS_M + THICKNESS_M / 2
# Damping is critical for this mass on any stiffness, kg: about the tip's. Cloth on a board does not bounce.
DAMPED_KG = 0.05
# Limit of a contact's implicit inertia, kg: much more next to shells of 5 g exhausts single precision. At a coarse
# step a harder shelf becomes softer (above 6 kN/m at 240 Hz, 50 kN/m at 1200 Hz).
INERTIA_MOST_KG = 0.3
# Sliding faster than this is resisted in full, m/s.
CREEP_M_S = 0.01


@compiled
def add_shelf(m, w, links, lanes, dt):
    """Add the contact forces of both boards on every link to the equations of motion."""
    at, h = rows(links), 0.5 * dt
    front = load(m, at.shelf_y, lanes) - THICKNESS_M / 2
    lower = load(m, at.shelf_z, lanes) - THICKNESS_M / 2
    y = load(m, at.q, lanes) + h * load(m, at.v, lanes)
    z = load(m, at.base_height, lanes)
    for i in range(len(links)):
        sine, cosine = load(w, at.sine + i, lanes), load(w, at.cosine + i, lanes)
        span, length = load(m, at.span + i, lanes), load(m, at.length + i, lanes)
        for board in range(2):
            height = lower + board * (APART_M + THICKNESS_M)
            end_y, end_z = y + span * sine, z - span * cosine
            aside = end_y - clip(end_y, front - (DEPTH_M - THICKNESS_M), front)
            _push(m, w, links, lanes, i, span, aside, end_z - height, dt)
            along = (front - y) * sine - (height - z) * cosine  # from the link's start to the edge's projection
            within = clip(along, 0.0, span)
            away = select(within != along, 1.0, 0.0 * along)  # elsewhere the link's ends touch
            gap_y, gap_z = y + within * sine - front, z - within * cosine - height
            _push(m, w, links, lanes, i, within, gap_y + away, gap_z, dt)
        y, z = y + length * sine, z - length * cosine


@compiled
def _push(m, w, links, lanes, i, reach, gap_y, gap_z, dt):
    """Push link i apart from a board: at `reach` along it, across a gap (m) from the board's line to the link's."""
    at, h = rows(links), 0.5 * dt
    distance = root(gap_y * gap_y + gap_z * gap_z) + 1e-9
    depth = REACH_M - distance
    # No end moves by more than the reach in a substep, so a farther link cannot touch.
    if not some(depth > -REACH_M):
        return
    ny, nz = gap_y / distance, gap_z / distance
    rate, slide = _levers(m, w, links, lanes, i, reach, ny, nz)
    stiffness = load(m, at.shelf_stiffness, lanes)
    damping = root((4.0 * DAMPED_KG) * stiffness)
    inertia = (stiffness * h + damping) * dt
    softer = select(inertia > INERTIA_MOST_KG, INERTIA_MOST_KG / inertia, 1.0)
    foreseen = depth - h * rate
    force = softer * (stiffness * foreseen - damping * rate)
    touching = select(foreseen > 0.0, force, 0.0 * force)
    if not some(touching > 0.0):
        return
    force = select(touching > 0.0, force, 0.0)
    inertia = select(touching > 0.0, softer * inertia, 0.0)
    grip = load(m, at.shelf_friction, lanes) * force
    speed = magnitude(slide)
    grip = grip / select(speed > CREEP_M_S, speed, CREEP_M_S)
    most = INERTIA_MOST_KG * (1.0 / dt)
    grip = select(grip > most, most, grip)
    _apply(w, links, lanes, i, at.lever, force, inertia)
    if some(grip > 0.0):
        _apply(w, links, lanes, i, at.shear, 0.0 - grip * slide, grip * dt)


@compiled
def _levers(m, w, links, lanes, i, reach, ny, nz):
    """Set the contact point's motion per coordinate, along the normal and across it; return both speeds."""
    at = rows(links)
    v = load(m, at.v, lanes)
    store(w, at.lever, lanes, ny)
    store(w, at.shear, lanes, 0.0 - nz)
    rate, slide = ny * v, 0.0 - nz * v
    for j in range(i + 1):
        arm = reach if j == i else load(m, at.length + j, lanes)
        sine, cosine = load(w, at.sine + j, lanes), load(w, at.cosine + j, lanes)
        normal, across = arm * (ny * cosine + nz * sine), arm * (ny * sine - nz * cosine)
        store(w, at.lever + 1 + j, lanes, normal)
        store(w, at.shear + 1 + j, lanes, across)
        v = load(m, at.v + 1 + j, lanes)
        rate, slide = rate + normal * v, slide + across * v
    return rate, slide


@compiled
def _apply(w, links, lanes, i, levers, force, inertia):
    """Add a force and its implicit inertia along the direction whose levers are given."""
    at, order = rows(links), len(links) + 1
    for j in range(i + 2):
        lever = load(w, levers + j, lanes)
        store(w, at.rhs + j, lanes, load(w, at.rhs + j, lanes) + lever * force)
        heavy = lever * inertia
        for k in range(j + 1):
            entry = at.matrix + j * order + k
            store(w, entry, lanes, load(w, entry, lanes) + heavy * load(w, levers + k, lanes))
