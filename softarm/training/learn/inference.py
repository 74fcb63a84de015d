"""Inference for many robots, on threads or a graphics card; the number of threads changes no bit."""

# mypy: allow-untyped-decorators

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from softarm.training.learn.network import PolicyNetwork, RecurrentState

CHUNK = 512  # robots a thread takes at once

# Policy for one episode: observations [R, N] and the robots that still fly, [R], to actions [R, 2] in -1..1. Actions of
# other robots do not count.
Act = Callable[[NDArray[np.float32], NDArray[np.bool_]], NDArray[np.float32]]


@contextmanager
def workers(count: int | None = None) -> Iterator[Executor]:
    """Provide `count` threads (default: one per core); torch runs single-threaded in each of them and outside."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    threads = count or len(os.sched_getaffinity(0))
    try:
        with ThreadPoolExecutor(threads, "training", initializer=torch.set_num_threads, initargs=(1,)) as pool:
            yield pool
    finally:
        torch.set_num_threads(before)


def device_named(name: str) -> torch.device:
    """Return the device of a training, cpu or cuda. Raises ValueError if it is not available here."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError(f"run.device is 'cuda', and torch {torch.__version__} sees no such card here; give cpu")
    # TF32: ten bits of a factor, and sums in float32.
    torch.backends.cuda.matmul.allow_tf32 = name == "cuda"
    return torch.device(name)


def actor(network: PolicyNetwork, robots: int, pool: Executor, dtype: torch.dtype = torch.float32) -> Act:
    """Return the mean actions of a network for one episode; robots that no longer fly are not computed."""
    device = network.device
    (hidden, cell), keep = network.initial_state(robots), torch.ones(robots, device=device)

    def act(observation: NDArray[np.float32], flying: NDArray[np.bool_]) -> NDArray[np.float32]:
        rows, action = torch.from_numpy(flying).to(device), np.zeros((robots, network.shape.actions), np.float32)
        state, seen = (hidden[rows], cell[rows]), torch.from_numpy(observation[flying]).to(device)
        mean, _, (hidden[rows], cell[rows]) = infer(network, seen, keep[rows], state, pool, dtype)
        action[flying] = mean.clamp(-1.0, 1.0).cpu().numpy()
        return action

    return act


def infer(
    network: PolicyNetwork,
    observation: Tensor,
    keep: Tensor,
    state: RecurrentState,
    pool: Executor,
    dtype: torch.dtype = torch.float32,
) -> tuple[Tensor, Tensor, RecurrentState]:
    """Run one step for every robot.

    Takes observations [R, inputs], `keep` [R] (0 where an episode begins) and states [R, size] on the network's device.
    Returns the action's mean [R, actions], the value in the reward's unit [R] and the next state.
    """
    count, size, device = observation.shape[0], state[0].shape[1], state[0].device

    # Gradients are disabled per thread, so the caller cannot do it for the pool.
    @torch.no_grad()
    def part(robots: slice) -> tuple[Tensor, Tensor, RecurrentState]:
        mean, value, after = network(
            observation[None, robots], keep[None, robots], (state[0][robots], state[1][robots]), dtype
        )
        return mean[0], network.value_normaliser.restore(value[0].unsqueeze(-1)).squeeze(-1), after

    if device.type != "cpu":
        whole: tuple[Tensor, Tensor, RecurrentState] = part(slice(None))
        return whole
    means, values = torch.empty(count, network.shape.actions), torch.empty(count)
    hidden, cell = torch.empty(count, size), torch.empty(count, size)

    def write(robots: slice) -> None:
        means[robots], values[robots], (hidden[robots], cell[robots]) = part(robots)

    # The list waits for all chunks and passes on an error of one.
    list(pool.map(write, [slice(k, min(k + CHUNK, count)) for k in range(0, count, CHUNK)]))
    return means, values, (hidden, cell)
