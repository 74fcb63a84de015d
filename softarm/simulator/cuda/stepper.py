"""The simulator's kernel on a graphics card, one thread a robot.

The memory has the layout of the CPU's blocks of 32 lanes: a warp's load of a row is one transaction. A vector of one
lane is a scalar (simd.py), so the source of the kernel is the CPU's.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from softarm.simulator.compiled import compiler
from softarm.simulator.kernel.arm import locate_block
from softarm.simulator.kernel.compiled import SOURCES
from softarm.simulator.kernel.layout import rows
from softarm.simulator.kernel.run import advance_block
from softarm.simulator.simd import Rows, load, store

LANES = 32
# Of a block: 64 to 256 differ by a tenth on an NVIDIA H100.
THREADS = 128
MISSING = "simulating on a graphics card needs numba-cuda; install softarm[cuda], or choose device cpu"

compiled = compiler(*SOURCES, Path(__file__))


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


@compiled
def _restart(m, links, table, start, variant):
    """Set one robot to rest; `m` is its lane, the other arguments are those of `restart_on_cpu`."""
    at, lane = rows(links), (0,)
    if variant >= 0:
        for row in range(at.shelf_y):
            store(m, row, lane, table[row, variant])
        for row in range(at.keep_inflate, at.drive_given):
            store(m, row, lane, table[row, variant])
    for row in range(at.q, at.cart_command):
        store(m, row, lane, 0.0)
    store(m, at.q, lane, start[0])
    for row in (at.pressure, at.pressure_acting):
        store(m, row, lane, start[1])
    for row in range(at.pressure_history, at.pressure_age):
        store(m, row, lane, start[1])
    store(m, at.q + 1, lane, start[2])
    for i in range(1, len(links)):
        store(m, at.q + 1 + i, lane, load(m, at.q + i, lane) + start[2 + i])


@compiled
def restart_on_cpu(memory, links, table, which, start, variant):
    """Set robots to rest, without the positions of their links.

    Args:
        memory: [blocks, rows * LANES].
        links: tuple with one entry a link; only its length counts.
        table: parameters of every variant, [rows, variants].
        which: the robots, bool [R].
        start: cart (m), pressure (kPa) and joint angles (rad), [R, 2 + n].
        variant: number of the robot's new variant, or -1 for none, [R].
    """
    for robot in range(len(which)):
        if which[robot]:
            _restart(lane_of(memory, robot), links, table, start[robot], variant[robot])


def numba_cuda() -> Any:
    """Return numba's CUDA target. Raises ValueError if it is not installed."""
    try:
        import numba_cuda  # noqa: F401  the package numba/cuda of numba itself lacks what the kernel needs
        from numba import cuda
    except ImportError as error:
        raise ValueError(MISSING) from error
    cuda.config.CUDA_LOW_OCCUPANCY_WARNINGS = False  # of few robots
    return cuda


def launch(kernel: Any, robots: int, *arguments: Any) -> None:
    """Start a kernel of numba with one thread a robot, on torch's current stream."""
    import torch

    stream = numba_cuda().external_stream(torch.cuda.current_stream().cuda_stream)
    kernel[-(-robots // THREADS), THREADS, stream](*arguments)


@functools.cache
def kernels(links: int, active: int) -> tuple[Any, Any]:
    """Return `entries`, compiled for a card. Raises ValueError if numba-cuda is not installed."""
    advance, restart = map(numba_cuda().jit, entries(links, active))
    return advance, restart


def entries(links: int, active: int) -> tuple[Callable[..., None], Callable[..., None]]:
    """Return the Python functions of the kernels that advance and restart robots; both locate the links.

    Args:
        links: number of links of an arm.
        active: bits of layout.py.
    """
    from numba import cuda

    tuple_of_links = (0,) * links
    parts = (0,) if active else ()

    def advance(memory, robots, substeps, dt):
        robot = cuda.grid(1)
        if robot < robots:
            m = lane_of(memory, robot)
            advance_block(m, tuple_of_links, (0,), parts, active, substeps, dt)
            locate_block(m, tuple_of_links, (0,))

    def restart(memory, table, which, start, variant):
        robot = cuda.grid(1)
        if robot < which.size and which[robot]:
            m = lane_of(memory, robot)
            _restart(m, tuple_of_links, table, start[robot], variant[robot])
            locate_block(m, tuple_of_links, (0,))

    return advance, restart
