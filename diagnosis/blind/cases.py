"""Which cases a benchmark has: kinds in fixed shares, causes in turn, robots and trials drawn. Pure."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np

from softarm.diagnosis.blind.imperfections import KNOWN, REMOVABLE, UNKNOWN, UNKNOWNS, Cause, draw_cause, draw_nuisances
from softarm.reality.parameters import RobotParameters
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY

T = TypeVar("T")
Kind = Literal["single", "two", "none", "unknown"]
# Of a hundred cases.
SHARES: dict[Kind, float] = {"single": 0.40, "two": 0.16, "none": 0.16, "unknown": 0.28}

PROGRAMME = (
    "seed",
    "pressure-staircase",
    "free-decay",
    "pressure-multisine",
    "rail-steps",
    "rail-chirp",
    "rail-multisine",
    "both",
)
_GIVEN_UP = ("pressure-multisine", "rail-multisine", "rail-chirp", "pressure-staircase")  # for a repeat
FRESH = ("sinusoid", "both", "rail-multisine")
_FREE_SHARE = 0.25  # of the trials that do not move the rail, the cart is left to the drive
_SEEDS = 2**31

# What a case can have wrong: every known cause, and every removable one a second time, out of the model file.
SINGLES: tuple[tuple[str, bool], ...] = (*((name, False) for name in KNOWN), *((name, True) for name in REMOVABLE))


@dataclass(frozen=True, slots=True)
class PlannedTrial:
    """One trial to record."""

    folder: str
    excitation: str
    held: bool
    seed: int


@dataclass(frozen=True, slots=True)
class Case:
    """One robot, the model that is believed of it, and how it is flown."""

    name: str
    kind: Kind
    causes: tuple[Cause, ...]
    robot: RobotParameters
    model: Model
    planned: tuple[PlannedTrial, ...]
    fresh: tuple[PlannedTrial, ...]  # never given to the tool

    @property
    def label(self) -> dict[str, Any]:
        """What is sealed: JSON types only."""
        causes = [
            {"name": c.name, "stage": c.stage, "removed": c.removed, "settings": dict(c.settings)} for c in self.causes
        ]
        return {"kind": self.kind, "causes": causes}


def draw(count: int, seed: int) -> list[Case]:
    """Cases in an order and under names that say nothing of what they hold.

    Raises ValueError for a count below 1 or a seed below 0.
    """
    if count < 1 or seed < 0:
        raise ValueError(f"count is {count}, seed is {seed}; give a count from 1 and a seed from 0")
    random = np.random.default_rng((seed, 0))
    wanted = list(_plan(count, random))
    random.shuffle(wanted)
    names = random.choice(16**6, size=count, replace=False)
    return [
        _case(f"case-{name:06x}", kind, causes, np.random.default_rng((seed, 1, index)))
        for index, (name, (kind, causes)) in enumerate(zip(names, wanted, strict=True))
    ]


def counts(count: int) -> dict[Kind, int]:
    """Cases of each kind, by SHARES; what rounding leaves over goes to the largest remainders."""
    exact = {kind: share * count for kind, share in SHARES.items()}
    whole = {kind: int(value + 1e-9) for kind, value in exact.items()}
    by_rest = sorted(exact, key=lambda kind: whole[kind] - exact[kind])
    for kind in by_rest[: count - sum(whole.values())]:
        whole[kind] += 1
    return whole


Wanted = tuple[Kind, tuple[tuple[str, bool], ...]]


def _plan(count: int, random: np.random.Generator) -> Iterator[Wanted]:
    """Kind and causes (name, removed) of every case; single causes come about equally often."""
    wanted = counts(count)
    singles, unknowns = _in_turn(SINGLES, random), _in_turn([UNKNOWN + name for name in UNKNOWNS], random)
    for _ in range(wanted["single"]):
        yield "single", (next(singles),)
    pairs = _in_turn(SINGLES, random)
    for _ in range(wanted["two"]):
        one = next(pairs)
        other = next(candidate for candidate in pairs if separable(one[0], candidate[0]))
        yield "two", (one, other)
    for _ in range(wanted["none"]):
        yield "none", ()
    for _ in range(wanted["unknown"]):
        yield "unknown", ((next(unknowns), False),)


def separable(one: str, other: str) -> bool:
    """Whether two effects may come together: not the same, and neither easily taken for the other."""
    return one != other and other not in REGISTRY[one].confused_with


def _in_turn(items: Sequence[T], random: np.random.Generator) -> Iterator[T]:
    """All of them in a drawn order, then all again in another."""
    while True:
        for index in random.permutation(len(items)):
            yield items[index]


def _case(name: str, kind: Kind, wanted: Sequence[tuple[str, bool]], random: np.random.Generator) -> Case:
    robot = draw_nuisances(RobotParameters(), random)
    causes = []
    for effect, removed in wanted:
        robot, cause = draw_cause(robot, effect, removed, random)
        causes.append(cause)
    effects = {n: p for n, p in Model().effects.items() if not any(c.removed and c.name == n for c in causes)}
    model = Model().model_copy(update={"effects": effects})
    programme = list(PROGRAMME)
    if random.random() < 0.5:
        gone = _GIVEN_UP[random.integers(len(_GIVEN_UP))]
        programme.remove(gone)
        programme.append(programme[random.integers(len(programme))])
    random.shuffle(programme)
    return Case(name, kind, tuple(causes), robot, model, _planned(programme, random), _planned(FRESH, random))


def _planned(programme: Sequence[str], random: np.random.Generator) -> tuple[PlannedTrial, ...]:
    planned = []
    for number, name in enumerate(programme, 1):
        excitation = EXCITATIONS[name]
        free = excitation.moves_rail or (excitation.duration_s < 20 and random.random() < _FREE_SHARE)
        planned.append(PlannedTrial(f"trial-{number}", name, not free, int(random.integers(_SEEDS))))
    return tuple(planned)
