"""Arguments of one call of `softarm evaluate`, and which of them go together."""

from dataclasses import dataclass
from pathlib import Path

import click

from softarm.cli.shared.options import check_places
from softarm.common.batch import Workers


@dataclass(frozen=True)
class Choice:
    """Arguments and options of one call, by their names in the command."""

    policies: tuple[str, ...]
    config_file: Path | None
    model_file: Path | None
    compare_all: bool
    runs: Path | None
    only: tuple[str, ...]
    tests: tuple[str, ...]
    matrix: bool
    faults: bool
    report: Path | None
    film: Path | None
    target: tuple[float, float] | None
    workers: Workers
    keep: Path | None
    leaderboard: Path | None
    json_file: Path | None

    def check(self) -> None:
        """Raise UsageError for options that have no effect together, and Failure for a place that does not exist."""
        if (self.runs or self.only) and not (self.compare_all or self.matrix):
            raise click.UsageError(
                "--runs and --only go with --all. Without --all, name each policy or folder: softarm evaluate POLICY..."
            )
        if self.matrix and self.runs is None:
            raise click.UsageError("--matrix is about a sweep: give its folder with --runs")
        if self.matrix and (self.policies or self.model_file or self.compare_all):
            raise click.UsageError(
                "--matrix flies a sweep's policies on every shipped model: omit POLICY, --model and --all"
            )
        others = (self.compare_all, self.matrix, self.tests, self.model_file, self.keep)
        if self.faults and any((*others, self.film, self.report, self.leaderboard)):
            raise click.UsageError(
                "--faults has its own flights and table: omit all options but --config, --workers, --ray and --json"
            )
        if self.model_file and (own := [test for test in self.tests if "@" in test]):
            raise click.UsageError(f"--test {own[0]} names a model itself: omit --model, or @ and what follows")
        if self.target and self.film is None:
            raise click.UsageError("--target Y Z is the target of the film: add --film FILE.gif")
        if self.leaderboard and self.model_file:
            raise click.UsageError("--leaderboard holds results of the seed's simulator: omit --model")
        check_places(self.json_file, self.report, self.film, self.leaderboard)
