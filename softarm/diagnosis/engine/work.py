"""Planned and finished work of a search, in rollouts: simulations of all data at one point.

Counts come before the search, from the numbers of effects and parameters alone, so that the same data have the same
plan on every machine. The two constants were counted on simulated rigs. A healthy rig takes a tenth of its plan, one
with an effect 0.4 to 2 times, and a real arm with many gaps 1.5 to 5 times.
"""

from collections.abc import Callable

Progress = Callable[[str, float], None]

FULL, REDUCED = 30.0, 5.5  # rollouts per parameter of a fit of all effects, and of a fit without one of them


def full(parameters: int) -> float:
    """Return the usual number of rollouts that fit all effects at once, from several starts."""
    return FULL * (1 + parameters)


def reduced(effects: int, parameters: float) -> float:
    """Return the usual number of rollouts that fit a set without each of its effects."""
    return REDUCED * effects * (1 + parameters)


def backward(effects: int, parameters: int) -> float:
    """Return the usual number of rollouts of a search backward from all effects, which removes half of them a step."""
    share, found = parameters / max(effects, 1), full(parameters)
    while effects > 1:
        found += reduced(effects, share * effects)
        effects -= max((effects - 1) // 2, 1)
    return found


class Work:
    """Progress of a search by finished steps, each with a planned number of rollouts."""

    def __init__(self, report: Progress) -> None:
        """Begin without a plan; `report` gets the current step and the finished share, 0 to 1."""
        self._report = report
        self._done, self._step, self._counted, self._left = 0.0, 0.0, 0.0, 0.0
        self._text, self._share = "", 0.0

    def begin(self, text: str, rollouts: float, further: float) -> None:
        """Begin a step, which finishes the one before; `rollouts` are planned for it and `further` ones after it."""
        self._done += self._step
        self._text, self._step, self._counted, self._left = text, rollouts, 0.0, further
        self.count(0)

    def count(self, rollouts: int) -> None:
        """Count finished rollouts of the current step."""
        self._counted += rollouts
        done, total = self._done + min(self._counted, self._step), self._done + self._step + self._left
        if total > 0:
            self._share = max(self._share, done / total)
            self._report(self._text, self._share)
