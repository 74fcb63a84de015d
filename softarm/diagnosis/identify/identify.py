"""System identification of the arm: regression of the paper, refinement by simulation, check on held-out trials."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.identify import bench, motion, refinement, regression
from softarm.diagnosis.identify.motion import Derivatives, Motion
from softarm.diagnosis.identify.refinement import PRESSURE_SPAN_KPA, Refinement
from softarm.diagnosis.identify.regression import Regression
from softarm.schemas.model import Model

Progress = Callable[[str], None]

WIDE = 0.10  # half interval of K, D or b that raises a warning, as a share of the value
MISPRINTED_SHELL_KG = 0.05  # [P] SM-B; its own total of 0.12 kg needs 0.005
TORQUE_RMSE_NM = 0.02  # reported by [P]
SAMPLES_MIN = 4  # of all trials: a joint has as many parameters
TIP_Y_M, TIP_Z_M = 0.02, 0.003
UNCHECKED = "no held-out excitation: name one with --check to measure the error on other motions"


class IdentifiedParameter(TypedDict):
    """Fitted parameter in the form of `--json`."""

    name: str
    start: float  # by regression
    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Check:
    """Held-out trial, simulated from its measured inputs."""

    trial: str
    t_s: Array  # [N]
    measured_m: Array  # [N, 2] tip y, z against the hinge
    simulated_m: Array  # [N, 2]
    compared: NDArray[np.bool_]

    @property
    def rmse_m(self) -> tuple[float, float]:
        """Return the RMS errors of the tip's y and z, m."""
        error = (self.measured_m - self.simulated_m)[self.compared]
        y, z = np.sqrt(np.mean(error**2, axis=0))
        return float(y), float(z)


@dataclass(frozen=True, slots=True)
class Identification:
    """Result of a system identification."""

    model: Model
    trials: tuple[str, ...]
    derivatives: tuple[Derivatives, ...]
    regression: Regression
    torque_rmse_nm: float  # of the final parameters
    refinement: Refinement
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def estimates(self) -> list[IdentifiedParameter]:
        """Return every fitted parameter with its 95 % interval."""
        names = bench.names(self.model.arm.links)
        fitted = self.refinement
        columns = (self.regression.column, fitted.column, fitted.low, fitted.high)
        return [
            IdentifiedParameter(name=name, start=float(s), value=float(v), low=float(lo), high=float(hi))
            for name, s, v, lo, hi in zip(names, *columns, strict=True)
        ]

    @property
    def joints(self) -> list[tuple[IdentifiedParameter, ...]]:
        """Return stiffness, damping, muscle gain and torque offset of each joint."""
        estimates, links = self.estimates, self.model.arm.links
        return [tuple(estimates[joint::links]) for joint in range(links)]

    def summary(self) -> dict[str, object]:
        """Return the result in the form of `softarm identify --json`."""
        return {
            "trials": list(self.trials),
            "parameters": self.estimates,
            "torque_rmse_nm": {"regression": self.regression.rmse_nm, "refined": self.torque_rmse_nm},
            "torque_range_nm": list(self.regression.range_nm),
            "link_end_rmse_m": {"before": self.refinement.rmse_before_m, "after": self.refinement.rmse_m},
            "checks": [
                {"trial": check.trial, "tip_rmse_y_m": check.rmse_m[0], "tip_rmse_z_m": check.rmse_m[1]}
                for check in self.checks
            ],
            "warnings": list(self.warnings),
        }


