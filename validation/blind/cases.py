"""Drawing of the benchmark's cases: kinds in fixed shares, causes in turn, random robots and trials."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np

from softarm.reality.parameters import RobotParameters
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY
from validation.blind.imperfections import KNOWN, REMOVABLE, UNKNOWN, UNKNOWNS, Cause, draw_cause, draw_nuisances

T = TypeVar("T")
Kind = Literal["single", "two", "three", "none", "unknown"]
SHARES: dict[Kind, float] = {"single": 0.40, "two": 0.14, "three": 0.06, "none": 0.20, "unknown": 0.20}
_TOGETHER: dict[Kind, int] = {"two": 2, "three": 3}

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
# One of these may be replaced by a repeat of another excitation.
_GIVEN_UP = ("pressure-multisine", "rail-multisine", "rail-chirp", "pressure-staircase")
FRESH = ("sinusoid", "both", "rail-multisine")
# Share of the trials without rail motion in which the drive holds the cart.
_FREE_SHARE = 0.25
_SEEDS = 2**31

# Possible causes and whether they are removed from the model file: removable ones occur in both forms.
SINGLES: tuple[tuple[str, bool], ...] = (*((name, False) for name in KNOWN), *((name, True) for name in REMOVABLE))


@dataclass(frozen=True, slots=True)
class PlannedTrial:
    """Trial of a case that will be recorded."""

    folder: str
    excitation: str
    held: bool
    seed: int


@dataclass(frozen=True, slots=True)
class Case:
    """Robot of a case, its nominal model and its planned trials."""

    name: str
    kind: Kind
    causes: tuple[Cause, ...]
    robot: RobotParameters
    model: Model
    planned: tuple[PlannedTrial, ...]
    fresh: tuple[PlannedTrial, ...]  # never given to the tool

    @property
    def label(self) -> dict[str, Any]:
        """Label that is sealed, as JSON types."""
        causes = [
            {
                "name": c.name,
                "stage": c.stage,
                "removed": c.removed,
                "settings": dict(c.settings),
            }
            for c in self.causes
        ]
        return {"kind": self.kind, "causes": causes}


def draw(count: int, seed: int) -> list[Case]:
    """Draw cases in random order and with random names; the seed is not negative."""
    random = np.random.default_rng((seed, 0))
    wanted = list(_plan(count, random))
    random.shuffle(wanted)
    names = random.choice(16**6, size=count, replace=False)
    return [
        _case(f"case-{name:06x}", kind, causes, np.random.default_rng((seed, 1, index)))
        for index, (name, (kind, causes)) in enumerate(zip(names, wanted, strict=True))
    ]


Wanted = tuple[Kind, tuple[tuple[str, bool], ...]]


def _plan(count: int, random: np.random.Generator) -> Iterator[Wanted]:
    """Kind and causes (name, removed) of every case; single causes occur about equally often."""
    wanted = apportioned(SHARES, count)
    unknowns = in_turn([UNKNOWN + name for name in UNKNOWNS], random)
    singles = in_turn(SINGLES, random)
    for _ in range(wanted["single"]):
        yield "single", (next(singles),)
    several = in_turn(SINGLES, random)
    for kind, together in _TOGETHER.items():
        for _ in range(wanted[kind]):
            yield kind, _apart(several, together)
    for _ in range(wanted["none"]):
        yield "none", ()
    for _ in range(wanted["unknown"]):
        yield "unknown", ((next(unknowns), False),)


def apportioned(shares: Mapping[T, float], count: int) -> dict[T, int]:
    """Return whole numbers in proportion to shares that add up to a count, rounded by the largest remainders."""
    total = sum(shares.values())
    exact = {each: share / total * count for each, share in shares.items()}
    whole = {each: int(x) for each, x in exact.items()}
    for each in sorted(exact, key=lambda each: whole[each] - exact[each])[: count - sum(whole.values())]:
        whole[each] += 1
    return whole


def in_turn(items: Sequence[T], random: np.random.Generator) -> Iterator[T]:
    """Yield all items in random order, again and again."""
    while True:
        for index in random.permutation(len(items)):
            yield items[index]


def _apart(causes: Iterator[tuple[str, bool]], together: int) -> tuple[tuple[str, bool], ...]:
    """Next causes that are not rivals of each other."""
    chosen = [next(causes)]
    while len(chosen) < together:
        chosen.append(next(each for each in causes if all(separable(one[0], each[0]) for one in chosen)))
    return tuple(chosen)


def separable(one: str, other: str) -> bool:
    """Return whether two effects may be combined in a case: they differ and are not rivals."""
    return one != other and other not in REGISTRY[one].separated_by


def _case(name: str, kind: Kind, wanted: Sequence[tuple[str, bool]], random: np.random.Generator) -> Case:
    robot = draw_nuisances(RobotParameters(), random)
    causes = []
    for effect, removed in wanted:
        robot, cause = draw_cause(robot, effect, removed, random)
        causes.append(cause)
    return with_trials(name, kind, causes, robot, random)


def with_trials(
    name: str, kind: Kind, causes: Sequence[Cause], robot: RobotParameters, random: np.random.Generator
) -> Case:
    """Return a case of a robot with its causes, with the nominal model and random trials."""
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
