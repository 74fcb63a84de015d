"""The batch kernel: numbers in a block of memory in, numbers out. Imports numpy and numba and nothing else.

Robots stand side by side along the SIMD lanes (simulator/simd.py), so the code reads as if for one. A block
holds one group of lanes as a flat array of rows (layout.py): parameters, state, command history and scratch,
one value a lane. One file a stage: pressure.py, rail.py, arm.py with joints.py and contact.py; run.py puts them
together, numerics.py has what they share.

The numbers of links and lanes are the lengths of two tuples: constants to the compiler, so one source serves
any n, and both a large batch and a single robot. What a batch needs of the effects is a set of bits that each
block looks at once a substep: a scalar branch beside a thousand vector operations. An effect at its neutral
value is an exact identity, so that a robot's numbers are the same bit for bit whatever its neighbours have.
float32 in use; float64 compiles from the same source. No fast-math: a NaN stays visible.

A change of any of these files compiles all of them anew (compiled.py): numba alone would look at run.py only.
"""

from softarm.simulator.kernel.layout import HISTORY, Rows, rows
from softarm.simulator.kernel.run import advance, advance_cart, advance_parallel, advance_pressure, fly, locate, prepare

__all__ = [
    "HISTORY",
    "Rows",
    "advance",
    "advance_cart",
    "advance_parallel",
    "advance_pressure",
    "fly",
    "locate",
    "prepare",
    "rows",
]
