"""Batch simulator whose robots lie in a torch tensor, on a graphics card or, for tests, in the CPU's memory."""

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_PERIOD_S, TRAINING_PHYSICS_RATE_HZ
from softarm.simulator import kernel
from softarm.simulator.cuda.stepper import LANES, stepper
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
        # The CPU's block has the card's width only if there are as many robots.
        copies = -(-LANES // self.variants)
        repeated = {path: np.tile(np.broadcast_to(each, self.variants), copies) for path, each in overrides.items()}
        packed = Simulator(model, copies * self.variants, physics_rate_hz, overrides=repeated)
        table, self.active, self._substeps, self._substep_s = packed.prepare(step_s)
        self.robots, self.links, self.device = robots, packed.links, torch.device(device)
        self._at, self._lengths = kernel.rows((0,) * self.links), ((0,) * self.links, (0,) * LANES)
        self._table = torch.from_numpy(table.transpose(1, 0, 2).reshape(self._at.end, -1)[:, : self.variants].copy())
        self._table = self._table.to(self.device)
        blocks = -(-robots // LANES)
        spread = torch.arange(blocks * LANES, device=self.device) % self.variants
        self._rows = self._table[:, spread].view(-1, blocks, LANES).transpose(0, 1).contiguous()
        self._memory = self._rows.view(blocks, -1)
        on_card = self.device.type == "cuda"
        self._step = stepper(self._memory, robots, self.links, self.active) if on_card else None
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
        at, rows, which = self._at, self._rows, self._full(robots).unsqueeze(1)
        if variant is not None:
            chosen = self._full(variant).view(-1)
            for part in (slice(0, at.shelf_y), slice(at.keep_inflate, at.drive_given)):
                fresh = self._table[part][:, chosen].view(-1, *which.shape[::2]).transpose(0, 1)
                rows[:, part] = torch.where(which, fresh, rows[:, part])
        rows[:, at.q : at.cart_command].masked_fill_(which, 0.0)
        if cart_position_m is not None:
            rows[:, at.q] += which[:, 0] * self._full(cart_position_m)
        if joint_angles_rad is not None:
            angles = self._full(joint_angles_rad.cumsum(1)).transpose(1, 2)
            rows[:, at.q + 1 : at.v] += which * angles
        if pressure_kpa is not None:
            pressure = which * self._full(pressure_kpa).unsqueeze(1)
            rows[:, at.pressure : at.pressure + 1] += pressure
            rows[:, at.pressure_history : at.pressure_age] += pressure
            rows[:, at.pressure_acting : at.pressure_acting + 1] += pressure
        self._locate()

    def step(self, cart_velocity_m_s: Tensor, pressure_kpa: Tensor) -> None:
        """Issue a command now and hold it for a step; tensors [R]."""
        self._rows[:, self._at.cart_command] = self._full(cart_velocity_m_s)
        self._rows[:, self._at.pressure_command] = self._full(pressure_kpa)
        self.advance()

    def advance(self) -> None:
        """Advance every robot by a step under its last command."""
        if self._step is not None:
            self._step(self._substeps, self._substep_s)
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

    @property
    def tip_m(self) -> Tensor:
        """Return y, z of the tip, [R, 2]."""
        return torch.stack((self._row(self._at.end_z - 1), self._row(self._at.end_vy - 1)), dim=1)

    @property
    def tip_velocity_m_s(self) -> Tensor:
        """Return the true velocity of the tip along y, z, [R, 2]."""
        return torch.stack((self._row(self._at.end_vz - 1), self._row(self._at.end_vz + self.links - 1)), dim=1)

    def snapshot(self) -> Tensor:
        """Return a copy of states and parameters for `restore`, in the CPU's memory."""
        return self._memory.cpu().clone()

    def restore(self, snapshot: Tensor) -> None:
        """Restore a snapshot of a simulator made with the same arguments."""
        self._memory.copy_(snapshot)

    def _locate(self) -> None:
        """Set the links' positions and velocities after a reset."""
        at, rows = self._at, self._rows
        angles, rates = rows[:, at.q + 1 : at.v], rows[:, at.v + 1 : at.a]
        length = rows[:, at.length : at.moment]
        across, along = length * angles.sin(), length * angles.cos()
        rows[:, at.end_y : at.end_z] = rows[:, at.q : at.q + 1] + across.cumsum(1)
        rows[:, at.end_z : at.end_vy] = rows[:, at.base_height : at.base_height + 1] - along.cumsum(1)
        rows[:, at.end_vy : at.end_vz] = rows[:, at.v : at.v + 1] + (along * rates).cumsum(1)
        rows[:, at.end_vz : at.end_vz + self.links] = (across * rates).cumsum(1)

    def _row(self, row: int) -> Tensor:
        return self._rows[:, row].reshape(-1)[: self.robots]

    def _full(self, values: Tensor) -> Tensor:
        """Return values [R, ...] as [blocks, LANES, ...]; lanes without a robot have zeros."""
        spare = len(self._rows) * LANES - self.robots
        if spare:
            values = torch.cat((values, values.new_zeros((spare, *values.shape[1:]))))
        return values.view(-1, LANES, *values.shape[1:])
