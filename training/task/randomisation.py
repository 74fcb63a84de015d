"""Robots that differ from each other: values of the registry's effects, drawn evenly over ranges, robot by robot."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softarm.simulator.effects import EffectError, find, out_of_range

Draw = dict[str, NDArray[np.float64]]  # 'stage.effect.parameter' -> one value a robot, [R]


@dataclass(frozen=True)
class Randomisation:
    """What is drawn and how often; by default nothing.

    ranges: 'stage.effect.parameter' -> lowest and highest value, in the parameter's unit; an effect that the model
    lacks is added by it. each_episode: drawn anew whenever a robot begins again, else once and for all.
    """

    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    each_episode: bool = False

    def __post_init__(self) -> None:
        """Raises EffectError for what the registry refuses, ValueError for a range from high to low."""
        for path, (low, high) in self.ranges.items():
            effect, parameter = find(path)
            for end in (low, high):
                if not parameter.admits(end):
                    raise EffectError(out_of_range(effect, parameter, end))
            if not low <= high < np.inf:
                raise ValueError(f"{path} is to be drawn from {low} to {high}; give a lower and a higher finite end")

    def draw(self, rng: np.random.Generator, robots: int) -> Draw:
        """Values for as many robots; empty without ranges."""
        return {path: rng.uniform(low, high, robots) for path, (low, high) in self.ranges.items()}
