"""List of every verb in docs/reference/cli.md; `python -m softarm.cli.page` prints it."""

import inspect
from collections.abc import Iterator

import click

from softarm.cli.main import VERBS, main


def markdown() -> str:
    """Return every verb with its purpose, by user task."""
    parts = []
    for section, verbs in VERBS.items():
        commands = [each for name in verbs for each in commands_of(name) if _does_something(each[1])]
        lines = "\n".join(f"- `{path}`: {_line(path, command)}" for path, command in commands)
        parts.append(f"## {section}\n\n{lines}\n")
    return "\n".join(parts)


def commands_of(name: str) -> Iterator[tuple[str, click.Command]]:
    """Yield a verb and its sub-verbs, each with its command line."""
    verb = main.get_command(click.Context(main), name)
    assert verb is not None
    yield from _below(f"softarm {name}", verb)


def _below(path: str, command: click.Command) -> Iterator[tuple[str, click.Command]]:
    yield path, command
    if isinstance(command, click.Group):
        for name, inner in command.commands.items():
            yield from _below(f"{path} {name}", inner)


def _does_something(command: click.Command) -> bool:
    """Return whether a command does more than group its sub-verbs."""
    return not isinstance(command, click.Group) or command.invoke_without_command


def _line(path: str, command: click.Command) -> str:
    listed = [section[name].help for section in VERBS.values() for name in section if path == f"softarm {name}"]
    return listed[0] if listed else inspect.cleandoc(command.help or "").partition("\n\n")[0].replace("\n", " ")


if __name__ == "__main__":
    print(markdown(), end="")
