"""Predict a held-out recording of a real SO-101 arm: with the public model, with rivals' fits and with the diagnosis.

mujoco.sysid fits 25 parameters that are chosen here: position gain, damping, dry friction and armature of six joints,
and one delay of all sensors. Its gains start at 40 N m/rad, near those of the servos; from the model's own 998 it ends
far from the recordings. PACE's objective fits its own 25 parameters, with the model's gains, and 31 with gains. The
diagnosis starts from the model and chooses its effects; its best fit is used (`--best-fit`). All learn from the same
four recordings. The fifth is then simulated freely from its first positions, all joints at once. Needs the extra
`mujoco` and `pip install 'mujoco[sysid]' cma`.

    python -m benchmarks.real_arm --data FOLDER --json FILE
"""

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import mujoco
import numpy as np
from mujoco import sysid
from numpy.typing import NDArray

from benchmarks import pace, results
from benchmarks.arm_recordings import Recording, joints_of, recording_of, recordings
from softarm.common.processes import cores
from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.diagnose import diagnose
from softarm.diagnosis.rigs.mjcf.patch import patched
from softarm.diagnosis.rigs.mjcf.runtime import RuntimeEffects, Simulation
from softarm.schemas.verdict import Verdict

STAGE = Path(__file__).parent.parent / "softarm/diagnosis/rigs/stages/so101-mujoco.yaml"
MODEL = "so101-model/so101.xml"
# Bounds of mujoco.sysid's parameters: N m/rad, N m s/rad, N m, kg m^2, and s.
BOUNDS = {"kp": (5.0, 1500.0), "damping": (0.0, 10.0), "frictionloss": (0.0, 2.0), "armature": (0.001, 0.3)}
DELAY_S = (0.0, 0.2)
KP_START, DELAY_START_S = 40.0, 0.02
ITERATIONS = 20  # the last ones lower the cost by less than 0.1 %
RIVALS = "sysid", "pace", "pace_gains"
MODELS = "public", *RIVALS, "diagnosis"

Array = NDArray[np.float64]


def simulated(recording: Recording, model: Any, effects: RuntimeEffects | None = None, delay_s: float = 0.0) -> Array:
    """Return the readings of all joints at the measured stamps, [M, J].

    Args:
        recording: commands, and positions to start at.
        model: MuJoCo model.
        effects: effects that the model cannot hold.
        delay_s: delay of all readings.
    """
    data = mujoco.MjData(model)
    steps, commands = _grid(recording, model)
    data.qpos[:], data.ctrl[:] = recording.measured[0], commands[0]
    read = np.empty((len(steps), model.nu))
    read[0] = recording.measured[0]
    robot = Simulation(effects, model, data) if effects is not None else None
    for k in range(1, len(steps)):
        if robot is None:
            data.ctrl[:] = commands[k - 1]
            mujoco.mj_step(model, data)
            read[k] = data.qpos
        else:
            robot.step(commands[k - 1])
            read[k] = robot.readings
    seen_s = recording.measured_s - delay_s
    return np.stack([np.interp(seen_s, steps, column) for column in read.T], axis=1)


