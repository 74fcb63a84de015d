"""Running mean and variance of a network's inputs or outputs."""

# mypy: allow-subclassing-any, allow-untyped-decorators

import torch
from torch import Tensor, nn

CLIP = 5.0  # normalised inputs beyond this are cut, as the seed does
VARIANCE_FLOOR = 1e-5


class RunningNormaliser(nn.Module):
    """Mean and variance over all values so far, in float64 with Chan's pairwise update.

    Chan, Golub, LeVeque: Updating Formulae and a Pairwise Algorithm for Computing Sample Variances (1979).
    """

    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(size, dtype=torch.float64))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    @torch.no_grad()
    def update(self, values: Tensor) -> None:
        """Update the statistics with values [..., size]."""
        values = values.reshape(-1, self.mean.shape[0]).double()
        count, mean, variance = values.shape[0], values.mean(0), values.var(0, correction=0)
        total = self.count + count
        distance = mean - self.mean
        spread = self.variance * self.count + variance * count + distance**2 * self.count * count / total
        self.mean += distance * (count / total)
        self.variance.copy_(spread / total)
        self.count.copy_(total)

    def scale(self) -> Tensor:
        """Return the standard deviation, with a lower bound, as float32 [size]."""
        return torch.sqrt(self.variance + VARIANCE_FLOOR).float()

    def forward(self, values: Tensor) -> Tensor:
        """Normalise [..., size] and cut at +-CLIP."""
        return torch.clamp((values - self.mean.float()) / self.scale(), -CLIP, CLIP)

    def restore(self, normalised: Tensor) -> Tensor:
        """Undo `forward`, except for the clipping."""
        return normalised * self.scale() + self.mean.float()
