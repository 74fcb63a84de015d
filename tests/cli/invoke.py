"""Invocation of the `softarm` command in the test's process."""

from typing import Any

from click.testing import CliRunner, Result

from softarm.cli.main import main


def invoke(*arguments: object, **options: Any) -> Result:
    """Run the command with arguments of any type and return its output and exit code."""
    return CliRunner().invoke(main, list(map(str, arguments)), prog_name="softarm", **options)
