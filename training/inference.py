"""A network over many robots on a few threads, with the same numbers from any number of threads."""

# mypy: allow-untyped-decorators

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch
from torch import Tensor

from training.network import PolicyNetwork, State

CHUNK = 512  # robots a thread takes at once
T = TypeVar("T")
R = TypeVar("R")


class Workers:
    """Threads that each run torch single-threaded; results come in the order of the work."""

    def __init__(self, count: int) -> None:
        self._pool = ThreadPoolExecutor(count, "training", initializer=torch.set_num_threads, initargs=(1,))

    def map(self, function: Callable[[T], R], work: Sequence[T]) -> list[R]:
        """Apply the function to each piece of work."""
        return list(self._pool.map(function, work))

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()


@contextmanager
def workers(count: int | None = None) -> Iterator[Workers]:
    """Give `count` threads (default: one a core) for a while; torch outside them runs single-threaded meanwhile."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    pool = Workers(count or len(os.sched_getaffinity(0)))
    try:
        yield pool
    finally:
        pool.close()
        torch.set_num_threads(before)


def quick_dtype() -> torch.dtype:
    """bfloat16 where the processor multiplies it in hardware, else float32."""
    return torch.bfloat16 if torch.cpu._is_avx512_bf16_supported() else torch.float32


def infer(
    network: PolicyNetwork,
    observation: Tensor,
    keep: Tensor,
    state: State,
    pool: Workers,
    dtype: torch.dtype = torch.float32,
) -> tuple[Tensor, Tensor, State]:
    """One step for every robot.

    observation: [R, inputs], keep: [R] (0 where an episode begins), state: [R, size] each.
    Returns the action's mean [R, actions], the value in the reward's unit [R] and the next state.
    """

    count, size = observation.shape[0], state[0].shape[1]
    means, values = torch.empty(count, network.shape.actions), torch.empty(count)
    hidden, cell = torch.empty(count, size), torch.empty(count, size)

    @torch.no_grad()  # a thread's own matter: of no effect on the pool where the caller sets it
    def part(robots: slice) -> None:
        mean, value, (hidden[robots], cell[robots]) = network(
            observation[None, robots], keep[None, robots], (state[0][robots], state[1][robots]), dtype
        )
        means[robots] = mean[0]
        values[robots] = network.value_normaliser.restore(value[0].unsqueeze(-1)).squeeze(-1)

    pool.map(part, [slice(k, min(k + CHUNK, count)) for k in range(0, count, CHUNK)])
    return means, values, (hidden, cell)
