"""`softarm blind`: the blind benchmark: make and seal cases, answer them, open the labels over the answers."""

from pathlib import Path

import click

from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.options import FILE, FOLDER
from softarm.common.processes import bar

labels_option = click.option("--labels", "labels_file", type=FILE, required=True, help="The sealed labels.")
processes_option = click.option(
    "--processes", default=2, show_default=True, type=click.IntRange(1, 64), help="At a time; each takes one core."
)


@click.group()
def blind() -> None:
    """Measure the diagnosis on robots whose faults it cannot know.

    \b
    Examples:
      softarm blind make cases --labels sealed/labels.json --fresh sealed/fresh
      softarm blind run cases --answers answers.json
      softarm blind open cases --labels sealed/labels.json --fresh sealed/fresh --answers answers.json --out score
    """


@blind.command()
@click.argument("data", type=FOLDER)
@labels_option
@click.option("--fresh", type=FOLDER, help="Where three more trials of each case go, for the score alone.")
@click.option("--cases", "count", default=100, show_default=True, type=click.IntRange(1, 10000))
@click.option("--seed", type=click.IntRange(0), help="Draws the same cases again; by default one that nobody knows.")
@processes_option
def make(data: Path, labels_file: Path, fresh: Path | None, count: int, seed: int | None, processes: int) -> None:
    """Draw cases, commit to their labels, and fly them into DATA. Started again, it goes on where it stopped.

    The labels hold seed and salt, so they tell everything: keep FILE where the tool does not look.

    \b
    Example:
      softarm blind make cases --cases 100 --labels sealed/labels.json --fresh sealed/fresh
    """
    from softarm.diagnosis.blind import make as making
    from softarm.diagnosis.blind.seal import SealError

    leaves(f"the cases that were flown are kept in {data}; the same command goes on")
    try:
        cases = making.prepare(data, labels_file, fresh, count, seed)
    except SealError as error:
        fail(str(error))
    with bar("flying", len(cases)) as shown:
        making.write_cases(cases, data, fresh, processes, lambda name: shown.advance())
    click.echo(f"{len(cases)} cases in {data}, labels in {labels_file}, commitment in {data / 'commitment.json'}")
    click.echo(f"next: softarm blind run {data} --answers answers.json")


@blind.command()
@click.argument("data", type=FOLDER)
@click.option("--answers", "answers_file", type=FILE, required=True, help="Where the answers go; frozen at the end.")
@click.option("--method", default="diagnose", show_default=True, help="Who answers: diagnose, or a baseline.")
@click.option("--trials", type=click.IntRange(1), help="Show only so many of each case: does more data help?")
@processes_option
def run(data: Path, answers_file: Path, method: str, trials: int | None, processes: int) -> None:
    """Answer every case of DATA and freeze the answers (FILE.sha256). Started again, it goes on where it stopped.

    An answer counts as given while the tool's code and the case's files are the same.

    \b
    Examples:
      softarm blind run cases --answers answers.json
      softarm blind run cases --answers bic.json --method bic
    """
    from softarm.diagnosis.blind import run as running
    from softarm.diagnosis.blind.seal import SealError

    leaves(f"answers are kept, not frozen; the same command goes on with {answers_file}")
    try:
        with bar(method, total=None) as shown:
            digest = running.run(data, answers_file, method, processes, shown.count, trials)
    except SealError as error:
        fail(str(error))
    click.echo(f"wrote {answers_file}; frozen as {digest}")


@blind.command("open")
@click.argument("data", type=FOLDER)
@labels_option
@click.option(
    "--answers", "answer_files", type=FILE, multiple=True, required=True, help="Frozen answers; one file a method."
)
@click.option("--fresh", type=FOLDER, help="The fresh trials; without them the shrink is not checked.")
@click.option("--out", type=FOLDER, required=True, help="Where score.json, score.md and the pictures go.")
def open_(data: Path, labels_file: Path, answer_files: tuple[Path, ...], fresh: Path | None, out: Path) -> None:
    """Score frozen answers against the labels; refuse what has changed since it was sealed.

    \b
    Example:
      softarm blind open cases --labels sealed/labels.json --fresh sealed/fresh \\
        --answers answers.json --answers bic.json --out score
    """
    from softarm.diagnosis.blind import opening
    from softarm.diagnosis.blind.seal import SealError
    from softarm.diagnosis.data.trials import TrialError

    leaves("no score was written; the same command begins anew")
    try:
        with bar("opening", total=None) as shown:
            opening.open_labels(data, labels_file, answer_files, out, fresh, on_case=shown.count)
    except (SealError, TrialError) as error:
        fail(str(error))
    click.echo((out / "score.md").read_text(encoding="utf-8"))
