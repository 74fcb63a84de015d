"""Invocation of the `softarm` command in the test's process."""

from typing import Any

from click.testing import CliRunner, Result

from softarm.cli.main import main


def invoke(*arguments: object, **options: Any) -> Result:
    """Run the command with arguments of any type and return its output and exit code."""
    return CliRunner().invoke(main, list(map(str, arguments)), prog_name="softarm", **options)


def succeed(*arguments: object, **options: Any) -> Result:
    """Run a command that has to end with exit code 0 and return its output."""
    result = invoke(*arguments, **options)
    assert result.exit_code == 0, result.output
    return result


def refuse(message: str, *arguments: object, code: int = 1, **options: Any) -> Result:
    """Run a command that has to end with an exit code and a message, which may be wrapped, and return its output."""
    result = invoke(*arguments, **options)
    assert result.exit_code == code, result.output
    assert message in " ".join(result.stderr.split())
    return result
