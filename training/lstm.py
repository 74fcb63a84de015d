"""A long short-term memory over sequences, quick on a CPU: few large matrix products and one fused cell.

Same equations and parameter layout as `torch.nn.LSTM` (gate rows in the order input, forget, cell, output; one
bias), with two differences that training wants: episodes may begin inside a sequence (`keep`), and the matrix
products may run in bfloat16. Gradients stop at the sequence's first state (truncated back-propagation).

Threads: every function here is single-threaded and lets go of the interpreter's lock, so callers run micro-batches
side by side and get the same numbers from any number of threads.
"""

# mypy: allow-untyped-defs, allow-untyped-calls, allow-subclassing-any, allow-untyped-decorators

from typing import Any

import numpy as np
import torch
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from torch import Tensor
from torch.autograd.function import once_differentiable

# No `nnan`: a NaN has to stay visible. `reassoc` is left out so that results do not depend on the vector width.
FAST = {"contract", "nsz", "arcp"}


@intrinsic
def _float_from_bits(typing_context, bits):
    """Read an int32 as the float32 with the same bits."""

    def generate(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], ir.FloatType())

    return types.float32(types.int32), generate


@njit(inline="always", fastmath=FAST)
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
    return p * _float_from_bits((np.int32(n) + np.int32(127)) << np.int32(23))


@njit(inline="always", fastmath=FAST)
def _sigmoid(x):
    return np.float32(1.0) / (np.float32(1.0) + _exp(-min(max(x, np.float32(-40.0)), np.float32(40.0))))


@njit(inline="always", fastmath=FAST)
def _tanh(x):
    return np.float32(2.0) * _sigmoid(np.float32(2.0) * x) - np.float32(1.0)


# In both cells every inner loop writes one array only: the compiler can then prove that no write meets a read and
# turns each loop into SIMD.


@njit(nogil=True, cache=True, fastmath=FAST)
def cell_forward(gates, cell_before, keep, cell, hidden):
    """One step: pre-activations `gates` [B, 4H] become activations in place; `cell`, `hidden` [B, H] are written."""
    batch, size = cell.shape
    for b in range(batch):
        gate, before, new, out = gates[b], cell_before[b], cell[b], hidden[b]
        i, f, g, o = gate[:size], gate[size : 2 * size], gate[2 * size : 3 * size], gate[3 * size :]
        kept = keep[b]
        for j in range(2 * size):
            gate[j] = _sigmoid(gate[j])
        for j in range(size):
            g[j] = _tanh(g[j])
        for j in range(size):
            o[j] = _sigmoid(o[j])
        for j in range(size):
            new[j] = f[j] * (kept * before[j]) + i[j] * g[j]
        for j in range(size):
            out[j] = o[j] * _tanh(new[j])


@njit(nogil=True, cache=True, fastmath=FAST)
def cell_backward(gates, cell_before, keep, cell, d_hidden, d_cell):
    """One step back: activations `gates` [B, 4H] become gradients of the pre-activations in place.

    `d_cell` [B, H] holds the gradient of `cell` from later steps and becomes that of `cell_before`.
    """
    batch, size = cell.shape
    one = np.float32(1.0)
    tanh_cell = np.empty(size, dtype=np.float32)
    d_g = np.empty(size, dtype=np.float32)
    d_before = np.empty(size, dtype=np.float32)
    for b in range(batch):
        gate, before, new, dh, dc = gates[b], cell_before[b], cell[b], d_hidden[b], d_cell[b]
        i, f, g, o = gate[:size], gate[size : 2 * size], gate[2 * size : 3 * size], gate[3 * size :]
        kept = keep[b]
        for j in range(size):
            tanh_cell[j] = _tanh(new[j])
        for j in range(size):
            dc[j] = dc[j] + dh[j] * o[j] * (one - tanh_cell[j] * tanh_cell[j])
        for j in range(size):
            o[j] = dh[j] * tanh_cell[j] * o[j] * (one - o[j])
        for j in range(size):
            d_g[j] = dc[j] * i[j] * (one - g[j] * g[j])
        for j in range(size):
            i[j] = dc[j] * g[j] * i[j] * (one - i[j])
        for j in range(size):
            d_before[j] = dc[j] * f[j] * kept
        for j in range(size):
            f[j] = dc[j] * (kept * before[j]) * f[j] * (one - f[j])
        for j in range(size):
            g[j] = d_g[j]
        for j in range(size):
            dc[j] = d_before[j]


