"""Braking clamp of a batch in tensors: the daemon's law, compiled for a graphics card or run by numpy on the CPU.

For a card, the law of numpy's operators runs once with symbols instead of arrays. Each new operation adds a line of
Python to a trace, and numba compiles the lines. The braking law thus runs on the card from its one source.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.lib.mixins import NDArrayOperatorsMixin
from torch import Tensor

from softarm.schemas.config import DryveRail, RailLimits
from softarm.simulator.cuda.stepper import launch, numba_cuda
from softarm.training.task.rail_guard import acting_ages_s

_TEXTS: dict[Any, str] = {
    np.add: "{} + {}",
    np.subtract: "{} - {}",
    np.multiply: "{} * {}",
    np.true_divide: "{} / {}",
    np.negative: "-{}",
    np.maximum: "choose({0} > {1}, {0}, {1})",
    np.greater: "{} > {}",
    np.less: "{} < {}",
    np.less_equal: "{} <= {}",
    np.bitwise_and: "{} & {}",
    np.bitwise_or: "{} | {}",
    np.invert: "not {}",
    np.where: "choose({}, {}, {})",
}


@intrinsic
def choose(typingctx, condition, yes, no):
    """Return `yes` where the condition holds, else `no`, without the branch of an `if`."""

    def build(context, builder, sig, args):
        return builder.select(builder.trunc(args[0], ir.IntType(1)), args[1], args[2])

    return yes(types.boolean, yes, yes), build


class Symbol(NDArrayOperatorsMixin):
    """Number of a traced computation, named by a variable of its source."""

    def __init__(self, trace: dict[str, str], name: str) -> None:
        """Name an input of a trace, which maps every expression to its variable."""
        self._trace, self.name = trace, name

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any) -> "Symbol":
        """Trace an operator."""
        return self._traced(ufunc, inputs)

    def __array_function__(self, function: Any, types: Any, inputs: Any, options: Any) -> "Symbol":
        """Trace `numpy.where`."""
        return self._traced(function, inputs)

    def __getitem__(self, index: tuple[()]) -> "Symbol":
        """Return the number itself, as of an array without dimensions."""
        return self

    def _traced(self, function: Any, inputs: tuple[Any, ...]) -> "Symbol":
        names = [
            each.name if isinstance(each, Symbol) else self._variable(f"float32({float(each)!r})") for each in inputs
        ]
        return Symbol(self._trace, self._variable(_TEXTS[function].format(*names)))

    def _variable(self, expression: str) -> str:
        return self._trace.setdefault(expression, f"n{len(self._trace)}")


def source(function: Callable[..., Symbol], inputs: list[str]) -> tuple[list[str], str]:
    """Return the lines of a function's trace and the name of its result; inputs are expressions in Python."""
    trace: dict[str, str] = {}
    names = [trace.setdefault(each, f"n{k}") for k, each in enumerate(inputs)]
    result = function(*(Symbol(trace, name) for name in names))
    return [f"{name} = {expression}" for expression, name in trace.items()], result.name


_KERNEL = """
def bound(wanted, position, velocity, sent, result):
    i = cuda.grid(1)
    if i < result.size:
        {lines}
        result[i] = {result}
"""


class TensorGuard:
    """Clamp of velocity commands by the braking law, with a memory of commands that still act."""

    def __init__(self, robots: int, period_s: float, limits: RailLimits, device: torch.device) -> None:
        """Prepare a clamp with a command every `period_s`; see `RailGuard`."""
        self._law = limits.braking_law(DryveRail().hold_s).in_float32()
        self._velocity_max_m_s = limits.velocity_max_m_s
        self._ages_s = acting_ages_s(limits, period_s)
        self.sent_m_s = torch.zeros((len(self._ages_s), robots), device=device)  # the newest last
        self._kernel = _compiled(self.kernel_source()) if device.type == "cuda" else None

    def reset(self, robots: Tensor) -> None:
        """Set the earlier commands of robots, bool [R], to zero."""
        self.sent_m_s.masked_fill_(robots, 0.0)

    def apply(self, wanted_m_s: Tensor, position_m: Tensor, velocity_m_s: Tensor) -> Tensor:
        """Return commands that keep the carts inside the limits, [R]."""
        wanted = wanted_m_s.clamp(-self._velocity_max_m_s, self._velocity_max_m_s)
        if self._kernel is None:
            arrays = [each.numpy() for each in (wanted, position_m, velocity_m_s, *self.sent_m_s)]
            bounded = torch.from_numpy(self._bound(*arrays))
        else:
            bounded = torch.empty_like(wanted)
            inputs = (wanted, position_m, velocity_m_s)
            launch(self._kernel, len(wanted), *inputs, self.sent_m_s, bounded)
        self.sent_m_s.copy_(torch.cat((self.sent_m_s[1:], bounded.unsqueeze(0))))
        return bounded

    def _bound(self, wanted: Any, position: Any, velocity: Any, *sent: Any) -> Any:
        pairs = list(zip(self._ages_s, sent, strict=True))
        return self._law.bound(wanted, position, velocity, sent=pairs).velocity_m_s

    def kernel_source(self) -> str:
        """Return the source of the clamp's kernel for numba."""
        inputs = ["wanted[i]", "position[i]", "velocity[i]", *(f"sent[{k}, i]" for k in range(len(self._ages_s)))]
        lines, result = source(self._bound, inputs)
        return _KERNEL.format(lines="\n        ".join(lines), result=result)


@functools.cache
def _compiled(text: str) -> Any:
    """Return a kernel of its source; numba needs seconds for it."""
    scope: dict[str, Any] = {"cuda": numba_cuda(), "float32": np.float32, "choose": choose}
    exec(text, scope)
    return numba_cuda().jit(scope["bound"])
