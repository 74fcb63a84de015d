"""Recordings of rigs, and the effects that a diagnosis names in them."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import yaml

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import Series, TableStage, Trial
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.rigs.candidates import candidates, nuisances
from softarm.diagnosis.rigs.diagnose import diagnose_table
from softarm.diagnosis.rigs.stage import view_of
from validation.mechanisms.cases import stage_text
from validation.mechanisms.record import ROBOTS, record, write

MECHANISM_KINDS = ("multisine", "holds", "multisine")

# Description of a servo in degrees, with the columns t, u and y.
SERVO = """
kind: tracking
channels:
  command: {time: {source: t, unit: s}, columns: {command: {source: u, unit: deg}}}
  measured: {time: {source: t, unit: s}, columns: {position: {source: y, unit: deg}}}
trials:
  - {files: "*.csv"}
"""


def recording(name, kind, t, channels, stage):
    """Return a recording; channels: channel -> column -> values [T]; stage: its arguments."""
    series = {c: Series(t.copy(), {n: np.array(x) for n, x in columns.items()}) for c, columns in channels.items()}
    return Trial(name, kind, Path(name), series, stage=TableStage(*stage))


def mechanism(folder, robot, truth, seconds=5.0, item=None):
    """Record three trials of a robot with its MuJoCo model and its stage.yaml; return the latter.

    item: body, place in its frame (m) and mass (kg) of a thing that the robot carries and its model lacks.
    """
    random, real = np.random.default_rng(3), ROBOTS[robot]
    if item is not None:
        body, (x, y, z), kg = item
        mass = f'<body pos="{x} {y} {z}"><inertial pos="0 0 0" mass="{kg}" diaginertia="1e-9 1e-9 1e-9"/></body>'
        text, real = real.model.read_text(), replace(real, name=str(folder / "carrying"))
        real.model.write_text(re.sub(rf'<body name="{body}".*>', lambda tag: tag[0] + mass, text))
    for number, kind in enumerate(MECHANISM_KINDS):
        write(record(real, truth, kind, seconds, random), folder / f"{kind}-{number}.csv")
    shutil.copy(ROBOTS[robot].model, folder / "robot.xml")
    (folder / "stage.yaml").write_text(stage_text(ROBOTS[robot]))
    return folder / "stage.yaml"


def described(folder, model, **channels):
    """Write the stage.yaml of a MuJoCo model and of tables with columns of its names, and return its path.

    model: the model's file in the folder. channels: channel -> column -> unit.
    """
    time = {"source": "t", "unit": "s"}
    stage = {
        "kind": "mujoco",
        "channels": {
            channel: {"time": time, "columns": {name: {"source": name, "unit": unit} for name, unit in columns.items()}}
            for channel, columns in channels.items()
        },
        "model": {"mjcf": model},
        "trials": [{"files": "*.csv"}],
    }
    (folder / "stage.yaml").write_text(yaml.safe_dump(stage))
    return folder / "stage.yaml"


def described_model(folder, text, unit="rad"):
    """Write a MuJoCo model and a stage.yaml with all its named joints and actuators, and return the latter's path.

    unit: of the commands.
    """
    (folder / "robot.xml").write_text(text)
    model = mujoco.MjModel.from_xml_string(text)
    measured, command = dict.fromkeys(names(model, "joint"), "rad"), dict.fromkeys(names(model, "actuator"), unit)
    return described(folder, "robot.xml", measured=measured, command=command)


def names(model, kind):
    """Return the names of all joints or actuators of a MuJoCo model; kind: "joint" or "actuator"."""
    count = {"joint": model.njnt, "actuator": model.nu}[kind]
    return [getattr(model, kind)(i).name for i in range(count)]


def simulate(model, file, commands, *, data=None, control=None, read=None, late=0, step_s=0.01):
    """Move a MuJoCo model and write time, commands and positions, with a column for each actuator and joint.

    Args:
        model: model of hinges and slides, or its text.
        commands: commands of the actuators, or input of `control`, [T, ...].
        data: state at the start; by default at rest.
        control: function of state and input -> commands; by default the input itself.
        read: function of the positions -> readings of the encoders; by default the positions themselves.
        late: samples by which the actuators receive their commands late.
        step_s: time between two rows, s.
    """
    model = mujoco.MjModel.from_xml_string(model) if isinstance(model, str) else model
    data, rows = data or mujoco.MjData(model), []
    for k, command in enumerate(commands):
        data.ctrl[:] = command if control is None else control(data, command)
        rows.append((k * step_s, *data.ctrl, *(data.qpos if read is None else read(data.qpos))))
        if late:
            data.ctrl[:] = commands[max(k - late, 0)]
        mujoco.mj_step(model, data, nstep=round(step_s / model.opt.timestep))
    header = ",".join(("t", *names(model, "actuator"), *names(model, "joint")))
    np.savetxt(file, rows, "%.8g", delimiter=",", header=header, comments="")


def recorded(folder, text, commands, *, noise_rad, change=None, trials=1, late=0):
    """Record a MuJoCo model with commands without a unit, and return the path of its stage.yaml.

    commands: function of a random generator -> commands, [T, ...]. change: function that makes the recorded robot
    differ from its model. late: samples by which the actuators receive their commands late.
    """
    robot = mujoco.MjModel.from_xml_string(text)
    if change is not None:
        change(robot)
    for number in range(trials):
        random = np.random.default_rng(number)
        simulate(robot, folder / f"run-{number}.csv", commands(random), read=noisy(random, noise_rad), late=late)
    return described_model(folder, text, "1")


def noisy(random, size):
    """Return an encoder's readings of positions: a function that adds noise of a size."""
    return lambda positions: positions + size * random.normal(size=len(positions))


def of_joint(stage, joint):
    """Return the trials of one joint of a stage.yaml."""
    return [trial for trial in tables.read(stage) if trial.stage.name == joint]


def view_of_joint(stage, joint):
    """Return the view of one joint of a stage.yaml."""
    return view_of(of_joint(stage, joint))[0]


def rms(view, point=None):
    """Return the root mean square of a view's gap, by default of its nominal model."""
    return float(np.sqrt(np.nanmean(view.gap([point or {}]) ** 2)))


def alone(view, kinds):
    """Fit every effect of a view alone; return the best fit of each by name, the best first, and the problem."""
    problem = Setup([view], nuisances(view), kinds).weighed()
    fits = problem.fit([((c,), (start,)) for c in candidates(view) for start in c.starts], 12)
    best = {}
    for fit in sorted(fits, key=lambda f: f.loss):
        best.setdefault(fit.names[0].partition(".")[2], fit)
    return best, problem


def named(trials):
    """Return the verdict on trials, and the values of the named effects' parameters."""
    verdict = diagnose_table(trials).verdict
    return verdict, {e.name.partition(".")[2]: {k: p.value for k, p in e.parameters.items()} for e in verdict.effects}


STAGES = Path(tables.__file__).parents[1] / "rigs" / "stages"


def shipped(stage, data):
    """Return the real trials of a shipped stage.yaml."""
    return tables.read(STAGES / stage, data)
