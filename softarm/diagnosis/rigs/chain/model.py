"""Nominal model of a chain from its stage.yaml: masses, lengths, inertias, friction and the derived scales."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh

from softarm.diagnosis.data.trials import TableStage
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.laws import chain as law

GRAVITY_M_S2 = 9.81
# Share of gravity below which a chain does not swing by its weight.
WEIGHTLESS = 1e-3


@dataclass(frozen=True, slots=True)
class Chain:
    """Model of n links; arrays [n] go from the base outwards, by link or by the joint that the link hangs from."""

    moment: Array  # mass times arm of the link and of all that hangs from its end, kg m
    inertia: Array  # about the joint, likewise, kg m^2
    length: Array  # to the next joint, m; 0 for a last length that is not given
    centre: Array  # from the joint to the centre of mass, m
    own: Array  # inertia of the link alone about its joint, kg m^2
    viscous: Array  # viscous friction, N m s/rad
    dry: Array  # dry friction, N m
    armature: Array  # inertia of the motor behind its gear, kg m^2
    mass: Array  # kg
    gravity: float  # m/s^2
    relative: bool  # angles are measured from link to link

    @property
    def n(self) -> int:
        """Number of links and of joints."""
        return len(self.moment)

    @property
    def weight_nm(self) -> Array:
        """Torque of each joint with all links horizontal, N m [n]."""
        return self.gravity * np.cumsum(self.moment[::-1])[::-1]

    @property
    def still_inertia(self) -> Array:
        """Inertia matrix of the chain hanging straight, in absolute angles, kg m^2 [n, n]."""
        matrix = np.diag(self.inertia.astype(float))
        for i in range(self.n):
            for j in range(i):
                matrix[i, j] = matrix[j, i] = self.length[j] * self.moment[i]
        turns = np.eye(self.n) - np.eye(self.n, k=-1)
        return np.asarray(matrix + turns.T @ np.diag(self.armature) @ turns)

    @property
    def joint_inertia(self) -> Array:
        """Inertia that each joint's motor moves while the other joints are free, kg m^2 [n]."""
        turns = np.linalg.inv(np.eye(self.n) - np.eye(self.n, k=-1))  # relative angles to absolute
        return np.asarray(1 / np.diag(np.linalg.inv(turns.T @ self.still_inertia @ turns)))

    @property
    def periods_s(self) -> Array:
        """Periods of the small swings, the slowest first, s [n]; empty without gravity."""
        if self.gravity < WEIGHTLESS * GRAVITY_M_S2 or not (self.moment > 0).all():
            return np.empty(0)
        squares = eigh(np.diag(self.gravity * self.moment), self.still_inertia, eigvals_only=True)
        return np.asarray(2 * math.pi / np.sqrt(squares))

    def loaded(self, mass_kg: float) -> "Chain":
        """Return the chain with a point mass at the end of its last link."""
        moment, inertia = self.moment + mass_kg * self.length, self.inertia + mass_kg * self.length**2
        return replace(self, moment=moment, inertia=inertia)

    def reweighed(self, masses: Array, inertias: Array) -> "Chain":
        """Return the chain with masses, and inertias about the centres of mass, larger by these shares [n]."""
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
        """Return the law's parameters for `laws.chain`, [10 n + 4]; the give is 1."""
        rows = np.zeros((law.EACH, self.n))
        rows[law.MOMENT], rows[law.INERTIA], rows[law.LENGTH] = self.moment, self.inertia, self.length
        rows[law.CENTRE], rows[law.VISCOUS], rows[law.DRY] = self.centre, self.viscous, self.dry
        rows[law.GIVE], rows[law.ARMATURE], rows[law.GAIN] = 1.0, self.armature, 1.0
        rest = np.zeros(law.ALL)
        rest[law.DOWN] = self.gravity
        return np.concatenate((rows.ravel(), rest))


def chain_of(stage: TableStage) -> Chain:
    """Return the model of a stage."""
    model = stage.model
    mass, centre = (np.ravel(np.asarray(model[name], dtype=float)) for name in ("mass_kg", "centre_m"))
    n = len(mass)
    if "inertia_kg_m2" in model:
        own = _each(stage, "inertia_kg_m2", n) + mass * centre**2
    else:
        own = _each(stage, "inertia_joint_kg_m2", n)
    length, lengths = np.zeros(n), np.ravel(np.asarray(model.get("length_m", ()), dtype=float))
    length[: min(n, len(lengths))] = lengths[:n]
    beyond = np.concatenate((np.cumsum(mass[::-1])[::-1][1:], [0.0]))  # mass beyond each link
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
        gravity=stage.number("gravity_m_s2", GRAVITY_M_S2),
        relative=stage.relative,
    )


def _each(stage: TableStage, name: str, n: int) -> Array:
    """Values of a key, one per link; a single value holds for all links."""
    return np.array(np.broadcast_to(np.ravel(np.asarray(stage.model.get(name, 0.0), dtype=float)), n))


def absolute(chain: Chain, values: Array) -> Array:
    """Return measured angles or rates [..., n] as absolute ones, from the vertical."""
    return np.cumsum(values, axis=-1) if chain.relative else values


def measured(chain: Chain, values: Array) -> Array:
    """Return absolute angles or rates [..., n] as they are measured."""
    return np.diff(values, axis=-1, prepend=0.0) if chain.relative else values


def joints(values: Array) -> Array:
    """Return the joints' angles or rates from absolute ones [..., n]."""
    return np.diff(values, axis=-1, prepend=0.0)


def periods_seen(angle: Array, rate: Array) -> float:
    """Return the period of the fastest link in the data, s, from the spread of angles and rates [T, n]."""
    spread, speed = np.nanstd(angle, axis=0), np.nanstd(rate, axis=0)
    moved = speed > 0
    return float(np.min(2 * math.pi * spread[moved] / speed[moved], initial=10.0))
