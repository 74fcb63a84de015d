"""`softarm dev`: tools of softarm's makers."""

import shlex
import sys
import tempfile
from pathlib import Path

import click

from softarm.cli.gap.blind import blind
from softarm.cli.groups import Verbs
from softarm.cli.learn.plan import plan
from softarm.cli.shared.completion import policies
from softarm.cli.shared.console import FILE, FOLDER, check_places, json_option, waiting, write, write_json
from softarm.cli.shared.errors import NOTHING, fail, leaves


@click.command(short_help="Write a checkpoint as an ONNX policy.")
@click.argument("checkpoint", type=FILE)
@click.option("--out", type=FILE, required=True, help="The ONNX file to write.")
def export(checkpoint: Path, out: Path) -> None:
    """Write the policy of a training checkpoint (latest.pt or best.pt) as an ONNX file that describes itself.

    \b
    Example:
      softarm dev export runs/reach-1/best.pt --out my-reach.onnx
    """
    leaves(NOTHING)
    with waiting(f"reading {checkpoint}"):
        from softarm.training.record.export import export_checkpoint

        export_checkpoint(checkpoint, out)
    click.echo(f"wrote {out}")


@click.command(short_help="Fly for hours and report growth and events.")
@click.option("--hours", default=1.0, show_default=True, type=click.FloatRange(0), help="Real time; 0 for none.")
@click.option("--lockstep-days", default=0.0, show_default=True, type=click.FloatRange(0), help="Simulated time.")
@click.option("--seed", default=0, show_default=True, help="Seed of goals, faults and misbehaving clients.")
@click.option("--policy", default="reach", show_default=True, shell_complete=policies, help="Policy in lockstep.")
@json_option
@click.option("--report", type=FILE, help="Write the curves as one HTML file.")
@click.option("--allow-undecided", is_flag=True, help="Exit with 0 although the run was too short to decide on growth.")
@click.option("--logs", type=FOLDER, help="Keep the recordings in this folder.")
def soak(
    hours: float,
    lockstep_days: float,
    seed: int,
    policy: str,
    json_file: Path | None,
    report: Path | None,
    allow_undecided: bool,
    logs: Path | None,
) -> None:
    """Fly for hours, and report whether memory, descriptors, threads, logs, lateness or load grow.

    In real time, daemon and twin run as separate processes. The twin injects faults, clients of the API misbehave, and
    a script arms, sets goals, stops, acknowledges and changes policies. In lockstep, the control loop flies goals as
    fast as one core allows. Exit code 1 if something grows, if the run was too short to decide, or after an unexpected
    event: a stop without a fault, an error, or an answer that the client must not get.

    \b
    Examples:
      softarm dev soak --hours 1 --lockstep-days 3 --report soak.html --json soak.json
      softarm dev soak --hours 0 --lockstep-days 0.1
    """
    from softarm.common.processes import bar
    from softarm.evaluation.soak import lockstep, page

    if not hours and not lockstep_days:
        raise click.UsageError("nothing to do: give --hours, --lockstep-days, or both")
    check_places(json_file, report)
    recorded = "" if logs is None else f"; the recordings are in {logs}"
    leaves(f"twin and daemon have ended, without a result{recorded}")
    with tempfile.TemporaryDirectory(prefix="softarm-soak-") as folder:
        kept = Path(folder) if logs is None else logs
        kept.mkdir(parents=True, exist_ok=True)
        if any(kept.iterdir()):
            fail(f"--logs {kept}: is not empty, and its size is measured; name a new folder")
        with bar("soaking") as shown:
            real, stepped = lockstep.soak_both(hours, lockstep_days, seed, policy, kept, shown.report)
    write_json(json_file, page.figures(real, stepped))
    if report is not None:
        write(report, page.html(real, stepped, shlex.join(["softarm", *sys.argv[1:]])))
    problems = page.problems(real, stepped, with_undecided=not allow_undecided)
    if problems:
        fail("\n".join(problems))
    click.echo("no growth found and no unexpected event")


@click.group(cls=Verbs)
def dev() -> None:
    """Measure the diagnosis and the daemon, and write policy files: tools of softarm's makers.

    \b
    Examples:
      softarm dev soak --hours 1
      softarm dev export runs/reach-1/best.pt --out my-reach.onnx
    """


for verb in (blind, export, plan, soak):
    dev.add_command(verb)
