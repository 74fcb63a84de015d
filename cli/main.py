"""The `softarm` command. A verb's module is imported when the verb is used; help imports none."""

import click

from softarm.cli.errors import EXITS
from softarm.cli.lazy_group import LazyGroup, Verb

VERBS: dict[str, dict[str, Verb]] = {
    "Run": {
        "demo": Verb("demo:demo", "Twin, daemon and ten targets over REST, in one go.", "sim"),
        "run": Verb("run:run", "Run the control daemon, on the robot or simulated.", "sim"),
        "twin": Verb("twin:twin", "Be the robot as the wires see it.", "sim"),
        "rail": Verb("rail:rail", "Find the axis's zero, and the middle of the rail."),
        "bridge": Verb("bridge:bridge", "Motion capture's frames to the daemon; calibrate it."),
        "config": Verb("config:config", "Write a new configuration; look up its keys."),
        "doctor": Verb("doctor:doctor", "What stands between this computer and a flying arm."),
        "service": Verb("service:service", "The daemon as a service of this computer."),
        "check": Verb("check:check", "Check a configuration and print the limits in force."),
    },
    "Ask the running daemon": {
        "status": Verb("status:status", "What the arm is doing and what is wrong."),
        "arm": Verb("arming:arm", "Give the daemon the actuators."),
        "disarm": Verb("arming:disarm", "Brake, vent and switch the drive off."),
        "stop": Verb("arming:stop", "Emergency stop; latched until acknowledged."),
        "acknowledge": Verb("arming:acknowledge", "Release a latched emergency stop."),
        "goal": Verb("goal:goal", "Reach for a target, run, hold, or cancel."),
        "policy": Verb("policy:policy", "List the policies, choose one."),
        "events": Verb("events:events", "What happened, and who asked for it."),
        "incidents": Verb("incidents:incidents", "The files of emergency stops; fetch one."),
        "logs": Verb("logs:logs", "List the recordings; export and mend them."),
        "view": Verb("view:view", "Play a recording in the browser."),
        "replay": Verb("replay:replay", "Run a recording through the tick again and compare."),
    },
    "Identify": {
        "excite": Verb("excite:excite", "Play an excitation, on the robot or simulated, and record.", "sim"),
        "identify": Verb("identify:identify", "Fit the arm's parameters to recordings.", "diagnosis"),
        "diagnose": Verb("diagnose:diagnose", "Name the effect behind the gap to the simulator.", "diagnosis"),
        "blind": Verb("blind:blind", "Measure the diagnosis on robots with sealed faults.", "mujoco"),
        "close-gap": Verb(
            "close_gap:close_gap", "Diagnose, patch the model, retrain, prove it.", "diagnosis,train,mujoco"
        ),
    },
    "Learn and measure": {
        "train": Verb("train:train", "Train a policy in the simulator.", "train"),
        "export": Verb("export:export", "Write a checkpoint as an ONNX policy.", "train"),
        "plan": Verb("plan:plan", "Optimise trajectories for the policy that tracks them.", "sim"),
        "soak": Verb("soak:soak", "Fly for hours; tell what grows and what happens.", "sim"),
        "evaluate": Verb("evaluate:evaluate", "Fly the test targets, by the daemon's own tick.", "sim"),
        "model": Verb("model:model", "Show, compare, check and export models of the robot."),
        "new": Verb("new:new", "Begin a plugin: a policy, a task, a mocap source.", "train"),
    },
}


EPILOGUE = "\b\nExit codes:\n" + "\n".join(f"  {code:<4} {meaning}" for code, meaning in EXITS.items())


@click.group(cls=LazyGroup, sections=VERBS, context_settings={"help_option_names": ["-h", "--help"]}, epilog=EPILOGUE)
@click.version_option(package_name="softarm")
@click.option(
    "--debug", is_flag=True, envvar="SOFTARM_DEBUG", help="Show the traceback of a defect ($SOFTARM_DEBUG=1)."
)
def main(debug: bool) -> None:
    """Control, simulation and training for a dynamic soft robot arm on a rail.

    \b
    Examples:
      softarm demo                               everything at once, on the twin
      softarm run --simulated                    a daemon without hardware; then, beside it:
      softarm arm && softarm goal reach -0.2 0.6 --wait
    """


if __name__ == "__main__":
    main()
