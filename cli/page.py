"""docs/cli.md, made from the verbs: `python -m softarm.cli.page > docs/cli.md`."""

import inspect
import re
from collections.abc import Iterator

import click

from softarm.cli.errors import EXITS
from softarm.cli.main import VERBS, main

HEAD = """\
# The command line

Made from the verbs; edit those, then run `python -m softarm.cli.page > docs/cli.md`. `--help` tells a verb's options.
"""
TAIL = """\
## For scripts

`--json` prints the answer instead of sentences (`status`, `events` one object a line, `goal`, `policy list`,
`incidents`, `logs`, `check`, `twin fault`), or takes the file for a verb's results (`evaluate`, `plan`, `identify`,
`diagnose`, `soak`). Sentences that are no result go to standard error, and so does progress: a bar on a terminal,
else a line after two seconds and every ten.

| exit code | means |
|---|---|
{exits}

`softarm --debug VERB ...`, or `SOFTARM_DEBUG=1`, shows the traceback of a defect. `SOFTARM_URL`, `SOFTARM_TOKEN` and
`SOFTARM_STOP_PORT` stand for `--url`, `--token-file` and `--stop-port`.

## Ctrl-C

Every verb that lasts says on standard error what it leaves and in which state, and ends with 130. A verb that asks a
daemon leaves it going: `softarm goal cancel`, `disarm` and `stop` end what it does. `softarm run` brakes, vents,
switches the drive off and closes the log. What `train` (with `--resume`), `train --sweep`, `blind make` and `blind run`
have done is kept, and the same command goes on.

## Completion

The shell completes verbs, options, policies, models, logs, incident files, excitations, faults and the test targets:

```
eval "$(_SOFTARM_COMPLETE=bash_source softarm)"                      # in ~/.bashrc
eval "$(_SOFTARM_COMPLETE=zsh_source softarm)"                       # in ~/.zshrc
_SOFTARM_COMPLETE=fish_source softarm | source                       # in ~/.config/fish/config.fish
```
"""


SAID = re.compile(r"^(\S.*?)(\s{2,})(\S.*)$")  # a command, and what is said beside it


def page() -> str:
    """The page."""
    parts = [HEAD]
    for section, verbs in VERBS.items():
        parts.append(f"## {section}\n\n| verb | |\n|---|---|")
        commands = [each for name in verbs for each in commands_of(name)]
        parts.append("\n".join(f"| `{path}` | {_line(path, command)} |" for path, command in commands))
        shown = dict.fromkeys(SAID.sub(r"\1\2# \3", line) for _, command in commands for line in examples(command))
        parts.append("\n```\n" + "\n".join(shown) + "\n```\n")
    exits = "\n".join(f"| {code} | {meaning} |" for code, meaning in EXITS.items())
    return "\n".join([*parts, TAIL.format(exits=exits)])


def commands_of(name: str) -> Iterator[tuple[str, click.Command]]:
    """A verb and, of one that has some, its verbs: each with what is typed."""
    verb = main.get_command(click.Context(main), name)
    assert verb is not None
    yield f"softarm {name}", verb
    if isinstance(verb, click.Group):
        for inner, command in verb.commands.items():
            yield f"softarm {name} {inner}", command


def examples(command: click.Command) -> list[str]:
    """The lines below `Example` in a verb's help; one that ends in a backslash goes on in the next."""
    lines = inspect.cleandoc(command.help or "").splitlines()
    begin = next((number for number, line in enumerate(lines) if line.startswith("Example")), len(lines))
    return [line.removeprefix("  ") for line in lines[begin + 1 :] if line.startswith("  ")]


def _line(path: str, command: click.Command) -> str:
    told = [section[name].help for section in VERBS.values() for name in section if path == f"softarm {name}"]
    text = told[0] if told else inspect.cleandoc(command.help or "").partition("\n\n")[0].replace("\n", " ")
    return text.replace("|", "\\|")


if __name__ == "__main__":
    print(page(), end="")