class _Sequence(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x: Tensor, keep: Tensor, hidden_0: Tensor, cell_0: Tensor, w_x: Tensor, w_h: Tensor, bias: Tensor
    ) -> tuple[Tensor, Tensor]:
        """`x`, `w_x` and `w_h` come in the products' type, everything else in float32; see `sequence`."""
        steps, batch, inputs = x.shape
        size = cell_0.shape[1]
        gates = torch.add(torch.mm(x.reshape(-1, inputs), w_x.t()), bias).view(steps, batch, 4 * size)
        before = torch.empty((steps, batch, size), dtype=x.dtype)  # hidden state fed to each step, after `keep`
        cell, hidden = torch.empty((steps, batch, size)), torch.empty((steps, batch, size))
        h, c = hidden_0, cell_0
        for t in range(steps):
            before[t].copy_(h * keep[t].unsqueeze(1))
            gates[t] += torch.mm(before[t], w_h.t())
            cell_forward(gates[t].numpy(), c.numpy(), keep[t].numpy(), cell[t].numpy(), hidden[t].numpy())
            h, c = hidden[t], cell[t]
        ctx.save_for_backward(x, keep, cell_0, w_x, w_h, gates, before, cell)
        ctx.mark_non_differentiable(cell)
        ctx.spent = False
        return hidden, cell

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_hidden: Tensor, _d_cell: Tensor) -> tuple[Tensor | None, ...]:
        if ctx.spent:  # the activations were overwritten: no copy of the largest array, but one use only
            raise RuntimeError("training.lstm: backward ran already; call sequence() again for another gradient")
        ctx.spent = True
        x, keep, cell_0, w_x, w_h, gates, before, cell = ctx.saved_tensors
        steps, batch, size = cell.shape
        low = torch.empty(gates.shape, dtype=x.dtype)  # gradients of the pre-activations in the products' type
        d_cell = torch.zeros((batch, size))
        d_h = d_hidden[-1]
        for t in reversed(range(steps)):
            earlier = cell[t - 1] if t > 0 else cell_0
            cell_backward(
                gates[t].numpy(),
                earlier.numpy(),
                keep[t].numpy(),
                cell[t].numpy(),
                d_h.contiguous().numpy(),
                d_cell.numpy(),
            )
            low[t].copy_(gates[t])
            if t > 0:
                d_h = torch.addcmul(d_hidden[t - 1], torch.mm(low[t], w_h).float(), keep[t].unsqueeze(1))
        flat = low.view(steps * batch, 4 * size)
        d_x = torch.mm(flat, w_x).view(x.shape)
        d_w_x = torch.mm(flat.t(), x.reshape(steps * batch, -1))
        d_w_h = torch.mm(flat.t(), before.view(steps * batch, size))
        return d_x, None, None, None, d_w_x, d_w_h, gates.sum((0, 1))


def sequence(
    x: Tensor,
    keep: Tensor,
    state: tuple[Tensor, Tensor],
    w_x: Tensor,
    w_h: Tensor,
    bias: Tensor,
    dtype: torch.dtype = torch.float32,
) -> tuple[Tensor, tuple[Tensor, Tensor]]:
    """Run the cell over a batch of sequences.

    x: float32 [T, B, I]; keep: float32 [T, B], 0 where an episode begins (the state is zeroed before that step),
    else 1; state: hidden and cell before the first step, float32 [B, H] each, taken as constants;
    w_x [4H, I], w_h [4H, H], bias [4H] as in `torch.nn.LSTM`; dtype: of the matrix products' inputs, float32 or
    bfloat16.
    Returns hidden states, float32 [T, B, H], and the last hidden and cell state. The gradient can be taken once.
    """
    hidden, cell = _Sequence.apply(x.to(dtype), keep, *state, w_x.to(dtype), w_h.to(dtype), bias)
    return hidden, (hidden[-1].detach(), cell[-1])
