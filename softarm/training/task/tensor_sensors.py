"""Motion capture and pressure readings of a batch in tensors; the effects are those of `simulator.sensors.Sensors`."""

import numpy as np
import torch
from torch import Tensor

from softarm.simulator.cuda.simulator import TensorSimulator

NAMES = (
    "mocap.latency.delay",
    "mocap.rotation.angle",
    "mocap.scale.scale",
    "mocap.offset.y",
    "mocap.offset.z",
    "mocap.noise.sigma",
    "mocap.dropout.share",
    "clock.drift.rate",
    "pressure.sensor_bias.bias",
)


class TensorSensors:
    """Readings of cart and tip of a simulator's robots, one look a control step. No method waits for the device."""

    _tensors = ("_values", "_past", "positions_m", "velocities_m_s")  # of a snapshot

    def __init__(
        self, simulator: TensorSimulator, step_s: float, differenced: bool, generator: torch.Generator
    ) -> None:
        """Attach to a simulator with a look every `step_s`; `differenced` velocities are differences of positions."""
        self._simulator, self._step_s, self._differenced = simulator, step_s, differenced
        self._generator, robots, device = generator, simulator.robots, simulator.device
        split = (name.rpartition(".") for name in NAMES)
        values = [simulator.effects.value(effect, parameter) for effect, _, parameter in split]
        table = np.stack([np.broadcast_to(each, simulator.variants) for each in values])
        self._table = torch.from_numpy(table.astype(np.float32)).to(device)  # [effects, variants]
        self._values = self._table[:, torch.arange(robots, device=device) % simulator.variants]
        # Poses y, z of cart and tip with their velocities, the newest last, as far back as the longest delay.
        frames = int(np.ceil(values[0].max() / step_s)) + 1
        self._past = torch.zeros((frames, robots, 2, 4), device=device)
        self.positions_m = torch.zeros((robots, 2, 2), device=device)  # of cart and tip, y and z
        self.velocities_m_s = torch.zeros((robots, 2, 2), device=device)

    @property
    def pressure_kpa(self) -> Tensor:
        """Return the readings of the regulators' sensors, [R]."""
        return self._simulator.pressure_kpa + self._value("pressure.sensor_bias.bias")

    def look(self) -> None:
        """Read all robots after a control step."""
        self._past.copy_(torch.cat((self._past[1:], self._true().unsqueeze(0))))
        positions, velocities = self._seen()
        kept = torch.rand(len(positions), generator=self._generator, device=positions.device)
        kept = (kept < self._value("mocap.dropout.share")).view(-1, 1, 1)
        positions = torch.where(kept, self.positions_m, positions)
        if self._differenced:
            since_s = self._step_s * (1.0 + self._value("clock.drift.rate"))
            velocities = (positions - self.positions_m) / since_s.view(-1, 1, 1)
        else:
            velocities = torch.where(kept, self.velocities_m_s, velocities)
        self.positions_m.copy_(positions)
        self.velocities_m_s.copy_(velocities)

    def begin(self, which: Tensor, variant: Tensor | None) -> None:
        """Read robots, bool [R], that were set to a new state and have stood there before; variants as for `reset`."""
        if variant is not None:
            self._values.copy_(torch.where(which, self._table[:, variant], self._values))
        robots = which.view(-1, 1, 1)
        self._past.copy_(torch.where(robots, self._true(), self._past))
        positions, velocities = self._seen()
        if self._differenced:
            velocities = torch.zeros_like(velocities)
        self.positions_m.copy_(torch.where(robots, positions, self.positions_m))
        self.velocities_m_s.copy_(torch.where(robots, velocities, self.velocities_m_s))

    def snapshot(self) -> dict[str, Tensor]:
        """Return a copy of the readings and their past for `restore`, in the CPU's memory."""
        return {name: getattr(self, name).cpu().clone() for name in self._tensors}

    def restore(self, snapshot: dict[str, Tensor]) -> None:
        """Restore a snapshot of the sensors of a simulator made with the same arguments."""
        for name in self._tensors:
            getattr(self, name).copy_(snapshot[name])

    def _value(self, name: str) -> Tensor:
        return self._values[NAMES.index(name)]

    def _true(self) -> Tensor:
        """Return the true y, z, vy, vz of cart and tip, [R, 2, 4]."""
        simulator = self._simulator
        cart, velocity = simulator.cart_position_m, simulator.cart_velocity_m_s
        height = torch.full_like(cart, simulator.base_height_m)
        cart = torch.stack((cart, height, velocity, torch.zeros_like(cart)), dim=1)
        return torch.stack((cart, torch.cat((simulator.tip_m(), simulator.tip_velocity_m_s()), dim=1)), dim=1)

    def _seen(self) -> tuple[Tensor, Tensor]:
        """Return the cameras' positions and velocities of now, each [R, 2, 2], before drops."""
        last = len(self._past) - 1
        place = last - self._value("mocap.latency.delay") / self._step_s
        early = place.floor().clamp(0, last).long()
        late = (early + 1).clamp(max=last)
        frames = [self._past.gather(0, each.view(1, -1, 1, 1).expand(1, -1, 2, 4))[0] for each in (early, late)]
        frame = torch.lerp(*frames, (place - early).view(-1, 1, 1))
        turn, scale = self._value("mocap.rotation.angle"), 1.0 + self._value("mocap.scale.scale")
        sine, cosine = ((scale * each).unsqueeze(1) for each in (turn.sin(), turn.cos()))
        y, z, vy, vz = frame.unbind(2)
        positions = torch.stack((cosine * y - sine * z, sine * y + cosine * z), dim=2)
        positions = positions + torch.stack([self._value(f"mocap.offset.{axis}") for axis in "yz"], dim=1).unsqueeze(1)
        noise = torch.randn(positions.shape, generator=self._generator, device=positions.device)
        positions = positions + self._value("mocap.noise.sigma").view(-1, 1, 1) * noise
        return positions, torch.stack((cosine * vy - sine * vz, sine * vy + cosine * vz), dim=2)
