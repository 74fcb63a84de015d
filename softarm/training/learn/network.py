"""The seed's policy network: MLP, its output concatenated with the input, LSTM, LayerNorm, linear heads ([P] SM-E).

Further orders, from the seed's ablation ([P] section 4.2): LSTM and LayerNorm before the MLP, and the MLP alone.
"""

# mypy: allow-subclassing-any, allow-untyped-decorators

from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from softarm.common.quantity import shown
from softarm.schemas.base import Strict
from softarm.training.learn import lstm

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


RecurrentState = tuple[Tensor, Tensor]  # hidden and cell, float32 [B, size] each
SIZE_MAX, LAYERS_MAX = 4096, 8  # a damaged checkpoint may state a network that no memory holds
WIDE = 64  # inputs; narrower products gain nothing in bfloat16, and the first needs the precision
Order = Literal["mlp-lstm", "lstm-mlp", "mlp"]


@dataclass(frozen=True)
class NetworkShape:
    """Sizes; the defaults are the seed's."""

    __pydantic_config__ = Strict.model_config

    inputs: int = 10
    actions: int = 2
    mlp: tuple[int, ...] = (256, 128, 64)
    state: int = 256  # of the LSTM; stays zero without one
    order: Order = "mlp-lstm"

    def __post_init__(self) -> None:
        """Raise ValueError if the order is unknown or a size is out of range."""
        sizes = (self.inputs, self.actions, *self.mlp, self.state)
        if len(self.mlp) > LAYERS_MAX or not all(type(size) is int and 1 <= size <= SIZE_MAX for size in sizes):
            raise ValueError(
                f"network sizes are {shown(', '.join(map(str, sizes)))}; allowed are 1 to {SIZE_MAX} each, and "
                f"{LAYERS_MAX} layers of `mlp`; change them"
            )
        if self.order not in get_args(Order):
            raise ValueError(f"network.order is {self.order!r}; give one of {', '.join(get_args(Order))}")


class PolicyNetwork(nn.Module):
    """Actor and critic with a common trunk, for raw physical observations; it contains the normaliser."""

    def __init__(self, shape: NetworkShape) -> None:
        super().__init__()
        self.shape = shape
        self.observation_normaliser = RunningNormaliser(shape.inputs)
        self.value_normaliser = RunningNormaliser(1)
        layers: list[nn.Module] = []
        width = shape.state if shape.order == "lstm-mlp" else shape.inputs
        for size in shape.mlp:
            layers += [nn.Linear(width, size), nn.ELU()]
            nn.init.zeros_(layers[-2].bias)
            width = size
        self.mlp = nn.Sequential(*layers)
        if shape.order != "mlp":
            fed = width + shape.inputs if shape.order == "mlp-lstm" else shape.inputs
            cell = nn.LSTM(fed, shape.state)  # for its initial values; see training/learn/lstm.py
            self.w_x = nn.Parameter(cell.weight_ih_l0.detach().clone())
            self.w_h = nn.Parameter(cell.weight_hh_l0.detach().clone())
            self.bias = nn.Parameter(torch.zeros(4 * shape.state))
            self.layer_norm = nn.LayerNorm(shape.state)
        features = shape.state if shape.order == "mlp-lstm" else width
        self.mean_head = nn.Linear(features, shape.actions)
        self.value_head = nn.Linear(features, 1)
        for head in (self.mean_head, self.value_head):
            nn.init.zeros_(head.bias)
        self.log_std = nn.Parameter(torch.zeros(shape.actions))

    @torch.no_grad()
    def follow(self, other: "PolicyNetwork", share: float) -> None:
        """Move every weight by a share towards another network's, and copy its running statistics."""
        for mine, theirs in zip(self.parameters(), other.parameters(), strict=True):
            mine.lerp_(theirs, share)
        for mine, theirs in zip(self.buffers(), other.buffers(), strict=True):
            mine.copy_(theirs)

    @property
    def device(self) -> torch.device:
        """Device of the network and of its inputs."""
        return self.log_std.device

    def initial_state(self, batch: int) -> RecurrentState:
        """Return the state at the beginning of an episode."""
        hidden, cell = torch.zeros((2, batch, self.shape.state), device=self.device)
        return hidden, cell

    def forward(
        self, observation: Tensor, keep: Tensor, state: RecurrentState, dtype: torch.dtype = torch.float32
    ) -> tuple[Tensor, Tensor, RecurrentState]:
        """Run the network over sequences.

        Takes float32 observations [T, B, inputs] in physical units and `keep` [T, B], 0 where an episode begins.
        `dtype` is the type of all matrix products but those of the first layer and the heads.
        Returns the action's mean [T, B, actions] (not clamped), the normalised value [T, B] and the last state.
        """
        features = self.observation_normaliser(observation)
        if self.shape.order == "mlp-lstm":
            features = torch.cat((self._hidden_layers(features, dtype), features), dim=-1)
        if self.shape.order != "mlp":
            hidden, state = lstm.sequence(features, keep, state, self.w_x, self.w_h, self.bias, dtype)
            features = self.layer_norm(hidden)
        if self.shape.order != "mlp-lstm":
            features = self._hidden_layers(features, dtype)
        return self.mean_head(features), self.value_head(features).squeeze(-1), state

    def _hidden_layers(self, features: Tensor, dtype: torch.dtype) -> Tensor:
        for layer in self.mlp:
            if isinstance(layer, nn.Linear) and layer.in_features >= WIDE:
                weight, bias = layer.weight.to(dtype), layer.bias.to(dtype)
                features = nn.functional.linear(features.to(dtype), weight, bias).float()
            else:
                features = layer(features)
        return features
