"""Generator of docs/reference/cli.md: `python -m softarm.cli.page > docs/reference/cli.md`."""

import inspect
from collections.abc import Iterator

import click

from softarm.cli.main import VERBS, main
from softarm.cli.shared.errors import EXITS

HEAD = """\
# Command line

For everybody who types or scripts commands. `softarm VERB --help` prints the options of a verb and examples.
`python -m softarm.cli.page > docs/reference/cli.md` writes this page.
"""
TAIL = """\
## For scripts

`--json` prints JSON instead of sentences: `status`, `events` (one object a line), `goal`, `policy list`, `incidents`,
`logs`, `check`, `twin fault`. For `evaluate`, `plan`, `identify`, `diagnose` and `soak` it takes the file for the
results. Messages and progress go to standard error. Progress is a bar on a terminal, otherwise a line after two seconds
and every ten.

| exit code | means |
|---|---|
{exits}

`softarm --debug VERB ...`, or `SOFTARM_DEBUG=1`, shows the traceback of a defect. `SOFTARM_URL`, `SOFTARM_TOKEN` and
`SOFTARM_STOP_PORT` stand for `--url`, `--token-file` and `--stop-port`.

## Ctrl-C

Ctrl-C ends a long verb with exit code 130. Standard error states what is left, and in which state. A daemon that a verb
talks to continues: use `softarm goal cancel`, `disarm` or `stop`. `softarm run` brakes, vents, disables the drive and
closes the log. `train` (with `--resume`), `train --sweep`, `blind make` and `blind run` keep their results, and the
same command resumes.

## Completion

The shell completes verbs, options, policies, models, logs, incident files, excitations, faults and the test targets:

```
eval "$(_SOFTARM_COMPLETE=bash_source softarm)"                      # in ~/.bashrc
eval "$(_SOFTARM_COMPLETE=zsh_source softarm)"                       # in ~/.zshrc
_SOFTARM_COMPLETE=fish_source softarm | source                       # in ~/.config/fish/config.fish
```
"""


def page() -> str:
    """Return the Markdown page of all verbs, each with its purpose."""
    parts = [HEAD]
    for section, verbs in VERBS.items():
        commands = [each for name in verbs for each in commands_of(name) if _does_something(each[1])]
        lines = "\n".join(f"- `{path}`: {_line(path, command)}" for path, command in commands)
        parts.append(f"## {section}\n\n{lines}\n")
    exits = "\n".join(f"| {code} | {meaning} |" for code, meaning in EXITS.items())
    return "\n".join([*parts, TAIL.format(exits=exits)])


def commands_of(name: str) -> Iterator[tuple[str, click.Command]]:
    """Yield a verb and its sub-verbs, each with its command line."""
    verb = main.get_command(click.Context(main), name)
    assert verb is not None
    yield f"softarm {name}", verb
    if isinstance(verb, click.Group):
        for inner, command in verb.commands.items():
            yield f"softarm {name} {inner}", command


def _does_something(command: click.Command) -> bool:
    """Return whether a command does more than group its sub-verbs."""
    return not isinstance(command, click.Group) or command.invoke_without_command


def _line(path: str, command: click.Command) -> str:
    listed = [section[name].help for section in VERBS.values() for name in section if path == f"softarm {name}"]
    return listed[0] if listed else inspect.cleandoc(command.help or "").partition("\n\n")[0].replace("\n", " ")


if __name__ == "__main__":
    print(page(), end="")
