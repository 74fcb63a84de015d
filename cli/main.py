"""The `softarm` command. A verb's module is imported when the verb is used; help imports none."""

import difflib
from importlib import import_module
from typing import Any, NamedTuple, NoReturn

import click

from softarm.cli.errors import fail


class Verb(NamedTuple):
    """Where a verb's click command is, and its line in `softarm --help`."""

    target: str  # module of `softarm.cli`:attribute
    help: str
    extra: str = ""  # the extra of the package that brings what it imports


VERBS: dict[str, dict[str, Verb]] = {
    "Run": {
        "demo": Verb("demo:demo", "Twin, daemon and ten targets over REST, in one go.", "sim"),
        "run": Verb("run:run", "Run the control daemon, on the robot or simulated.", "sim"),
        "twin": Verb("twin:twin", "Be the robot as the wires see it.", "sim"),
        "check": Verb("check:check", "Check a configuration and print the limits in force."),
    },
    "Ask the running daemon": {
        "status": Verb("status:status", "What the arm is doing and what is wrong."),
        "arm": Verb("arming:arm", "Give the daemon the actuators."),
        "disarm": Verb("arming:disarm", "Brake, vent and switch the drive off."),
        "stop": Verb("arming:stop", "Emergency stop; latched until acknowledged."),
        "acknowledge": Verb("arming:acknowledge", "Release a latched emergency stop."),
        "goal": Verb("goal:goal", "Reach for a target, hold, or cancel."),
        "policy": Verb("policy:policy", "List the policies, choose one."),
        "logs": Verb("logs:logs", "List the recordings."),
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
        "evaluate": Verb("evaluate:evaluate", "Fly the test targets, by the daemon's own tick.", "sim"),
        "model": Verb("model:model", "Show, compare, check and export models of the robot."),
    },
}
_ALL = {name: verb for section in VERBS.values() for name, verb in section.items()}


class LazyGroup(click.Group):
    """Commands by the table above."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the table's order."""
        return list(_ALL)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a verb's module and return its command."""
        if cmd_name not in _ALL:
            return None
        module, _, attribute = _ALL[cmd_name].target.partition(":")
        command = getattr(import_module(f"softarm.cli.{module}"), attribute)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb; a missing package and a misspelt name are told with what to do."""
        try:
            return super().resolve_command(ctx, args)
        except ModuleNotFoundError as error:
            _explain_missing(args[0], error)
        except click.UsageError:
            near = difflib.get_close_matches(args[0], _ALL, n=1)
            hint = f"did you mean '{near[0]}'?" if near else "`softarm --help` lists the verbs."
            raise click.UsageError(f"no verb '{args[0]}'; {hint}", ctx) from None

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb."""
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            _explain_missing(ctx.invoked_subcommand or "", error)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the verbs from the table, so that help imports nothing."""
        for title, section in VERBS.items():
            with formatter.section(title):
                formatter.write_dl([(name, verb.help) for name, verb in section.items()])


def _explain_missing(name: str, error: ModuleNotFoundError) -> NoReturn:
    """Turn a package that is not installed into a sentence; a module of our own that is missing is a bug."""
    package = (error.name or "").partition(".")[0]
    if package == "softarm":
        raise error
    extra = _ALL[name].extra if name in _ALL else ""
    fail(
        f"softarm {name} needs the package '{package}': "
        + (f"pip install 'softarm[{extra}]'" if extra else "install softarm again")
    )


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="softarm")
def main() -> None:
    """Control, simulation and training for a dynamic soft robot arm on a rail.

    \b
    Examples:
      softarm demo                               everything at once, on the twin
      softarm run --simulated                    a daemon without hardware; then, beside it:
      softarm arm && softarm goal reach -0.2 0.6 --wait
    """


if __name__ == "__main__":
    main()
