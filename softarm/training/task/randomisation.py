"""Randomisation of robots: values of the registry's effects, drawn uniformly per robot."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.model import Model
from softarm.simulator.effects import EffectError, find, out_of_range
from softarm.simulator.model_rows import idle_effects

Draw = dict[str, NDArray[np.float64]]  # 'stage.effect.parameter' -> one value a robot, [R]


@dataclass(frozen=True)
class Randomisation:
    """Ranges to draw from, and how often; without ranges nothing is drawn."""

    # 'stage.effect.parameter' -> lowest and highest value, in its unit; effects that the model lacks are added
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    each_episode: bool = False  # draw again for each episode of a robot, else only once

    def __post_init__(self) -> None:
        """Check the ranges. Raises EffectError for an unknown or invalid effect, ValueError for a reversed range."""
        for path, (low, high) in self.ranges.items():
            effect, parameter = find(path)
            for end in (low, high):
                if not parameter.admits(end):
                    raise EffectError(out_of_range(effect, parameter, end))
            if not low <= high < np.inf:
                raise ValueError(f"{path} has the range {low} to {high}; give a lower and a higher finite end")

    def effects_with(self, model: Model) -> set[str]:
        """Return the effects of a model that are not at their neutral value, and those that are drawn."""
        return (model.effects.keys() - idle_effects(model)) | {path.rpartition(".")[0] for path in self.ranges}

    def draw(self, rng: np.random.Generator, robots: int) -> Draw:
        """Draw values for a number of robots; empty without ranges."""
        return {path: rng.uniform(low, high, robots) for path, (low, high) in self.ranges.items()}
