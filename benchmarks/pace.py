"""Fit of a robot's joints as PACE does it (Bjelonic et al. 2025): CMA-ES on the error of free simulations.

Its parameters are armature, damping, dry friction and zero of each joint, and one delay of all commands. Position gains
are those of the model, since PACE takes a drive's gains as known; they may be fitted as well. PACE itself runs in Isaac
Sim; this is its objective in MuJoCo. Needs `pip install cma`.
"""

import copy
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import cma
import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from benchmarks.arm_recordings import Recording, joints_of
from softarm.common.processes import cores

# Bounds of the parameters: kg m^2, N m s/rad, N m, rad, N m/rad (in which steps are relative), and s.
BOUNDS = {"armature": (0.001, 0.3), "damping": (0.0, 10.0), "frictionloss": (0.0, 2.0), "zero": (-0.1, 0.1)}
GAIN, DELAY_S = (5.0, 1500.0), (0.0, 0.2)
# Simulated parts of each recording, and their length, s; evaluations; first standard deviation as a share of the
# bounds; and squared error of a simulation that diverges, rad^2.
PARTS, SECONDS, EVALUATIONS, SIGMA, DIVERGED = 4, 3.0, 3000, 0.2, 1e3

Array = NDArray[np.float64]


class Fit(NamedTuple):
    """Model with fitted parameters, the zeros of its joints, [J] rad, and the delay of all readings, s."""

    model: Any
    zeros: Array
    delay_s: float
    parameters: Mapping[str, float]


def fitted(training: Sequence[Recording], nominal: Any, gains: bool) -> Fit:
    """Return the best of EVALUATIONS sets of parameters.

    Args:
        training: recordings to fit.
        nominal: MuJoCo model, at whose values the search starts.
        gains: whether position gains are fitted, too.
    """
    joints, objective = joints_of(nominal), _Objective(training, nominal, gains)
    options = {"bounds": [0, 1], "seed": 1, "maxfevals": EVALUATIONS, "verbose": -9}
    search = cma.CMAEvolutionStrategy(objective.start, SIGMA, options)
    while not search.stop():
        candidates = search.ask()
        search.tell(candidates, objective(np.array(candidates)))
    best = objective.values(search.result.xbest)
    rows = {what: best[what] for what in objective.bounds}
    named = {f"{joint}.{what}": float(of[j]) for what, of in rows.items() for j, joint in enumerate(joints)}
    delay_s = float(best["delay"])
    return Fit(objective.model(best), best["zero"], delay_s, named | {"delay": delay_s})


class _Objective:
    """Mean squared error of all joints in free simulations, of parameters as shares of their bounds."""

    def __init__(self, training: Sequence[Recording], nominal: Any, gains: bool) -> None:
        self._nominal, self._joints = nominal, nominal.nu
        self.bounds = BOUNDS | ({"gain": GAIN} if gains else {})
        step_s, steps = nominal.opt.timestep, round(SECONDS / nominal.opt.timestep)
        self._times = np.arange(steps + 1) * step_s
        self._recordings = [
            each.part(start_s, self._times[-1])
            for each in training
            for start_s in np.linspace(0.0, each.measured_s[-1] - SECONDS, PARTS)
        ]
        self._command = np.stack([each.held(self._times[:-1]) for each in self._recordings])  # [R, S, J]
        self._rollout = rollout.Rollout(nthread=cores())
        self._data = [mujoco.MjData(nominal) for _ in range(cores())]
        self.start = self._start()

    def __call__(self, candidates: Array) -> list[float]:
        """Return the errors of candidates [P, N], rad^2."""
        found = [self.values(each) for each in candidates]
        models, states, commands = [], [], []
        for values in found:
            model = self.model(values)
            for recording, command in zip(self._recordings, self._command, strict=True):
                models.append(model)
                states.append(self._state(model, recording, values["zero"]))
                commands.append(command - values["zero"])
        seen = np.empty((len(models), len(self._times), self._joints))
        state, _ = self._rollout.rollout(models, self._data, np.array(states), np.array(commands))
        seen[:, 1:], seen[:, 0] = state[:, :, 1 : 1 + self._joints], np.array(states)[:, 1 : 1 + self._joints]
        each = seen.reshape(len(found), len(self._recordings), *seen.shape[1:])
        return [self._error(of, values) for of, values in zip(each, found, strict=True)]

    def values(self, shares: Array) -> dict[str, Array]:
        """Return parameters by their names, [J] each, and the delay."""
        rows = np.asarray(shares)[:-1].reshape(len(self.bounds), self._joints)
        found = {w: low + row * (high - low) for (w, (low, high)), row in zip(self.bounds.items(), rows, strict=True)}
        if "gain" in found:
            found["gain"] = GAIN[0] * (GAIN[1] / GAIN[0]) ** rows[-1]
        return found | {"delay": np.asarray(DELAY_S[0] + shares[-1] * (DELAY_S[1] - DELAY_S[0]))}

    def model(self, values: Mapping[str, Array]) -> Any:
        """Return the model with some parameters; its damping is that of joint and drive together."""
        model = copy.copy(self._nominal)
        model.dof_armature[:], model.dof_damping[:] = values["armature"], values["damping"]
        model.dof_frictionloss[:], model.actuator_biasprm[:, 2] = values["frictionloss"], 0.0
        if "gain" in values:
            model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1] = values["gain"], -values["gain"]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def _start(self) -> Array:
        """Return the model's own parameters as shares of their bounds, [N]."""
        m, zero = self._nominal, np.zeros(self._joints)
        damping = m.dof_damping - m.actuator_biasprm[:, 2]
        own = {"armature": m.dof_armature, "damping": damping, "frictionloss": m.dof_frictionloss, "zero": zero}
        shares = [(own[what] - low) / (high - low) for what, (low, high) in BOUNDS.items()]
        if "gain" in self.bounds:
            shares.append(np.log(m.actuator_gainprm[:, 0] / GAIN[0]) / np.log(GAIN[1] / GAIN[0]))
        return np.asarray(np.clip(np.concatenate([*shares, [0.1]]), 0.01, 0.99))

    def _state(self, model: Any, recording: Recording, zero: Array) -> Array:
        """Return the state of a model at the beginning of a recording."""
        data, kind = self._data[0], mujoco.mjtState.mjSTATE_FULLPHYSICS
        mujoco.mj_resetData(model, data)
        data.qpos[:] = recording.measured[0] - zero
        data.qvel[:] = (recording.measured[2] - recording.measured[0]) / recording.measured_s[2]
        state = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, state, kind)
        return state

    def _error(self, seen: Array, values: Mapping[str, Array]) -> float:
        """Return the mean squared error of simulated positions [R, S, J], without the longest delay."""
        squares = []
        for positions, recording in zip(seen, self._recordings, strict=True):
            at = recording.measured_s - values["delay"]
            read = np.stack([np.interp(at, self._times, column) for column in positions.T], axis=1) + values["zero"]
            squares.append(np.mean((read - recording.measured)[recording.measured_s > DELAY_S[1]] ** 2))
        found = float(np.mean(squares))
        return found if found < DIVERGED else DIVERGED  # also of NaN
