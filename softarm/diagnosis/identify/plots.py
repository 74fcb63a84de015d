"""Plots of an identification, like figures 9 and 10 of the paper."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from softarm.common.words import numbered
from softarm.diagnosis.identify.identify import Check, Identification
from softarm.diagnosis.identify.regression import modelled
from softarm.reporting.colours import LIGHT

MEASURED, SIMULATED = LIGHT["measured"], LIGHT["simulated"]


def save(result: Identification, folder: Path) -> list[Path]:
    """Write plots of the torques, the checks and the parameters, and return the files.

    Raises:
        OSError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures = {f"torques-{_file(name)}": _torques(result, i) for i, name in enumerate(numbered(result.trials))}
    checks = zip(numbered(check.trial for check in result.checks), result.checks, strict=True)
    figures |= {f"check-{_file(name)}": _check(check) for name, check in checks}
    figures["parameters"] = _parameters(result)
    paths = []
    for name, figure in figures.items():
        paths.append(folder / f"{name}.png")
        FigureCanvasAgg(figure).print_png(str(paths[-1]))
    return paths


def _file(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_. ()" else "-" for c in name)


def _torques(result: Identification, index: int) -> Figure:
    motion, torque = result.derivatives[index], result.regression.torque_nm[index]
    by_model = modelled(result.refinement.column, motion)
    figure = Figure(figsize=(9, 2 + 1.4 * torque.shape[1]), layout="constrained")
    axes = figure.subplots(torque.shape[1] + 1, 1, sharex=True)
    axes[0].plot(motion.t_s, motion.pressure_kpa, color="0.3", lw=0.8)
    axes[0].set_ylabel("pressure (kPa)")
    axes[0].set_title(f"{result.trials[index]}: torques by inverse dynamics (black) and fitted (purple)")
    for i, axis in enumerate(axes[1:]):
        axis.plot(motion.t_s, torque[:, i], color=MEASURED, lw=0.8)
        axis.plot(motion.t_s, by_model[:, i], color=SIMULATED, lw=0.8)
        axis.set_ylabel(f"joint {i + 1} (N m)")
    axes[-1].set_xlabel("time (s)")
    return figure


def _check(check: Check) -> Figure:
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    for i, axis in enumerate(axes):
        axis.plot(check.t_s, 100 * check.measured_m[:, i], color=MEASURED, lw=0.8, label="measured")
        axis.plot(check.t_s, 100 * check.simulated_m[:, i], color=SIMULATED, lw=0.8, label="simulated")
        axis.set_ylabel(f"tip {'yz'[i]} from the hinge (cm)")
        axis.set_title(f"RMS error {1e3 * check.rmse_m[i]:.2f} mm", fontsize="small", loc="right")
    axes[0].set_title(f"{check.trial}: an excitation that no fit has seen", loc="left")
    axes[0].legend(loc="upper right", fontsize="small")
    axes[1].set_xlabel("time (s)")
    return figure


def _parameters(result: Identification) -> Figure:
    n = result.model.arm.links
    figure = Figure(figsize=(9, 2.6), layout="constrained")
    for part, axis in enumerate(figure.subplots(1, 4)):
        chosen = slice(part * n, (part + 1) * n)
        fitted = result.refinement
        value, joints = fitted.column[chosen], np.arange(1, n + 1)
        spread = np.abs(np.stack((value - fitted.low[chosen], fitted.high[chosen] - value)))
        axis.errorbar(joints, value, spread, fmt="o", color=SIMULATED, capsize=3, ms=4)
        axis.plot(joints, result.regression.column[chosen], "x", color=MEASURED, ms=5)
        axis.set_title(
            ("stiffness (N m/rad)", "damping (N m s/rad)", "gain (N m/kPa)", "offset (N m)")[part], fontsize="small"
        )
        axis.set_xlabel("joint")
    figure.suptitle("regression (x), refined with 95 % interval (o)", fontsize="small")
    return figure
