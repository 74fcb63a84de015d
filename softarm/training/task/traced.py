"""Traces of array arithmetic, which become straight-line code for a graphics card.

A function of numpy's operators runs once with symbols instead of arrays. Each new operation adds a line of Python
to the trace, and numba compiles the lines. The braking law thus runs on the card from its one source.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.lib.mixins import NDArrayOperatorsMixin

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
