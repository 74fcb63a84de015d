"""Check that the API does what its schema states: Schemathesis tests a running daemon with a simulated robot.

    python -m validation.api --examples 500

An answer may be a refusal. Refusals with 422, such as a target out of reach, cannot be derived from the schema; 503 is
part of it.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import click

from softarm.cli.shared.errors import failing
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoopError
from validation.daemon_process import SimulatedDaemon

_EXPECTED = """
request-timeout = 310.0  # a log's replay may take that long
[checks]
max_response_time = 310.0
[checks.not_a_server_error]
expected-statuses = ["2xx", "3xx", "4xx", 503, 504]
[checks.positive_data_acceptance]
expected-statuses = ["2xx", 404, 409, 422, 503, 504]
"""


@click.command()
@click.option("--examples", default=200, show_default=True, type=click.IntRange(1), help="At most, of each operation.")
@click.option("--seed", default=0, show_default=True)
def main(examples: int, seed: int) -> None:
    """Send requests inside and outside the schema; exit with 1 if an answer violates it.

    \b
    Example:
      python -m validation.api --examples 500 --seed 1
    """
    with (
        failing(SoftwareInTheLoopError),
        tempfile.TemporaryDirectory(prefix="softarm-") as folder,
        SimulatedDaemon(Path(folder)) as daemon,
    ):
        expected = Path(folder) / "schemathesis.toml"
        expected.write_text(_EXPECTED)
        program = [sys.executable, "-m", "schemathesis.cli", "--config-file", str(expected), "--no-color", "run"]
        asked = f"{daemon.url}/openapi.json --checks all --phases examples,coverage,fuzzing"
        options = f"--continue-on-failure --seed {seed} --max-examples {examples}"
        done = subprocess.run([*program, *asked.split(), *options.split()], cwd=folder, check=False)
    raise SystemExit(done.returncode)


if __name__ == "__main__":
    main()
