"""Command line of the blind benchmark: `python -m validation.blind --help`."""

from pathlib import Path

import click

from benchmarks import results
from softarm.cli.shared.console import FILE, FOLDER
from softarm.cli.shared.errors import failing
from softarm.common.batch import JobsFailed, Workers, workers_options
from softarm.common.cluster import ClusterError
from softarm.common.processes import bar
from validation.blind import make as making
from validation.blind import opening, pages
from validation.blind import run as running
from validation.blind.seal import SealError

REFUSALS = SealError, JobsFailed, ClusterError
labels_option = click.option("--labels", "labels_file", type=FILE, required=True, help="File of the sealed labels.")


@click.group()
def main() -> None:
    """Measure the diagnosis on robots with sealed faults.

    \b
    Examples:
      python -m validation.blind make cases --labels sealed/labels.json --fresh sealed/fresh
      python -m validation.blind run cases --answers answers.json
      python -m validation.blind open cases --labels sealed/labels.json --fresh sealed/fresh \\
        --answers answers.json --json blind.json
    """


@main.command()
@click.argument("data", type=FOLDER)
@labels_option
@click.option("--fresh", type=FOLDER, help="Folder for three more trials of each case, used by the score only.")
@click.option("--cases", "count", default=100, show_default=True, type=click.IntRange(1, 10000), help="Number to draw.")
@click.option("--seed", type=click.IntRange(0), help="Seed of the draw; random and secret by default.")
@workers_options()
@failing(*REFUSALS)
def make(data: Path, labels_file: Path, fresh: Path | None, count: int, seed: int | None, workers: Workers) -> None:
    """Draw cases, seal their labels, and fly the cases into DATA. The same command resumes an interrupted run.

    The labels contain the seed and the salt, which reveal every fault: keep this file outside DATA.
    """
    cases = making.prepare(data, labels_file, fresh, count, seed)
    making.write_cases(cases, data, fresh, workers)
    click.echo(f"{len(cases)} cases in {data}, labels in {labels_file}, commitment in {data / 'commitment.json'}")
    click.echo(f"next: python -m validation.blind run {data} --answers answers.json")


@main.command()
@click.argument("data", type=FOLDER)
@click.option("--answers", "answers_file", type=FILE, required=True, help="File for the answers; frozen at the end.")
@click.option("--method", default="diagnose", show_default=True, help="Method that answers: diagnose, or a baseline.")
@workers_options()
@failing(*REFUSALS)
def run(data: Path, answers_file: Path, method: str, workers: Workers) -> None:
    """Answer every case of DATA and freeze the answers (FILE.sha256). The same command resumes an interrupted run.

    An answer is kept as long as the method's code and the case's files are unchanged.
    """
    digest = running.run(data, answers_file, method, workers)
    click.echo(f"wrote {answers_file}; frozen as {digest}")


@main.command("open")
@click.argument("data", type=FOLDER)
@labels_option
@click.option(
    "--answers", "answer_files", type=FILE, multiple=True, required=True, help="Frozen answers; one file per method."
)
@click.option("--fresh", type=FOLDER, help="Folder of the fresh trials; without it the shrink is not checked.")
@results.json_option
@failing(*REFUSALS)
def open_(
    data: Path, labels_file: Path, answer_files: tuple[Path, ...], fresh: Path | None, json_file: Path | None
) -> None:
    """Score frozen answers against the labels; refuse files that changed after sealing."""
    with bar("opening", total=None) as shown:
        found = opening.open_labels(data, labels_file, answer_files, fresh, on_case=shown.count)
    results.report("blind-methods", found, json_file)
    if "diagnose" in found["methods"]:
        results.report("blind", found, None)
    click.echo("\n".join(pages.wrong_answers(found["methods"])))


if __name__ == "__main__":
    main(prog_name="python -m validation.blind")
