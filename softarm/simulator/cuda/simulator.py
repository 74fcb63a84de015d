"""Batch simulator whose robots lie in a torch tensor, on a graphics card or, for tests, in the CPU's memory."""

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_PERIOD_S, TRAINING_PHYSICS_RATE_HZ
from softarm.simulator import kernel
from softarm.simulator.cuda.stepper import LANES, kernels, launch, numba_cuda, restart_on_cpu
from softarm.simulator.simulator import Simulator


class TensorSimulator:
    """Batch of robots on a device, with steps of one length; the model, effects and numbers are those of `Simulator`.

    The robots are drawn from variants, each a set of parameters that the CPU packed. Every argument and result is a
    tensor on the device, and no method waits for the device.
    """

    def __init__(
        self,
        model: Model | None = None,
        robots: int = LANES,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
        *,
        overrides: Mapping[str, ArrayLike] | None = None,
        step_s: float = CONTROL_PERIOD_S,
        device: torch.device | str = "cuda",
    ) -> None:
        """Place robots at rest; robot i has the parameters of variant i modulo their number.

        Args:
            model: of all robots; default: the seed's.
            robots: number of robots R.
            physics_rate_hz: lowest rate of the substeps, at least 120 Hz.
            overrides: values of effects, 'stage.effect.parameter' -> scalar or [variants].
            step_s: length of every step, s.
            device: cuda, or cpu.

        Raises:
            ValueError: for an invalid argument, or if numba-cuda is not installed.
        """
        overrides = overrides or {}
        self.variants = max((np.size(values) for values in overrides.values()), default=1)
        packed = Simulator(model, self.variants, physics_rate_hz, overrides=overrides)
        self.effects, self.base_height_m = packed.effects, packed.models[0].arm.base_height_m
        table, self.active, self._substeps, self._substep_s = packed.prepare(step_s)
        self.robots, self.links, self.device = robots, packed.links, torch.device(device)
        self._at, self._lengths = kernel.rows((0,) * self.links), ((0,) * self.links, (0,) * LANES)
        self._table = torch.from_numpy(table.transpose(1, 0, 2).reshape(self._at.end, -1)[:, : self.variants].copy())
        self._table = self._table.to(self.device)
        blocks = -(-robots // LANES)
        spread = torch.arange(blocks * LANES, device=self.device) % self.variants
        self._rows = self._table[:, spread].view(-1, blocks, LANES).transpose(0, 1).contiguous()
        self._memory = self._rows.view(blocks, -1)
        self._kernels = kernels(self.links, self.active) if self.device.type == "cuda" else None
        # The conversion takes longer than a step.
        self._array = numba_cuda().as_cuda_array(self._memory) if self._kernels else None
        self.reset(torch.ones(robots, dtype=torch.bool, device=self.device))

    def reset(
        self,
        robots: Tensor,
        cart_position_m: Tensor | None = None,
        joint_angles_rad: Tensor | None = None,
        pressure_kpa: Tensor | None = None,
        variant: Tensor | None = None,
    ) -> None:
        """Set robots to rest and replace pending commands by zero velocity and the given pressure.

        Args:
            robots: which of them, bool [R]; the other arguments have entries for all.
            cart_position_m: [R]; None: 0.
            joint_angles_rad: link against link, [R, n]; None: 0.
            pressure_kpa: [R]; None: 0.
            variant: numbers of the variants that the robots become, int64 [R]; None: as before.
        """
        size = (self.robots,)
        zero = torch.zeros(size, device=self.device)
        first = [(zero if each is None else each).unsqueeze(1) for each in (cart_position_m, pressure_kpa)]
        angles = zero.unsqueeze(1).expand(-1, self.links) if joint_angles_rad is None else joint_angles_rad
        start = torch.cat((*first, angles), dim=1)
        if variant is None:
            variant = torch.full(size, -1, device=self.device)
        if self._kernels is not None:
            launch(self._kernels[1], self.robots, self._memory, self._table, robots, start, variant)
            return
        rest = [each.numpy() for each in (self._table, robots, start, variant)]
        restart_on_cpu(self._memory.numpy(), self._lengths[0], *rest)
        kernel.locate(self._memory.numpy(), *self._lengths)

    def step(self, cart_velocity_m_s: Tensor, pressure_kpa: Tensor) -> None:
        """Issue a command now and hold it for a step; tensors [R]."""
        self._rows[:, self._at.cart_command] = self._full(cart_velocity_m_s)
        self._rows[:, self._at.pressure_command] = self._full(pressure_kpa)
        self.advance()

    def advance(self) -> None:
        """Advance every robot by a step under its last command."""
        if self._kernels is not None:
            dt = np.float32(self._substep_s)
            launch(self._kernels[0], self.robots, self._array, self.robots, self._substeps, dt)
            return
        memory, (links, lanes) = self._memory.numpy(), self._lengths
        parts = (0,) if self.active else ()
        dt = np.float32(self._substep_s)
        kernel.advance(memory, links, lanes, parts, self.active, self._substeps, dt)
        kernel.locate(memory, links, lanes)

    @property
    def cart_position_m(self) -> Tensor:
        """Return the carts' positions, [R]."""
        return self._row(self._at.q)

    @property
    def cart_velocity_m_s(self) -> Tensor:
        """Return the carts' velocities, [R]."""
        return self._row(self._at.v)

    @property
    def pressure_kpa(self) -> Tensor:
        """Return the true pressure of the muscles, [R]."""
        return self._row(self._at.pressure)

    def tip_m(self) -> Tensor:
        """Return y, z of the tip, [R, 2]."""
        return torch.stack((self._row(self._at.end_z - 1), self._row(self._at.end_vy - 1)), dim=1)

    def tip_velocity_m_s(self) -> Tensor:
        """Return the true velocity of the tip along y, z, [R, 2]."""
        return torch.stack((self._row(self._at.end_vz - 1), self._row(self._at.end_vz + self.links - 1)), dim=1)

    def snapshot(self) -> Tensor:
        """Return a copy of states and parameters for `restore`, in the CPU's memory."""
        return self._memory.cpu().clone()

    def restore(self, snapshot: Tensor) -> None:
        """Restore a snapshot of a simulator made with the same arguments."""
        self._memory.copy_(snapshot)

    def _row(self, row: int) -> Tensor:
        return self._rows[:, row].reshape(-1)[: self.robots]

    def _full(self, values: Tensor) -> Tensor:
        """Return values [R] as [blocks, LANES]; lanes without a robot have zeros."""
        spare = len(self._rows) * LANES - self.robots
        return torch.nn.functional.pad(values, (0, spare)).view(-1, LANES)
