"""Long short-term memory over sequences for a CPU: one matrix product and one fused cell per step.

Equations and parameter layout are those of `torch.nn.LSTM` (gate rows in the order input, forget, cell, output; one
bias), with two differences: episodes may begin inside a sequence (`keep`), and the matrix products may run in bfloat16.
Gradients stop at the sequence's first state (truncated back-propagation).

Every function is single-threaded and releases the interpreter's lock. Callers run micro-batches in parallel and get the
same numbers from any number of threads. A graphics card uses torch's cell.
"""

# mypy: allow-untyped-defs, allow-untyped-calls, allow-subclassing-any, allow-untyped-decorators

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from softarm.training.learn import cell as cells

# Of a graphics card: gates of the input and of the hidden state, and the cell, to both states and a work space.
fused_cell = torch.ops.aten._thnn_fused_lstm_cell


def _bits(tensor: Tensor) -> NDArray[Any]:
    """Return the same memory for numba, which has no bfloat16."""
    array: NDArray[Any] = (tensor.view(torch.uint16) if tensor.dtype is torch.bfloat16 else tensor).numpy()
    return array


class _Sequence(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x: Tensor, keep: Tensor, hidden_0: Tensor, cell_0: Tensor, weight: Tensor, bias: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Run `sequence`; `weight` [4H, I + H] has the type of the products, everything else is float32."""
        steps, batch, inputs = x.shape
        size = cell_0.shape[1]
        fed = torch.empty((steps + 1, batch, inputs + size), dtype=weight.dtype)  # inputs, then hidden state
        fed[:steps, :, :inputs] = x
        fed[0, :, inputs:] = hidden_0 * keep[0].unsqueeze(1)
        product = torch.empty((batch, 4 * size), dtype=weight.dtype)
        gates = torch.empty((steps, batch, 4 * size))
        cell, hidden = torch.empty((steps, batch, size)), torch.empty((steps, batch, size))
        # For the compiled cell: a step is a row of an array.
        c, kept, given, states = cell_0.numpy(), keep.numpy(), _bits(product), _bits(fed)[:, :, inputs:]
        gate_rows, cell_rows, hidden_rows, biases = gates.numpy(), cell.numpy(), hidden.numpy(), bias.numpy()
        for t in range(steps):
            torch.mm(fed[t], weight.t(), out=product)
            later = kept[min(t + 1, steps - 1)]
            cells.forward(given, biases, c, kept[t], later, gate_rows[t], cell_rows[t], hidden_rows[t], states[t + 1])
            c = cell_rows[t]
        ctx.save_for_backward(keep, cell_0, weight, gates, fed, cell)
        ctx.mark_non_differentiable(cell)
        return hidden, cell

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_hidden: Tensor, _d_cell: Tensor) -> tuple[Tensor | None, ...]:
        keep, cell_0, weight, gates, fed, cell = ctx.saved_tensors
        steps, batch, size = cell.shape
        inputs = fed.shape[2] - size
        d_product = torch.empty(gates.shape, dtype=weight.dtype)
        d_fed = torch.zeros((steps + 1, batch, inputs + size), dtype=weight.dtype)
        d_cell, d_bias = np.zeros((batch, size), dtype=np.float32), np.zeros(4 * size, dtype=np.float32)
        gate_rows, cell_rows, kept, above = gates.numpy(), cell.numpy(), keep.numpy(), d_hidden.contiguous().numpy()
        products, later = _bits(d_product), _bits(d_fed)[:, :, inputs:]
        for t in reversed(range(steps)):
            earlier = cell_rows[t - 1] if t > 0 else cell_0.numpy()
            next_kept = kept[min(t + 1, steps - 1)]
            cells.backward(
                gate_rows[t],
                earlier,
                kept[t],
                next_kept,
                cell_rows[t],
                above[t],
                later[t + 1],
                products[t],
                d_cell,
                d_bias,
            )
            torch.mm(d_product[t], weight, out=d_fed[t])
        d_weight = torch.mm(d_product.view(-1, 4 * size).t(), fed[:steps].view(steps * batch, -1))
        return d_fed[:steps, :, :inputs].float(), None, None, None, d_weight, torch.from_numpy(d_bias)


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

    Args:
        x: Inputs, float32 [T, B, I].
        keep: 0 where an episode begins, which zeroes the state before that step, else 1; float32 [T, B].
        state: Hidden and cell state before the first step, float32 [B, H] each, constant.
        w_x: Weights [4H, I] as in `torch.nn.LSTM`; w_h [4H, H] and bias [4H] alike.
        dtype: Type of the matrix products, float32 or bfloat16; float32 on a graphics card.

    Returns:
        Hidden states, float32 [T, B, H], and the last hidden and cell state.
    """
    if x.device.type != "cpu":
        return _step_by_step(x, keep, state, w_x, w_h, bias)
    weight = torch.cat((w_x, w_h), dim=1).to(dtype)
    hidden, cell = _Sequence.apply(x, keep, *state, weight, bias)
    return hidden, (hidden[-1].detach(), cell[-1])


def _step_by_step(
    x: Tensor, keep: Tensor, state: tuple[Tensor, Tensor], w_x: Tensor, w_h: Tensor, bias: Tensor
) -> tuple[Tensor, tuple[Tensor, Tensor]]:
    """Run `sequence` with torch's cell for a graphics card, and its gradients."""
    hidden, cell = state
    # One product for all steps; views by `unbind` have one gradient, not one a step.
    given = torch.nn.functional.linear(x, w_x, bias).unbind(0)
    rows = []
    for gates, kept in zip(given, keep.unsqueeze(2).unbind(0), strict=True):
        hidden, cell, _ = fused_cell(gates, (hidden * kept) @ w_h.t(), cell * kept)
        rows.append(hidden)
    return torch.stack(rows), (hidden.detach(), cell.detach())
