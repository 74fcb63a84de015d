"""The simulator's kernel on a graphics card, one thread a robot.

The memory has the layout of the CPU's blocks of 32 lanes: a warp's load of a row is one transaction. A vector of one
lane is a scalar (simd.py), so the source of the kernel is the CPU's. A thread's scratch is its own local memory, which
the compiler turns into registers.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import functools
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from softarm.simulator.kernel.arm import locate_block
from softarm.simulator.kernel.run import advance_block
from softarm.simulator.simd import Rows

LANES = 32
# Measured on an NVIDIA H100: docs/training/simulator.md.
THREADS = 128
MISSING = "simulating on a graphics card needs numba-cuda; install softarm[cuda], or choose device cpu"


@intrinsic
def lane_of(typingctx, memory, robot):
    """Return the rows of one robot's lane of a memory [blocks, rows * LANES]."""

    def build(context, builder, sig, args):
        array = context.make_array(sig.args[0])(context, builder, args[0])
        robot = context.cast(builder, args[1], sig.args[1], types.int64)
        width = ir.Constant(robot.type, LANES)
        block, place = builder.sdiv(robot, width), builder.srem(robot, width)
        first = builder.add(builder.mul(block, builder.extract_value(array.shape, 1)), place)
        return builder.gep(array.data, [first])

    return Rows(memory.dtype, LANES)(memory, robot), build


def stepper(memory: Any, robots: int, links: int, active: int) -> Callable[[int, float], None]:
    """Return a function that advances robots by a number of substeps and their length in s.

    It joins torch's current stream, and also sets positions and velocities of the links.

    Args:
        memory: tensor [blocks, rows * LANES] on the card.
        robots: their number.
        links: the number of links of an arm.
        active: bits of layout.py.

    Raises:
        ValueError: numba-cuda is not installed.
    """
    import torch

    cuda = numba_cuda()
    # The conversion takes longer than a step.
    kernel, array = _compiled(links, active), cuda.as_cuda_array(memory)
    blocks = -(-robots // THREADS)

    def step(substeps: int, dt: float) -> None:
        stream = cuda.external_stream(torch.cuda.current_stream(memory.device).cuda_stream)
        kernel[blocks, THREADS, stream](array, robots, substeps, dt)

    return step


@functools.cache
def _compiled(links: int, active: int) -> Any:
    return numba_cuda().jit("void(float32[:, ::1], int32, int32, float32)")(entry(links, active))


def numba_cuda() -> Any:
    """Return numba's CUDA target. Raises ValueError if it is not installed."""
    try:
        import numba_cuda  # noqa: F401  the package numba/cuda of numba itself lacks what the kernel needs
        from numba import cuda
    except ImportError as error:
        raise ValueError(MISSING) from error
    return cuda


def entry(links: int, active: int) -> Callable[..., None]:
    """Return the Python function of the kernel, for `numba.cuda.jit`."""
    from numba import cuda

    tuple_of_links = (0,) * links
    parts = (0,) if active else ()

    def advance(memory, robots, substeps, dt):
        robot = cuda.grid(1)
        if robot < robots:
            m = lane_of(memory, robot)
            advance_block(m, tuple_of_links, (0,), parts, active, substeps, dt)
            locate_block(m, tuple_of_links, (0,))

    return advance
