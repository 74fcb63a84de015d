"""Cases of a corpus of rigs: a machine, its faults and its excitations, all drawn from one seed."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, get_args

import numpy as np

from validation.blind.cases import apportioned, in_turn
from validation.rigs.faults import FAULTS, Patch
from validation.rigs.presets import RIGS, Kind, Rig

Category = Literal["single", "half", "two", "set", "none", "unknown"]
CATEGORIES: Final[tuple[Category, ...]] = get_args(Category)
# Share of each category in a corpus.
SHARES: Final[Mapping[Category, float]] = {
    "single": 0.24, "half": 0.12, "two": 0.12, "set": 0.16, "none": 0.14, "unknown": 0.22,
}  # fmt: skip
USUAL = ("steps", "holds", "sines", "chirp", "multisine")
# Fields of a fault that say which names are right.
RIGHT = ("names", "tied", "must", "near", "also")
SWINGS = ("small swing", "medium swing", "large swing")
# Two faults of one family are hard to distinguish: a case never has both.
_FAMILIES = (
    {"dead_time", "latency", "lag", "uneven lag", "second_order", "compliance"},
    {"deadband", "friction", "backlash", "hysteresis"},
    {"gain", "offset", "load", "sensor_bias", "lean", "bias"},
    {"rate_limit", "acceleration_limit", "choked flow", "lag", "uneven lag"},
    {"ceiling", "weak supply", "gain", "offset"},
    {"payload", "moment", "low moment", "weak motor"},
    {"coulomb_friction", "damping", "drag", "uneven friction", "slope"},
)


@dataclass(frozen=True, slots=True)
class Tie:
    """Causes that some recordings cannot distinguish: one of `faults` is present, the right answer names all."""

    faults: tuple[str, ...]
    must: frozenset[str]  # names that the answer must contain
    may: frozenset[str]  # names that it may contain
    # The only excitations of the case. Empty: the usual ones, because no excitation distinguishes the causes.
    excitations: tuple[str, ...] = ()
    rigs: tuple[str, ...] = ()  # empty: all rigs of the kind that can have the faults


_TIES: Final[Mapping[Kind, tuple[Tie, ...]]] = {
    "tracking": (
        Tie(("dead_time", "lag"), frozenset({"dead_time", "lag"}), frozenset({"latency", "second_order"}),
            ("slow sine",)),
        Tie(("gain", "offset", "sensor_bias"), frozenset({"gain", "sensor_bias"}), frozenset({"ceiling"}),
            ("plateau",)),
        Tie(("friction", "backlash"), frozenset({"deadband", "backlash"}),
            frozenset({"hysteresis", "coulomb_friction", "lag"}), ("slow sine",)),
        Tie(("offset", "sensor_bias"), frozenset({"gain", "sensor_bias"}), frozenset()),
    ),
    "driven_mass": (
        Tie(("payload", "weak motor"), frozenset({"mass", "gain"}), frozenset({"payload"})),
        Tie(("uneven friction",), frozenset({"force_offset", "friction_asymmetry"}), frozenset({"tilt"})),
        Tie(("coulomb_friction", "damping", "slope"), frozenset({"coulomb_friction", "damping", "force_offset"}),
            frozenset({"drag", "friction_asymmetry", "stiction", "tilt"}), ("one speed",)),
    ),
    "pendulum": (
        Tie(("low moment", "payload"), frozenset({"stiffness", "payload"}), frozenset(), rigs=("pendulum", "boom")),
    ),
    # A moving base or a motor distinguishes all causes.
    "chain": (),
}  # fmt: skip
# Faults that no recording of the rig distinguishes from another fault are never a single cause.
_TIED_ALWAYS: Final[Mapping[str, frozenset[str]]] = {
    "cart": frozenset({"payload", "weak motor", "uneven friction"}),
    "slide": frozenset({"payload", "weak motor", "uneven friction"}),
    "coil": frozenset({"payload", "weak motor", "uneven friction"}),
    "pendulum": frozenset({"low moment", "payload"}),
    "boom": frozenset({"low moment", "payload"}),
}


@dataclass(frozen=True, slots=True)
class Cause:
    """One fault of a case, with the parameters of the plant and the names that a diagnosis may give the fault."""

    fault: str
    settings: Patch
    right: Mapping[str, list[str]]  # names of effects in the fields `RIGHT` of the fault


@dataclass(frozen=True, slots=True)
class RigCase:
    """One recorded rig; its folder contains neither `causes` nor `category`."""

    name: str
    rig: Rig
    category: Category
    causes: tuple[Cause, ...]
    strength: float
    excitations: tuple[str, ...]  # the excitation of each trial
    seed: int

    @property
    def kind(self) -> Kind:
        """Return the kind of the stage."""
        return self.rig.kind

    @property
    def truth(self) -> dict[str, Any]:
        """Return the drawn case as JSON types."""
        causes = [
            {
                "fault": c.fault,
                "settings": {n: np.ravel(x).tolist() if isinstance(x, tuple) else x for n, x in c.settings.items()},
            }
            | dict(c.right)
            for c in self.causes
        ]
        return {
            "case": self.name,
            "rig": self.rig.name,
            "kind": self.kind,
            "plant": self.rig.plant,
            "category": self.category,
            "strength": self.strength,
            "excitations": list(self.excitations),
            "seed": self.seed,
            "causes": causes,
        }


def draw(
    count: int, seed: int, kinds: Sequence[Kind] = get_args(Kind), categories: Sequence[Category] = CATEGORIES
) -> list[RigCase]:
    """Draw cases of some kinds and categories; neither their order nor their names reveal their contents.

    Kinds alternate, and so do the rigs of a kind; `SHARES` gives the number of cases per category.
    """
    random = np.random.default_rng((seed, 0))
    wanted = [c for c, n in apportioned({c: SHARES[c] for c in categories}, count).items() for _ in range(n)]
    random.shuffle(wanted)
    kind_of = in_turn(kinds, random)
    rigs = {k: in_turn([r for r in RIGS.values() if r.kind == k], random) for k in kinds}
    names = random.choice(16**6, size=count, replace=False)
    faults: dict[tuple[str, bool], Iterator[str]] = {}
    cases = []
    for index, (name, category) in enumerate(zip(names, wanted, strict=True)):
        rig = next(rigs[next(kind_of)])
        own = np.random.default_rng((seed, 1, index))
        cases.append(_case(f"rig-{name:06x}", rig, category, faults, own, int(own.integers(2**31))))
    return cases


def case_of(
    rig: str, faults: Sequence[str], strength: float = 1.0, seed: int = 0, excitations: Sequence[str] = ()
) -> RigCase:
    """Return a case with chosen faults (of `FAULTS`) of a rig (of `RIGS`), with given or usual excitations.

    Raises:
        KeyError: The rig or a fault is unknown.
    """
    machine, random = RIGS[rig], np.random.default_rng((seed, 2))
    causes = tuple(_cause(machine, name, strength, random) for name in faults)
    unknown = any(not c.right["names"] for c in causes)
    category: Category = "none" if not faults else "unknown" if unknown else "two" if len(faults) > 1 else "single"
    return RigCase(
        f"{rig}-{'-'.join(faults) or 'healthy'}".replace(" ", "-"), machine, category, causes, strength,
        tuple(excitations) or _usual(machine, random), seed,
    )  # fmt: skip


def _case(
    name: str,
    rig: Rig,
    category: Category,
    faults: dict[tuple[str, bool], Iterator[str]],
    random: np.random.Generator,
    seed: int,
) -> RigCase:
    strength = 0.5 if category == "half" else 1.0
    excitations = _usual(rig, random)
    causes: tuple[Cause, ...] = ()
    if category == "set":
        causes, excitations = _tied(rig, random, excitations)
        category = "set" if causes else "single"
    if category not in ("set", "none"):
        turn = faults.setdefault((rig.name, category == "unknown"), in_turn(_faults(rig, category), random))
        chosen = [next(turn)]
        if category == "two":
            chosen.append(next(f for f in turn if not _alike(chosen[0], f)))
        causes = tuple(_cause(rig, f, strength, random) for f in chosen)
    return RigCase(name, rig, category, causes, strength, excitations, seed)


def _faults(rig: Rig, category: Category) -> list[str]:
    """Return the possible faults of a rig: known effects that its data can distinguish, or unknown effects."""
    known = category != "unknown"
    never = _TIED_ALWAYS.get(rig.name, frozenset())
    return [name for name, f in FAULTS[rig.plant].items() if bool(f.names) == known and name not in never]


def _alike(one: str, other: str) -> bool:
    return one == other or any({one, other} <= family for family in _FAMILIES)


def _cause(rig: Rig, name: str, strength: float, random: np.random.Generator, tie: Tie | None = None) -> Cause:
    fault = FAULTS[rig.plant][name]
    settings = fault.draw(rig, strength, random)
    if tie:
        fault = replace(fault, names=fault.names | tie.must, tied=fault.tied | tie.may, must=tie.must)
    return Cause(name, settings, {each: sorted(getattr(fault, each)) for each in RIGHT})


def _tied(rig: Rig, random: np.random.Generator, usual: tuple[str, ...]) -> tuple[tuple[Cause, ...], tuple[str, ...]]:
    """Return a cause that its recordings cannot distinguish from others, and the excitations of these recordings."""
    there = FAULTS[rig.plant]
    ties = [
        t for t in _TIES[rig.kind] if any(f in there for f in t.faults) and (not t.rigs or rig.name in t.rigs)
    ]  # fmt: skip
    if not ties:
        return (), usual
    tie = ties[random.integers(len(ties))]
    options = [f for f in tie.faults if f in there]
    cause = _cause(rig, options[random.integers(len(options))], 1.0, random, tie)
    return (cause,), tie.excitations * 5 or usual


def _usual(rig: Rig, random: np.random.Generator) -> tuple[str, ...]:
    kinds = list(SWINGS * 2 if rig.plant == "pendulum" else USUAL)
    if rig.plant != "pendulum" and random.random() < 0.5:
        kinds.append(kinds[random.integers(len(kinds))])
    random.shuffle(kinds)
    return tuple(kinds)
