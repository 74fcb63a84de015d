"""`softarm excite`: play an excitation through the daemon, on the robot or a simulated one, and record."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.options import FILE, config_option, flown_model, model_option

if TYPE_CHECKING:
    from softarm.daemon.shell.daemon import Daemon
    from softarm.schemas.config import Config
    from softarm.schemas.goals import GoalStatus

_POLL_S = 0.1
_ARMING_S = 10.0  # drivers connect, mocap is seen, drive and regulator arm


@click.command()
@click.argument("name", required=False)
@config_option
@click.option("--simulated", is_flag=True, help="A robot simulated in this process, as fast as it will go.")
@model_option
@click.option("--plan", type=FILE, help="Play what a diagnosis asks for next: its verdict.json.")
@click.option("--list", "show", is_flag=True, help="Show the excitations there are.")
def excite(
    name: str | None, config_file: Path | None, simulated: bool, model_file: Path | None, plan: Path | None, show: bool
) -> None:
    """Play the excitation NAME and record it: the arm is armed, moves, and is disarmed again.

    It is a policy like any other: safety filter, failsafe and recorder are the daemon's own, and while it plays
    the API answers, so `softarm stop` works. The cart is brought to the middle of the rail first.

    \b
    Examples:
      softarm excite --list
      softarm excite seed --config softarm.yaml        on the robot, about half a minute
      softarm excite rail-chirp --simulated            on a simulated one
      softarm excite --plan verdict.json --config softarm.yaml    the next experiment of `softarm diagnose`
    """
    from softarm.cli.errors import fail
    from softarm.daemon.api.auth import AuthError
    from softarm.daemon.api.server import ApiError
    from softarm.daemon.config import configuration
    from softarm.daemon.logbook.recorder import RecorderError
    from softarm.policies.base import PolicyError
    from softarm.policies.excite import Excite
    from softarm.schemas.config import Config
    from softarm.schemas.excitation import EXCITATIONS

    if show:
        for excitation in EXCITATIONS.values():
            click.echo(f"{excitation.name:20s} {excitation.duration_s:5.1f} s  {excitation.description}")
        return
    if plan is not None:
        if name is not None:
            raise click.UsageError("NAME or --plan, not both")
        name = _planned(plan)
    if name is None:
        raise click.UsageError("which excitation? `softarm excite --list` shows them")
    if config_file is None and not simulated:
        raise click.UsageError("which robot? --config FILE for real devices, or --simulated")
    if model_file is not None and not simulated:
        raise click.UsageError("--model is of the simulated robot: add --simulated")
    try:
        Excite.describe(name)
        config = configured(configuration.load(config_file) if config_file else Config(), name)
        if simulated:
            status, log = _play_simulated(config, name, model_file)
        else:
            status, log = _play(config, name)
    except (configuration.ConfigurationError, PolicyError, RecorderError, ApiError, AuthError, RuntimeError) as error:
        fail(str(error))
    if status.state != "reached":
        fail(f"{name} was not played to its end: {status.state}, {status.reason}; what there is lies in {log}")
    click.echo(f"played {name}, {status.time_s:.1f} s; recorded {log}" if log else f"played {name}; nothing recorded")
    if log is not None and plan is not None:
        click.echo(f"next: softarm diagnose RECORDING... {log} --json {plan}")
    elif log is not None:
        click.echo(f"next: softarm identify {log} --out model.yaml")


def _planned(plan: Path) -> str:
    """The excitation that a verdict asks for next. Ends the command with a sentence where there is none."""
    from pydantic import ValidationError

    from softarm.cli.errors import fail
    from softarm.schemas.verdict import Verdict

    try:
        verdict = Verdict.model_validate_json(plan.read_bytes())
    except OSError as error:
        fail(f"{plan}: cannot be read ({error.strerror}); name a file that `softarm diagnose --json` wrote")
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        fail(f"{plan}: {f'{where}: ' if where else ''}{first['msg']}; name a file that `softarm diagnose --json` wrote")
    if verdict.next_experiment is None:
        fail(f"{plan}: asks for no next experiment; name an excitation, `softarm excite --list` shows them")
    for effect, expected in verdict.next_experiment.expect.items():
        click.echo(f"if {effect}: {expected}")
    return verdict.next_experiment.excitation


def configured(config: "Config", name: str) -> "Config":
    """The configuration with the excitation as the policy in use."""
    from softarm.schemas.config import Policy

    policy = f"excite-{name}"
    return config.model_copy(
        update={
            "policies": {**config.policies, policy: Policy(plugin="excite", options={"excitation": name})},
            "control": config.control.model_copy(update={"policy": policy}),
        }
    )


def _play_simulated(config: "Config", name: str, model_file: Path | None) -> tuple["GoalStatus", Path | None]:
    """In lockstep: no sleeping, the same recording every time. Raises RuntimeError when it does not arm."""
    from dataclasses import replace

    from rich.progress import Progress

    from softarm.daemon.logbook.recorder import Recorder
    from softarm.daemon.shell.offline import Lockstep
    from softarm.policies.excite import Excite
    from softarm.schemas.goals import Goal

    model = flown_model(model_file)
    policy = Excite(name)
    policy.spec = replace(policy.spec, name=config.control.policy)
    recorder = Recorder(config, policy.spec)
    recorder.start()
    try:
        lockstep = Lockstep(config, policy, model, recorder)
        lockstep.arm()
        with Progress(transient=True) as bar:
            task = bar.add_task(f"playing {name}", total=policy.spec.episode_steps)
            outputs = lockstep.tick(lockstep.request("goal", Goal("run")))
            while outputs.goal.state == "running":
                outputs = lockstep.tick()
                bar.advance(task)
        status = outputs.goal
        lockstep.tick(lockstep.request("disarm"))
    finally:
        recorder.stop()
    return status, recorder.path


def _play(config: "Config", name: str) -> tuple["GoalStatus", Path | None]:
    """On the devices, in real time; Ctrl-C brakes and vents. Raises RuntimeError when it does not arm."""
    from rich.progress import Progress

    from softarm.daemon.shell.daemon import Daemon, real_devices
    from softarm.policies.excite import Excite
    from softarm.schemas.goals import Goal

    daemon = Daemon(config, real_devices(config))
    daemon.start()
    try:
        _arm(daemon)
        number = daemon.inbox.post("goal", goal=Goal("run"))
        length_s = (Excite.describe(name).episode_steps or 0) / config.control.rate_hz
        deadline_s = time.monotonic() + length_s + _ARMING_S
        with Progress(transient=True) as bar:
            task = bar.add_task(f"playing {name}", total=length_s)
            while (status := _goal(daemon, number)) is None or status.state == "running":
                bar.update(task, completed=0.0 if status is None else status.time_s)
                if time.monotonic() > deadline_s:
                    raise RuntimeError("the control loop has stalled; see its own output")
                time.sleep(_POLL_S)
        return status, daemon.recorder.path
    finally:
        daemon.stop()  # brakes, vents and switches off, whatever has happened


def _goal(daemon: "Daemon", number: int) -> "GoalStatus | None":
    """How the goal goes; None until the loop has taken the request. Raises RuntimeError when it is refused."""
    snapshot = daemon.loop.snapshot
    answer = next((r for r in snapshot.results if r.number == number), None) if snapshot else None
    if snapshot is None or answer is None:
        # Requests are answered in the order they came: a running goal is ours even when its answer is long gone.
        return snapshot.goal if snapshot and snapshot.goal.number else None
    if not answer.accepted:
        raise RuntimeError("; ".join(answer.reasons))
    return snapshot.goal


def _arm(daemon: "Daemon") -> None:
    """Wait until the daemon would arm, arm, and wait until it has. Raises RuntimeError with its own reasons."""
    deadline_s = time.monotonic() + _ARMING_S
    asked = False
    reasons: tuple[str, ...] = ("no control tick yet",)
    while time.monotonic() < deadline_s:
        if (snapshot := daemon.loop.snapshot) is not None:
            if snapshot.mode == "armed":
                return
            reasons = snapshot.arming_refusals or reasons
            if not snapshot.arming_refusals and not asked:
                daemon.inbox.post("arm")
                asked = True
        time.sleep(_POLL_S)
    raise RuntimeError(f"did not arm within {_ARMING_S:.0f} s: {'; '.join(reasons)}; then try again")