def identify(
    model: Model, trials: Sequence[Trial], unseen: Sequence[Trial] = (), on_progress: Progress = lambda text: None
) -> Identification:
    """Fit K, D, b and the offset to trials of the arm; masses and lengths are the model's.

    Args:
        model: model that supplies the other parameters.
        trials: trials to fit; a trial without mocap or pressure is left out with a warning.
        unseen: held-out trials that are only compared.
        on_progress: called with the current step.

    Raises:
        TrialError: no trial shows the arm, all are too short, or a trial is given for the fit and for the check.
    """
    _apart(trials, unseen)
    arm = model.arm
    motions, warnings = _motions(trials, arm.links)
    checked, more = _motions(unseen, arm.links) if unseen else ([], [UNCHECKED])
    warnings += more
    on_progress("torques by inverse dynamics, least squares")
    smooth = tuple(motion.derivatives(m) for m in motions)
    if (left := sum(len(each.t_s) for each in smooth)) < SAMPLES_MIN:
        raise TrialError(
            f"{', '.join(m.name for m in motions)}: {left} samples are {motion.EDGE_S:g} s away from both ends and "
            f"{motion.SETTLE_S:g} s behind a gap of over {motion.GAP_S:g} s; at least {SAMPLES_MIN} are needed; "
            "record longer, with frames closer together"
        )
    first = regression.fit(arm, smooth)
    start = first.column.copy()
    if max(float(np.ptp(m.pressure_kpa)) for m in motions) < PRESSURE_SPAN_KPA:
        gain = slice(2 * arm.links, 3 * arm.links)
        start[gain] = bench.to_columns(arm)[gain]  # without effect on any motion, so the refinement keeps it
        warnings.append(
            f"the pressure varies by less than {PRESSURE_SPAN_KPA:g} kPa: the muscle gain is not fitted and its "
            "interval is meaningless; add `seed` or another excitation of the muscle"
        )
    with threadpool_limits(1, "blas"):  # faster for small matrices
        refined = refinement.fit(
            arm, motions, start, lambda n, rmse: on_progress(f"refinement {n}: link ends within {rmse * 1e3:.3f} mm")
        )
    fitted = model.model_copy(update={"arm": bench.from_column(arm, refined.column)})
    checks = []
    for m in checked:
        on_progress(f"check on {m.name}")
        checks.append(_check(fitted, m))
    rmse = regression.rmse_nm(refined.column, smooth, first.torque_nm)
    warnings += _doubts(model, refined, rmse, checks)
    names = tuple(m.name for m in motions)
    return Identification(fitted, names, smooth, first, rmse, refined, tuple(checks), tuple(warnings))


def _apart(trials: Sequence[Trial], unseen: Sequence[Trial]) -> None:
    both = {t.source.resolve() for t in trials} & {t.source.resolve() for t in unseen if t.source.exists()}
    if both:
        names = ", ".join(str(path) for path in sorted(both))
        raise TrialError(f"{names}: given for the fit and for the check; give it once")


def _motions(trials: Sequence[Trial], links: int) -> tuple[list[Motion], list[str]]:
    motions: list[Motion] = []
    warnings: list[str] = []
    for trial in sorted(trials, key=lambda t: (t.name, str(t.source))):  # independent of their order
        warnings += trial.warnings
        if trial.stage is not None:
            raise TrialError(
                f"{trial.source}: a table of the stage {trial.stage.name}; identify needs trials of the whole arm"
            )
        if reason := trial.not_observable.get("arm"):
            warnings.append(f"{trial.name} was left out: {reason}; record mocap and the regulator's own sensor")
            continue
        motions.append(motion.measured(trial, links))
    if not motions:
        raise TrialError("no trial shows the arm: " + "; ".join(warnings or ["no trial was given"]))
    return motions, warnings


def _check(model: Model, seen: Motion) -> Check:
    n = model.arm.links
    tip = [n - 1, 2 * n - 1]
    simulated = refinement.follow(model.arm, seen)[:, tip].astype(float)
    return Check(seen.name, seen.t_s, seen.signals[:, tip], simulated, seen.compared)


def _doubts(model: Model, fitted: Refinement, rmse_nm: float, checks: Sequence[Check]) -> list[str]:
    """Return warnings about the result."""
    arm, n = model.arm, model.arm.links
    doubts = []
    if MISPRINTED_SHELL_KG in arm.link_mass_kg[:-1]:
        doubts.append(
            "a shell of 0.05 kg is a misprint in the paper's SM-B, whose total is 0.12 kg; use 0.005 kg, since "
            "stiffness, damping and gain scale with it"
        )
    if not fitted.converged:
        doubts.append(f"the refinement did not converge in {fitted.rounds} passes; start from a closer --model")
    half = (fitted.high - fitted.low) / 2
    wide = [
        f"{name} (+-{100 * h / abs(v):.0f} %)"
        for name, v, h in zip(bench.names(n)[: 3 * n], fitted.column[: 3 * n], half[: 3 * n], strict=True)
        if h > WIDE * abs(v)
    ]
    if wide:
        doubts.append(f"wide intervals: {', '.join(wide)}; add `rail-chirp`, `both` or a longer recording")
    if rmse_nm > TORQUE_RMSE_NM:
        doubts.append(f"torque error of {rmse_nm:.3f} N m RMS, 0.02 in the paper; check masses and units")
    for check in checks:
        y, z = check.rmse_m
        if y > TIP_Y_M or z > TIP_Z_M:
            doubts.append(
                f"{check.trial}: tip error of {y * 1e3:.0f} mm in y and {z * 1e3:.1f} mm in z, 20 and 3 in the paper; "
                "the model lacks an effect (`softarm diagnose`)"
            )
    return doubts
