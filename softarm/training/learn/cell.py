"""Arithmetic of the recurrent cell, forwards and backwards, in one fused pass over a step's rows.

Matrix products are float32, or bits of bfloat16 (uint16), for which numba has no type; everything else is float32. No
function holds the interpreter's lock or starts a thread.
"""

# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from pathlib import Path

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from softarm.simulator.compiled import compiler

compiled = compiler(Path(__file__))

# No `nnan`: NaN must stay visible. `reassoc` is left out so that results do not depend on the vector width.
# numpy's error model, as the usual test for a division by zero keeps a loop from becoming SIMD.
SIMD = {"fastmath": {"contract", "nsz", "arcp"}, "error_model": "numpy"}
_INT = ir.IntType(32)
_FLOAT = ir.FloatType()


@intrinsic
def _two_to(typing_context, n):
    """Return 2^n as float32 for a whole number -126..127, in LLVM because numba would widen to 64 bits."""

    def generate(context, builder, signature, arguments):
        exponent = builder.add(builder.fptosi(arguments[0], _INT), _INT(127))
        return builder.bitcast(builder.shl(exponent, _INT(23)), _FLOAT)

    return types.float32(types.float32), generate


@intrinsic
def _wide(typing_context, value):
    """Convert a product's number to float32."""

    def generate(context, builder, signature, arguments):
        if signature.args[0] == types.float32:
            return arguments[0]
        return builder.bitcast(builder.shl(builder.zext(arguments[0], _INT), _INT(16)), _FLOAT)

    return types.float32(value), generate


@intrinsic
def _as(typing_context, like, value):
    """Convert float32 to the type of `like`; bfloat16 is rounded to nearest, ties to even."""

    def generate(context, builder, signature, arguments):
        if signature.args[0] == types.float32:
            return arguments[1]
        bits = builder.bitcast(arguments[1], _INT)
        even = builder.and_(builder.lshr(bits, _INT(16)), _INT(1))
        rounded = builder.add(bits, builder.add(even, _INT(0x7FFF)))
        return builder.trunc(builder.lshr(rounded, _INT(16)), ir.IntType(16))

    return like(like, types.float32), generate


@njit(inline="always", **SIMD)
def _exp(x):
    """exp(x) for |x| < 80 to about 1e-7 relative: 2^n times a Taylor polynomial on |r| <= ln(2) / 2."""
    n = np.floor(x * np.float32(1.4426950408889634) + np.float32(0.5))
    r = x - n * np.float32(0.693145751953125) - n * np.float32(1.4286068203094172e-06)  # ln(2) in two parts
    p = np.float32(1 / 5040)
    p = p * r + np.float32(1 / 720)
    p = p * r + np.float32(1 / 120)
    p = p * r + np.float32(1 / 24)
    p = p * r + np.float32(1 / 6)
    p = p * r + np.float32(0.5)
    p = p * r + np.float32(1.0)
    p = p * r + np.float32(1.0)
    return p * _two_to(n)


@njit(inline="always", **SIMD)
def _sigmoid(x):
    return np.float32(1.0) / (np.float32(1.0) + _exp(-min(max(x, np.float32(-40.0)), np.float32(40.0))))


@njit(inline="always", **SIMD)
def _tanh(x):
    return np.float32(2.0) * _sigmoid(np.float32(2.0) * x) - np.float32(1.0)


# In both cells every inner loop writes one array only: the compiler can then prove that no write meets a read and
# turns each loop into SIMD.


@compiled(nogil=True, **SIMD)
def forward(product, bias, cell_before, keep, keep_next, gates, cell, hidden, fed):
    """One step of B rows, state of size H.

    product [B, 4H], bias [4H]: their sum are the pre-activations. Written: activations `gates` [B, 4H], `cell` and
    `hidden` [B, H], and `fed` [B, H], what of `hidden` the next step's product is fed.
    """
    batch, size = cell.shape
    for b in range(batch):
        given, gate, before, new, out, next_fed = product[b], gates[b], cell_before[b], cell[b], hidden[b], fed[b]
        i, f, g, o = gate[:size], gate[size : 2 * size], gate[2 * size : 3 * size], gate[3 * size :]
        kept, kept_next = keep[b], keep_next[b]
        for j in range(2 * size):
            gate[j] = _sigmoid(_wide(given[j]) + bias[j])
        for j in range(size):
            g[j] = _tanh(_wide(given[2 * size + j]) + bias[2 * size + j])
        for j in range(size):
            o[j] = _sigmoid(_wide(given[3 * size + j]) + bias[3 * size + j])
        for j in range(size):
            new[j] = f[j] * (kept * before[j]) + i[j] * g[j]
        for j in range(size):
            out[j] = o[j] * _tanh(new[j])
        for j in range(size):
            next_fed[j] = _as(next_fed[j], kept_next * out[j])


@compiled(nogil=True, **SIMD)
def backward(gates, cell_before, keep, keep_next, cell, d_hidden, d_fed, d_product, d_cell, d_bias):
    """Compute the gradients of one step of B rows, state of size H.

    d_hidden [B, H] came from above, d_fed [B, H] from the next step's product. Written: `d_product` [B, 4H]; `d_cell`
    [B, H] holds the gradient of `cell` from later steps and becomes that of `cell_before`; `d_bias` [4H] is added to.
    """
    batch, size = cell.shape
    one = np.float32(1.0)
    tanh_cell = np.empty(size, dtype=np.float32)
    dh = np.empty(size, dtype=np.float32)
    for b in range(batch):
        gate, before, new, dc, low = gates[b], cell_before[b], cell[b], d_cell[b], d_product[b]
        above, later = d_hidden[b], d_fed[b]
        i, f, g, o = gate[:size], gate[size : 2 * size], gate[2 * size : 3 * size], gate[3 * size :]
        kept, kept_next = keep[b], keep_next[b]
        for j in range(size):
            dh[j] = above[j] + kept_next * _wide(later[j])
        for j in range(size):
            tanh_cell[j] = _tanh(new[j])
        for j in range(size):
            dc[j] = dc[j] + dh[j] * o[j] * (one - tanh_cell[j] * tanh_cell[j])
        for j in range(size):
            low[j] = _as(low[j], dc[j] * g[j] * i[j] * (one - i[j]))
        for j in range(size):
            low[size + j] = _as(low[size + j], dc[j] * (kept * before[j]) * f[j] * (one - f[j]))
        for j in range(size):
            low[2 * size + j] = _as(low[2 * size + j], dc[j] * i[j] * (one - g[j] * g[j]))
        for j in range(size):
            low[3 * size + j] = _as(low[3 * size + j], dh[j] * tanh_cell[j] * o[j] * (one - o[j]))
        for j in range(4 * size):
            d_bias[j] += _wide(low[j])
        for j in range(size):
            dc[j] = dc[j] * f[j] * kept
