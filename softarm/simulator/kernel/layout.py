"""The layout of a block of memory: its rows, and the bits of the kernel's optional parts."""

# numba types these functions, from what they are called with.
# mypy: allow-untyped-defs, allow-untyped-calls
from collections import namedtuple
from typing import Any

from numba.core import cgutils
from numba.extending import intrinsic, overload

from softarm.simulator.simd import Rows as Pointer

# The largest number of pending commands of one kind, plus the one in force.
HISTORY = 16
# Ages are capped at this many seconds.
OLD = 1.0

# Parts of the kernel that a batch may need, one bit each.
PRESSURE = 1  # any effect on the pressure but its lag
RAIL = 2  # servo, lag, gain, friction, backlash or force limit of the rail
JOINTS = 4  # stiffening, dry friction or creep
MUSCLE = 8  # hysteresis or saturation
AIR = 16  # drag
PAYLOAD = 32
SHELF = 64
# Quantities that are given from outside instead of simulated.
CART_GIVEN = 128
PRESSURE_GIVEN = 256

# The rows of each quantity: a number, or for n links "n", "q" (n + 1) or a square of either.
_PARAMETERS: dict[str, int | str] = {
    "mass": 1,  # cart and links, kg
    "cart_mass": 1,  # kg
    "drive_force": 1,  # the acceleration tracker's constant part, N
    "drive_inertia": 1,  # its feedback on the cart's acceleration, kg
    "velocity_gain": 1,  # N s/m
    "switch": 1,  # velocity error above which the acceleration tracker acts, m/s
    "servo": 1,  # 1: the servo's law, which needs the next two; 0: the tracker's, above
    "ramp": 1,  # slope of its reference, m/s^2
    "feedforward": 1,  # force for its reference's acceleration, kg
    "travel": 1,  # m
    "stop_stiffness": 1,  # N/m
    "stop_damping": 1,  # N s/m
    "base_height": 1,  # m
    "length": "n",  # m
    "moment": "n",  # S_i, kg m
    "stiffness": "n",  # N m/rad
    "damping": "n",  # N m s/rad
    "muscle": "n",  # N m/kPa
    "offset": "n",  # N m
    "inertia": "n",  # M_ii, kg m^2
    "gravity": 1,  # across the rail, m/s^2
    "gravity_along": 1,  # along the rail, which tilts
    # Effects.
    "dead_time": 1,  # s
    "deadband": 1,  # kPa
    "pressure_gain": 1,
    "pressure_offset": 1,  # kPa
    "ceiling": 1,  # kPa
    "inflate": 1,  # time constants, s
    "deflate": 1,
    "pressure_rate": 1,  # kPa/s
    "leak": 1,  # 1/s
    "rail_delay": 1,  # s
    "rail_gain": 1,
    "rail_lag": 1,  # s
    "cart_friction": 1,  # N
    "cart_viscous": 1,  # N s/m
    "backlash": 1,  # m
    "force_limit": 1,  # N
    "muscle_loop": 1,  # half height of the hysteresis loop, kPa
    "muscle_width": 1,  # 1 / its width, 1/kPa
    "saturation": 1,  # 1 / the pressure at which the torque levels off, 1/kPa
    "cubic": 1,  # 1/rad^2
    "joint_friction": 1,  # N m
    "creep": 1,
    "creep_time": 1,  # s
    "payload": 1,  # kg
    "drag": 1,  # N s^2/m^2
    "drag_most": "n",  # half of each link's mass, kg
    "span": "n",  # a link's straight part between its rounded ends, m
    "shelf_friction": 1,
    "shelf_stiffness": 1,  # N/m
}
_SHELF: dict[str, int | str] = {
    "shelf_y": 1,
    "shelf_z": 1,
}  # front edge, the lower board's top, m; `reset` keeps them
_STATE: dict[str, int | str] = {
    "q": "q",  # cart y (m), absolute link angles (rad)
    "v": "q",  # their rates
    "a": "q",  # their mean accelerations over the last substep
    "pressure": 1,  # kPa
    "rail_history": HISTORY,  # rail commands, newest first, m/s
    "rail_age": HISTORY,  # seconds since each was issued
    "rail_acting": 1,  # the command in force at the end of the last substep
    "pressure_history": HISTORY,  # kPa, as for the rail
    "pressure_age": HISTORY,
    "pressure_acting": 1,
    "drive_before": 1,  # the drive's force over the last substep, N
    "drive_mass_before": 1,  # and its implicit mass, kg
    "lagged": 1,  # the tracker's command behind rail.lag, m/s
    "ramped": 1,  # the servo's command behind its ramp, m/s
    "reference": 1,  # the ramped command behind rail.lag, m/s
    "play": 1,  # position of the cart within the drive's backlash, m
    "cart_bristle": 1,  # deflection of dry friction, m
    "loop": 1,  # hysteresis, -1 .. 1
    "bristle": "n",  # rad
    "crept": "n",  # rad
}
_INPUT: dict[str, int | str] = {
    "cart_command": 1,  # m/s
    "pressure_command": 1,  # kPa
    "late": 1,  # s between the start of the step and the command's issue
    "cart_push": 1,  # force of the arm on the cart, where it is given, N
    "cart_acceleration": 1,  # where the cart's motion is given: at the step's start, m/s^2
    "cart_jerk": 1,  # m/s^3
    "pressure_slope": 1,  # where the pressure is given, kPa/s
}
_DERIVED: dict[str, int | str] = {
    # Set by `prepare` for one length of substep: share of a distance that is left at its end, and on average.
    "keep_inflate": 1,
    "keep_deflate": 1,
    "keep_rail": 1,
    "keep_creep": 1,
    "mean_inflate": 1,
    "mean_deflate": 1,
    "mean_rail": 1,
    "mean_creep": 1,
    "reach_inflate": 1,  # share of the target that a leak leaves while the regulator fills, and while it vents
    "reach_deflate": 1,
    "implicit": "n",  # h D + h^2 K of each joint
    "diagonal": "n",  # M_ii and what the joints add to it
    # Of this substep, set by `drive`.
    "drive_given": 1,  # the drive's force without its implicit part, N
    "drive_given_mass": 1,  # the implicit part per acceleration of the cart, kg
    "drive_most": 1,  # limit of the force, N
    # Positions and velocities, set by `locate`.
    "end_y": "n",  # m
    "end_z": "n",
    "end_vy": "n",  # m/s
    "end_vz": "n",
}
_BLOCK = _PARAMETERS | _SHELF | _STATE | _INPUT | _DERIVED
# A thread's own memory, with rows counted from 0: small enough to stay in the core's nearest cache.
_SCRATCH: dict[str, int | str] = {
    "sine": "n",
    "cosine": "n",
    "rate": "n",  # of a link at the midpoint, rad/s
    "square": "n",  # its square
    "reach_y": "n",  # l_i cos phi_i: way of a link's end per angle, m
    "reach_z": "n",  # l_i sin phi_i
    "moment_z": "n",  # S_i sin phi_i, kg m; S_i cos phi_i is in the matrix
    "tip_down": 1,  # apparent gravity at the tip without tangential acceleration, m/s^2
    "tip_aside": 1,
    "drag_y": "n",  # N
    "drag_z": "n",
    "lever": "q",  # of a contact's normal
    "shear": "q",  # of its tangent
    "rhs": "q",  # forces, then the accelerations that they cause
    "pivot": "q",  # 1 / d of L D L^T
    "give": "q",  # accelerations per newton on the cart
    "matrix": "q*q",  # lower triangle
}

Rows = namedtuple("Rows", [*_BLOCK, "end", *_SCRATCH, "scratch_end"])  # type: ignore[misc]


def rows(links: tuple[int, ...]) -> Any:
    """Return the first row of each quantity; `links` is a tuple with one entry a link."""
    n = len(links)
    size = {"n": n, "q": n + 1, "q*q": (n + 1) ** 2}
    starts = []
    for part in (_BLOCK, _SCRATCH):
        row = 0
        for count in part.values():
            starts.append(row)
            row += size[count] if isinstance(count, str) else count
        starts.append(row)
    return Rows(*starts)


@overload(rows)
def _rows(links):
    at = rows((0,) * len(links))  # frozen: constants to the compiler
    return lambda links: at


@intrinsic
def scratch(typingctx, m, links, lanes):
    """Return a pointer to a thread's own rows for one step, on its stack."""
    size = rows((0,) * len(links)).scratch_end * len(lanes)

    def build(context, builder, sig, args):
        memory = cgutils.alloca_once(builder, context.get_value_type(m.dtype), size=size)
        memory.align = 64
        return memory

    return Pointer(m.dtype, len(lanes))(m, links, lanes), build
