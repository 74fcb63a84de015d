"""What a chain's stage.yaml gives: masses, arms, inertias, friction; and the scales of time and torque they set."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh

from softarm.diagnosis.data.trials import TableStage, TrialError
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.laws import chain as law

GRAVITY_M_S2 = 9.81
WEIGHTLESS = 1e-3  # of gravity: below, nothing swings by its weight
_MASSES = ("mass_kg", "centre_m")
_INERTIAS = ("inertia_kg_m2", "inertia_joint_kg_m2")  # about the centre of mass; about the joint


@dataclass(frozen=True, slots=True)
class Chain:
    """n links; arrays [n] from the base outwards, each of the link or of the joint that it hangs from."""

    moment: Array  # kg m: mass times arm, of the link and of what hangs from its end
    inertia: Array  # kg m^2 about the joint, likewise
    length: Array  # m to the next joint; 0 of a last one that is not given
    centre: Array  # m
    own: Array  # kg m^2 about the joint, of the link alone
    viscous: Array  # N m s/rad
    dry: Array  # N m
    armature: Array  # kg m^2 of a motor, as the joint feels it
    mass: Array  # kg
    gravity: float  # m/s^2
    relative: bool  # angles are measured from link to link

    @property
    def n(self) -> int:
        """Number of links."""
        return len(self.moment)

    @property
    def weight_nm(self) -> Array:
        """[n] torque that each joint holds where all links stand out sideways."""
        return self.gravity * np.cumsum(self.moment[::-1])[::-1]

    @property
    def still_inertia(self) -> Array:
        """[n, n] inertia of the chain that hangs straight, in absolute angles."""
        matrix = np.diag(self.inertia.astype(float))
        for i in range(self.n):
            for j in range(i):
                matrix[i, j] = matrix[j, i] = self.length[j] * self.moment[i]
        turns = np.eye(self.n) - np.eye(self.n, k=-1)
        return np.asarray(matrix + turns.T @ np.diag(self.armature) @ turns)

    @property
    def joint_inertia(self) -> Array:
        """[n] what each joint's motor moves while the others are free: the smallest that its friction can meet."""
        turns = np.linalg.inv(np.eye(self.n) - np.eye(self.n, k=-1))  # relative angles to absolute
        return np.asarray(1 / np.diag(np.linalg.inv(turns.T @ self.still_inertia @ turns)))

    @property
    def periods_s(self) -> Array:
        """[n] of the small swings, the slowest first; empty where nothing has weight."""
        if self.gravity < WEIGHTLESS * GRAVITY_M_S2 or not (self.moment > 0).all():
            return np.empty(0)
        squares = eigh(np.diag(self.gravity * self.moment), self.still_inertia, eigvals_only=True)
        return np.asarray(2 * math.pi / np.sqrt(squares))

    def loaded(self, mass_kg: float) -> "Chain":
        """With a point of this mass at the last link's end."""
        moment, inertia = self.moment + mass_kg * self.length, self.inertia + mass_kg * self.length**2
        return replace(self, moment=moment, inertia=inertia)

    def reweighed(self, masses: Array, inertias: Array) -> "Chain":
        """With links that are heavier, and turn more heavily about their centres of mass, by these shares [n]."""
        more = masses * self.mass
        beyond = np.concatenate((np.cumsum(more[::-1])[::-1][1:], [0.0]))
        arms = self.mass * self.centre**2
        own = self.own + masses * arms + inertias * (self.own - arms)
        return replace(
            self,
            moment=self.moment + more * self.centre + self.length * beyond,
            inertia=self.inertia + own - self.own + self.length**2 * beyond,
            own=own,
            mass=self.mass + more,
        )

    def rows(self) -> Array:
        """[10 n + 4] of `laws.chain`, without what no model has: a give is 1."""
        rows = np.zeros((law.EACH, self.n))
        rows[law.MOMENT], rows[law.INERTIA], rows[law.LENGTH] = self.moment, self.inertia, self.length
        rows[law.CENTRE], rows[law.VISCOUS], rows[law.DRY] = self.centre, self.viscous, self.dry
        rows[law.GIVE], rows[law.ARMATURE], rows[law.GAIN] = 1.0, self.armature, 1.0
        rest = np.zeros(law.ALL)
        rest[law.DOWN] = self.gravity
        return np.concatenate((rows.ravel(), rest))


def chain_of(stage: TableStage) -> Chain:
    """A stage's model. Raises TrialError for what it lacks."""
    model = stage.model
    given = [name for name in _INERTIAS if name in model]
    lacking = [name for name in _MASSES if name not in model] + ([] if given else [" or ".join(_INERTIAS)])
    if lacking:
        raise TrialError(
            f"{stage.name}: model lacks {', '.join(lacking)}; a {stage.kind} needs {', '.join(_MASSES)} and an inertia"
        )
    mass, centre = (np.ravel(np.asarray(model[name], dtype=float)) for name in _MASSES)
    n = len(mass)
    own = _each(stage, given[0], n) + (mass * centre**2 if given[0] == "inertia_kg_m2" else 0.0)
    length, lengths = np.zeros(n), np.ravel(np.asarray(model.get("length_m", ()), dtype=float))
    if len(lengths) < n - 1:
        raise TrialError(f"{stage.name}: model.length_m has {len(lengths)} numbers, {n} links need {n - 1}; add them")
    length[: min(n, len(lengths))] = lengths[:n]
    beyond = np.concatenate((np.cumsum(mass[::-1])[::-1][1:], [0.0]))  # mass that hangs from each link
    return Chain(
        moment=mass * centre + length * beyond,
        inertia=own + length**2 * beyond,
        length=length,
        centre=centre,
        own=own,
        viscous=_each(stage, "damping_nm_s_rad", n),
        dry=_each(stage, "coulomb_nm", n),
        armature=_each(stage, "armature_kg_m2", n),
        mass=mass,
        gravity=float(np.ravel(model.get("gravity_m_s2", GRAVITY_M_S2))[0]),
        relative=stage.relative,
    )


def _each(stage: TableStage, name: str, n: int) -> Array:
    """A key's numbers, one a link; a single one stands for all."""
    values = np.ravel(np.asarray(stage.model.get(name, 0.0), dtype=float))
    if len(values) not in (1, n):
        raise TrialError(f"{stage.name}: model.{name} has {len(values)} numbers for {n} links; give one, or one a link")
    return np.array(np.broadcast_to(values, n))


def absolute(chain: Chain, values: Array) -> Array:
    """[..., n] measured angles or rates as angles from the vertical."""
    return np.cumsum(values, axis=-1) if chain.relative else values


def measured(chain: Chain, values: Array) -> Array:
    """The other way."""
    return np.diff(values, axis=-1, prepend=0.0) if chain.relative else values


def joints(values: Array) -> Array:
    """[..., n] absolute angles or rates to those of the joints."""
    return np.diff(values, axis=-1, prepend=0.0)


def periods_seen(angle: Array, rate: Array) -> float:
    """How long a swing of the fastest link takes in the data, s: 2 pi times the spread of angles [T, n] over rates'."""
    spread, speed = np.nanstd(angle, axis=0), np.nanstd(rate, axis=0)
    moved = speed > 0
    return float(np.min(2 * math.pi * spread[moved] / speed[moved], initial=10.0))
