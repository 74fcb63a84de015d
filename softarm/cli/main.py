"""The `softarm` command. A verb's module is imported when the verb is used; help imports none."""

import click

from softarm.cli.groups import LazyGroup, Verb
from softarm.cli.shared.errors import EXITS

VERBS: dict[str, dict[str, Verb]] = {
    "Run": {
        "demo": Verb("operate.demo:demo", "Twin, daemon and ten targets over REST, in one go.", "sim"),
        "run": Verb("operate.run:run", "Run the control daemon, on the robot or simulated.", "sim"),
        "twin": Verb("operate.twin:twin", "Simulate the robot behind its real interfaces.", "sim"),
        "rail": Verb("rail:rail", "Home the axis, and find the middle of the rail."),
        "bridge": Verb("bridge:bridge", "Pass on motion capture to the daemon; calibrate it."),
        "config": Verb("setup.config:config", "Write a new configuration; look up its keys."),
        "doctor": Verb("setup.doctor:doctor", "Check this computer before a flight."),
        "service": Verb("setup.service:service", "Install the daemon as a service."),
        "check": Verb("setup.check:check", "Check a configuration; print what differs from the default."),
    },
    "Ask the running daemon": {
        "status": Verb("operate.status:status", "Show the state of the arm and its faults."),
        "arm": Verb("operate.arming:arm", "Enable the actuators."),
        "disarm": Verb("operate.arming:disarm", "Brake, vent and switch the drive off."),
        "stop": Verb("operate.arming:stop", "Emergency stop; latched until acknowledged."),
        "acknowledge": Verb("operate.arming:acknowledge", "Release a latched emergency stop."),
        "goal": Verb("operate.goal:goal", "Reach for a target, run, hold, or cancel."),
        "policy": Verb("operate.policy:policy", "List the policies or choose one."),
        "events": Verb("recordings.events:events", "Show the events."),
    },
    "Look at recordings": {
        "logs": Verb("recordings.logs:logs", "List, show, play, replay, export and repair recordings."),
        "incidents": Verb("recordings.events:incidents", "List or fetch incident files of stops."),
    },
    "Identify": {
        "excite": Verb("gap.excite:excite", "Play an excitation, on the robot or simulated, and record.", "sim"),
        "identify": Verb("gap.identify:identify", "Fit the arm's parameters to recordings.", "diagnosis"),
        "diagnose": Verb("gap.diagnose:diagnose", "Name the effects behind the gap to the simulator.", "diagnosis"),
        "close-gap": Verb(
            "gap.close_gap:close_gap", "Diagnose, patch the model, retrain, compare.", "diagnosis,train,mujoco"
        ),
    },
    "Learn and measure": {
        "train": Verb("learn.train:train", "Train a policy in the simulator.", "train"),
        "evaluate": Verb("learn.evaluate:evaluate", "Compare policies at the test targets.", "sim"),
        "model": Verb("learn.model:model", "Show, compare, check and export models of the robot."),
        "new": Verb("learn.new:new", "Create a plug-in, or the stage file of a rig.", "train"),
        "dev": Verb("dev:dev", "Tools of softarm's makers; `softarm dev` lists them.", "train"),
    },
}
EPILOGUE = "\b\nExit codes:\n" + "\n".join(f"  {code:<4} {meaning}" for code, meaning in EXITS.items())


@click.group(
    cls=LazyGroup,
    sections=VERBS,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=EPILOGUE,
)
@click.version_option(package_name="softarm")
@click.option(
    "--debug", is_flag=True, envvar="SOFTARM_DEBUG", help="Show the traceback of a defect ($SOFTARM_DEBUG=1)."
)
def main(debug: bool) -> None:
    """Control, simulation and training for a dynamic soft robot arm on a rail.

    \b
    Examples:
      softarm demo                               everything at once, on the twin
      softarm run --simulated                    a daemon without hardware; then, in another terminal:
      softarm arm && softarm goal reach -0.2 0.6 --wait
    """


if __name__ == "__main__":
    main()
