"""Tests that the generated list has every verb and that the examples of the help work."""

import inspect
import re
import shlex
import shutil
from pathlib import Path

import click
import pytest

from softarm.cli.gap import close_gap
from softarm.cli.groups import DEFECT
from softarm.cli.main import VERBS, main
from softarm.cli.page import commands_of, markdown
from softarm.cli.shared.errors import EXITS, INTERRUPTED
from tests.cli.invoke import invoke, succeed

ROOT = Path(__file__).parents[2]
NAMES = [name for section in VERBS.values() for name in section]
# What needs no robot, no daemon and no minutes.
RUN = ("policy list --config", "excite --list", "twin --fault list", "model ", "config units")


def examples(command):
    """Return the lines below `Example` in a verb's help, with continued lines joined."""
    lines = inspect.cleandoc(command.help or "").splitlines()
    begin = next((number for number, line in enumerate(lines) if line.startswith("Example")), len(lines))
    return [line.removeprefix("  ") for line in lines[begin + 1 :] if line.startswith("  ")]


def typed(command):
    """Yield the commands in a verb's examples, with continued lines joined and remarks removed."""
    text = re.sub(r"\\\n\s*", "", "\n".join(examples(command)))
    for line in text.splitlines():
        for part in re.split(r"\s{2,}|&&| [#>] ", line.strip()):
            if part.strip().startswith("softarm "):
                yield part.strip()


EXAMPLES = sorted({line for name in NAMES for _, command in commands_of(name) for line in typed(command)})


def test_the_generated_list_shows_every_verb():
    listed = markdown()
    assert all(f"- `softarm {name}" in listed for name in NAMES)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the files that the examples name."""
    made = tmp_path_factory.mktemp("examples")
    for name in ("softarm.yaml", "twin.yaml"):
        shutil.copy(ROOT / name, made)
    shutil.copy(ROOT / "softarm" / "simulator" / "models" / "seed.yaml", made / "mine.yaml")
    for name in ("logs", "campaign", "recordings", "runs/compare"):
        (made / name).mkdir(parents=True)
    for word in shlex.split(" ".join(EXAMPLES)):
        if word.startswith("logs/") and "*" not in word:
            (made / word).touch()
    return made


@pytest.fixture
def bench(folder, monkeypatch):
    monkeypatch.chdir(folder)


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("line", EXAMPLES)
def test_every_example_parses(line):
    """Its verbs, options and values exist; nothing is run."""
    context, words = click.Context(main, info_name="softarm"), shlex.split(line)[1:]
    command: click.Command = main
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        name, command, words = command.resolve_command(context, words)
        if isinstance(command, click.Group) and words and words[0] in command.commands:
            continue
        context = command.make_context(name, list(words), parent=context)
        words = []
    assert words == [] or words == ["--version"]


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize(
    "line",
    ["softarm check softarm.yaml", *(line for line in EXAMPLES if line.removeprefix("softarm ").startswith(RUN))],
)
def test_an_example_without_a_robot_runs(line):
    succeed(*shlex.split(line)[1:])


def test_help_lists_every_exit_code():
    used = {0, 1, 2, close_gap.KEEP_THE_OLD, DEFECT, INTERRUPTED}
    assert set(EXITS) == used
    help_text = invoke("--help").output
    assert all(re.search(rf"\n +{code} +{re.escape(meaning[:20])}", help_text) for code, meaning in EXITS.items())


@pytest.mark.parametrize(
    ("words", "number", "names"),
    [
        ("softarm incid", 1, ["plain,incidents"]),
        ("softarm goal r", 2, ["plain,reach", "plain,run"]),
        ("softarm policy use reach-", 3, ["plain,reach-robust", "plain,reach-wide"]),
        ("softarm evaluate reach --config arm.yaml mi", 5, ["plain,mine", "file,mi"]),
        ("softarm model show no-d", 3, ["plain,no-delay", "file,no-d"]),
        ("softarm run --model no-d", 3, ["plain,no-delay", "file,no-d"]),
        ("softarm logs view logs/soft-2", 3, ["plain,logs/soft-2.mcap", "file,logs/soft-2"]),
        ("softarm logs export --to csv logs/soft-2", 5, ["plain,logs/soft-2.mcap", "file,logs/soft-2"]),
        ("softarm logs replay logs/s", 3, ["plain,logs/soft-2.mcap", "plain,logs/soft-1.mcap", "file,logs/s"]),
        ("softarm incidents l", 2, ["plain,latest"]),
        ("softarm incidents i", 2, ["plain,incident-1.zip"]),
        ("softarm excite rail-ch", 2, ["plain,rail-chirp"]),
        ("softarm twin --fault mocap_f", 3, ["plain,mocap_freeze"]),
        ("softarm goal reach -0.2 0.5", 4, ["plain,0.55"]),
    ],
)
def test_names_are_completed(tmp_path, monkeypatch, words, number, names):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.yaml").write_text("policies: {mine: {plugin: pid}}\n")
    (tmp_path / "logs" / "incidents").mkdir(parents=True)
    for name in ("soft-1.mcap", "soft-2.mcap", "incidents/incident-1.zip"):
        (tmp_path / "logs" / name).touch()
    environment = {"_SOFTARM_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(number)}
    assert invoke(env=environment).output.split() == names


def test_completion_prints_the_script_of_the_shell():
    script = invoke(env={"_SOFTARM_COMPLETE": "zsh_source"}).output
    assert "#compdef softarm" in script
    assert "_SOFTARM_COMPLETE=zsh_complete softarm" in script