def fitted(training: Sequence[Recording], path: Path) -> tuple[Any, dict[str, float]]:
    """Return mujoco.sysid's model and its parameters by name."""
    spec = mujoco.MjSpec.from_file(str(path))
    nominal = spec.compile()
    parameters = sysid.ParameterDict()
    for i, name in enumerate(joints_of(nominal)):
        spec.add_sensor(
            name=f"{name}_pos",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
        starts = {
            "kp": KP_START,
            "damping": nominal.dof_damping[i] - nominal.actuator(name).biasprm[2],  # with that of the actuator
            "frictionloss": nominal.dof_frictionloss[i],
            "armature": nominal.dof_armature[i],
        }
        for what, (low, high) in BOUNDS.items():
            modifier = _setter(name, what)
            parameters.add(sysid.Parameter(f"{name}.{what}", float(starts[what]), low, high, modifier=modifier))
    parameters.add(sysid.Parameter("delay", DELAY_START_S, *DELAY_S))
    signals = sysid.SignalTransform()
    signals.delay("*", parameters["delay"])
    model = spec.compile()
    sequences = sysid.ModelSequences(
        "so101",
        spec,
        [each.name for each in training],
        [sysid.create_initial_state(model, each.measured[0]) for each in training],
        [sysid.TimeSeries.from_control_names(*_grid(each, model), model) for each in training],
        [sysid.TimeSeries.from_names(each.measured_s, each.measured, model) for each in training],
    )
    residual = sysid.build_residual_fn(models_sequences=[sequences], modify_residual=signals.apply, n_threads=cores())
    best, _ = sysid.optimize(parameters, residual, verbose=False, x_scale="jac", max_iters=ITERATIONS)
    return sysid.apply_param_modifiers(best, spec), {name: float(each.value[0]) for name, each in best.items()}


def _grid(recording: Recording, model: Any) -> tuple[Array, Array]:
    """Return times and held commands at the model's time step; sysid interpolates between its samples."""
    times = np.arange(int(recording.measured_s[-1] / model.opt.timestep) + 2) * model.opt.timestep
    return times, recording.held(times)


def _setter(joint: str, what: str) -> Callable[[Any, Any], None]:
    """Return a function that sets one parameter of a joint in a model's specification."""

    def set_value(spec: Any, parameter: Any) -> None:
        value = float(parameter.value[0])
        if what == "kp":
            sysid.apply_pgain(spec, joint, value)
        elif what == "damping":
            sysid.apply_dgain(spec, joint, 0.0)
            spec.joint(joint).damping[0] = value  # the linear term of a polynomial
        else:
            setattr(spec.joint(joint), what, value)

    return set_value


def diagnosed(trials: Sequence[Trial], path: Path, budget_s: float) -> tuple[Any, RuntimeEffects, Verdict]:
    """Return the model with the best fits of the diagnosis, the effects beside it, and the verdict."""
    verdict = diagnose(trials, processes=cores(), budget_s=budget_s).verdict
    patch = patched(path, verdict, calibration=True, best_fit=True)
    with TemporaryDirectory() as folder:
        model, answer = Path(folder) / "patched.xml", Path(folder) / "verdict.json"
        model.write_text(path.read_text() if patch is None else patch.text)
        answer.write_text(verdict.model_dump_json())
        return mujoco.MjModel.from_xml_path(str(model)), RuntimeEffects.read(answer, model, best_fit=True), verdict


def compare(
    held_out: str, trials: Sequence[Trial], path: Path, budget_s: float, before: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the errors of all models on a held-out recording by joint, rad, and the seconds of the fits.

    Args:
        held_out: name of the recording.
        trials: trials of all recordings.
        path: public model.
        budget_s: processor time of the diagnosis, s.
        before: an earlier result, whose figures of the rivals are taken; those that it lacks are measured.
    """
    public = mujoco.MjModel.from_xml_path(str(path))
    joints = joints_of(public)
    training = {each.name: each for each in recordings(trials, joints)}
    last = training.pop(held_out)

    def errors(readings: Array) -> Mapping[str, float]:
        rms = np.sqrt(np.mean((readings - last.measured) ** 2, axis=0))
        return dict(zip(joints, map(float, rms), strict=True))

    begun = _times()
    own, effects, verdict = diagnosed([t for t in trials if recording_of(t) != held_out], path, budget_s)
    diagnosis_s = _since(begun)
    figures = {
        "public_rad": errors(simulated(last, public)),
        "diagnosis_rad": errors(simulated(last, own, effects)),
        "diagnosis_effects": [effect.name for effect in verdict.effects],
        "best_fit": sorted({path.rpartition(".")[0] for fit in verdict.best_fit.values() for path in fit.parameters}),
        "diagnosis_s": diagnosis_s,
    }
    for rival in RIVALS:
        keys = [f"{rival}_{what}" for what in ("rad", "parameters", "s")]
        if keys[0] in before:
            figures |= {key: before[key] for key in keys}
            continue
        begun, still = _times(), np.zeros(len(joints))
        if rival == "sysid":
            model, parameters = fitted([*training.values()], path)
            fit = pace.Fit(model, still, parameters["delay"], parameters)
        else:
            fit = pace.fitted([*training.values()], public, gains=rival == "pace_gains")
        seconds = _since(begun)
        moved = last._replace(command=last.command - fit.zeros, measured=last.measured - fit.zeros)
        read = simulated(moved, fit.model, delay_s=fit.delay_s) + fit.zeros
        figures |= dict(zip(keys, (errors(read), fit.parameters, seconds), strict=True))
    return figures


def _times() -> tuple[float, float]:
    """Return a time, and the processor time of this process and its finished children, s."""
    return time.perf_counter(), sum(os.times()[:4])


def _since(begun: tuple[float, float]) -> dict[str, float]:
    """Return the wall and processor time since a moment, s."""
    return {name: end - start for name, start, end in zip(("wall", "processor"), begun, _times(), strict=True)}


@click.command()
@click.option("--data", type=click.Path(path_type=Path, exists=True), default=Path("../shared/data"), show_default=True)
@click.option("--hold-out", "held", multiple=True, metavar="NAME", help="Held-out recording; again for more.  [all]")
@click.option("--budget", "budget_s", default=120.0, show_default=True, help="Processor time of a diagnosis, s.")
@click.option("--rivals", "earlier", type=results.FILE, help="Take the figures of the rivals from this result.")
@results.json_option
def main(data: Path, held: tuple[str, ...], budget_s: float, earlier: Path | None, json_file: Path | None) -> None:
    """Compare the models on held-out recordings.

    \b
    Example:
      python -m benchmarks.real_arm --data FOLDER --hold-out multisine
    """
    trials = tables.read(STAGE, data)
    names = held or tuple(dict.fromkeys(map(recording_of, trials)))
    known = json.loads(earlier.read_text())["held_out"] if earlier is not None else {}
    found = {}
    for name in names:
        found[name] = row = compare(name, trials, data / MODEL, budget_s, known.get(name, {}))
        times = (f"{who} {row[f'{who}_s']['wall']:.0f} s" for who in (*RIVALS, "diagnosis"))
        click.echo(f"{name}: {', '.join(times)}")
        for joint in row["public_rad"]:
            shown = (f"{1000 * row[f'{who}_rad'][joint]:.0f}" for who in MODELS)
            click.echo(f"  {joint}: {', '.join(shown)} mrad")
    results.write(json_file, {"budget_s": budget_s, "held_out": found})


if __name__ == "__main__":
    main()
