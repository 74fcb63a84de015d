"""The compiled batch kernel, which advances blocks of memory. It imports only numpy, numba and simd.py.

Each SIMD lane (simulator/simd.py) carries one robot, so the code reads as if for one robot. A block holds one group
of lanes as a flat array of rows (layout.py): parameters, state, command history and scratch, one value a lane. Each
stage has its file: pressure.py, rail.py, arm.py with joints.py and contact.py. run.py combines them, stages.py runs
one alone, numerics.py holds shared functions.

The numbers of links and lanes are the lengths of two tuples. They are constants to the compiler, so one source
serves any number of links, a large batch and a single robot. The effects of a batch are a set of bits, read once a
substep: a scalar branch costs little next to a thousand vector operations. An effect at its neutral value is an
exact identity, so a robot's numbers are the same bit for bit whatever effects the others have. The kernel runs in
float32; float64 compiles from the same source. Fast-math is off, so NaN propagates.

A change in any of these files recompiles all of them (compiled.py): numba alone would check only run.py.
"""

from softarm.simulator.kernel.layout import rows
from softarm.simulator.kernel.run import advance, advance_parallel, fly, locate, prepare
from softarm.simulator.kernel.stages import fly_arm, fly_cart, fly_pressure

__all__ = [
    "advance",
    "advance_parallel",
    "fly",
    "fly_arm",
    "fly_cart",
    "fly_pressure",
    "locate",
    "prepare",
    "rows",
]
