"""The command's front door: help that is quick and shows examples, mistakes that are explained."""

import re
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from softarm import cli
from softarm.cli.lazy_group import Verb
from softarm.cli.main import VERBS, main

HEAVY = {"numba", "torch", "mujoco", "fastapi", "uvicorn", "zenoh", "onnxruntime", "matplotlib", "scipy", "ray"}
LINES_MAX = 120  # parse, call, print; what else a verb does belongs to a room below
NAMES = [name for section in VERBS.values() for name in section]


def run(*arguments):
    return CliRunner().invoke(main, list(arguments), prog_name="softarm")


def test_help_lists_every_verb_and_imports_nothing_heavy():
    heavy = {"numpy", "numba", "torch", "mujoco", "fastapi", "pydantic", "onnxruntime", "httpx", "zenoh", "rich"}
    code = (
        "import sys; from softarm.cli.main import main; main(['--help'], standalone_mode=False);"
        f"print('HEAVY', sorted({heavy!r} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert "HEAVY []" in out
    for name in NAMES:
        assert f"\n  {name} " in out


def commands(command, path):
    yield path, command
    if isinstance(command, click.Group):
        for name, child in command.commands.items():
            yield from commands(child, (*path, name))


@pytest.mark.parametrize("name", NAMES)
def test_every_verb_has_help_with_an_example_of_itself(name):
    group = main.get_command(click.Context(main), name)
    for path, command in commands(group, (name,)):
        result = run(*path, "--help")
        assert result.exit_code == 0
        assert "Example" in result.output
        assert f"softarm {' '.join(path)}" in result.output.partition("Example")[2], path
        assert command.get_short_help_str()


def test_what_a_verb_is_for_stands_in_one_line_each():
    for section in VERBS.values():
        for verb in section.values():
            assert verb.help.endswith(".")
            assert len(verb.help) < 60


def test_a_misspelt_verb_gets_the_nearest_one_and_exit_code_2():
    result = run("polcy", "list")
    assert result.exit_code == 2
    assert "no verb 'polcy'; did you mean 'policy'?" in result.output
    assert "`softarm --help` lists the verbs" in run("xyzzy").output


@pytest.mark.parametrize("arguments", [["goal", "reach", "-0.2"], ["goal", "reach", "left", "0.6"], ["check"]])
def test_a_usage_error_exits_with_2(arguments):
    assert run(*arguments).exit_code == 2


def test_a_package_that_is_not_installed_is_named_with_the_way_to_get_it(monkeypatch, tmp_path):
    (tmp_path / "needy_verb.py").write_text("import a_package_that_is_not_there\n")
    monkeypatch.setattr("softarm.cli.__path__", [*cli.__path__, str(tmp_path)])
    monkeypatch.setitem(VERBS["Run"], "needy", Verb("needy_verb:verb", "Needs it.", "train"))
    result = run("needy")
    assert result.exit_code == 1
    assert result.stderr == (
        "softarm needy needs the package 'a_package_that_is_not_there': pip install 'softarm[train]'\n"
    )


def test_the_version_is_the_installed_one():
    assert run("--version").output.startswith("softarm, version 0.")


def test_the_module_of_a_verb_imports_nothing_heavy():
    """So that a usage error and --help come at once, and a missing extra is met where it can be explained."""
    modules = sorted({verb.target.partition(":")[0] for section in VERBS.values() for verb in section.values()})
    code = (
        "import sys, importlib\n"
        f"for name in {modules!r}: importlib.import_module('softarm.cli.' + name)\n"
        f"print(sorted({HEAVY!r} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


def test_a_file_of_the_room_is_a_verb_or_what_verbs_share_and_fits_three_screens():
    verbs = {verb.target.partition(":")[0] for section in VERBS.values() for verb in section.values()}
    texts = {file.stem: file.read_text(encoding="utf-8") for file in (Path(__file__).parents[2] / "cli").rglob("*.py")}
    used = {name for text in texts.values() for name in re.findall(r"(?:from|import) softarm\.cli\.(\w+)", text)}
    assert set(texts) - verbs - used == {"__init__", "page"}
    lines = {stem: len(text.splitlines()) for stem, text in texts.items()}
    assert not {stem: count for stem, count in lines.items() if count > LINES_MAX}


@pytest.fixture
def broken(monkeypatch, tmp_path):
    """A verb that raises what the test says."""

    def verb(error):
        line = f"raise {error}('of the test')"
        (tmp_path / "broken_verb.py").write_text(
            "import click\nfrom softarm.cli.interrupt import leaves\n\n@click.command()\ndef verb():\n"
            f"    '''Nothing.'''\n    leaves('all as it was')\n    {line}\n"
        )
        monkeypatch.setattr("softarm.cli.__path__", [*cli.__path__, str(tmp_path)])
        monkeypatch.setitem(VERBS["Run"], "broken", Verb("broken_verb:verb", "Breaks."))
        monkeypatch.delitem(sys.modules, "softarm.cli.broken_verb", raising=False)

    return verb


def test_a_defect_is_one_line_and_with_debug_a_traceback(broken):
    broken("ZeroDivisionError")
    result = run("broken")
    assert result.exit_code == 70
    where = "(broken_verb.py:8): ZeroDivisionError: of the test; report what `softarm --debug broken ...` shows\n"
    assert result.stderr == f"softarm broken: a defect of ours {where}"
    assert isinstance(run("--debug", "broken").exception, ZeroDivisionError)


def test_ctrl_c_says_what_it_leaves_and_ends_with_130(broken):
    broken("KeyboardInterrupt")
    result = run("broken")
    assert (result.exit_code, result.stderr) == (130, "\ninterrupted: all as it was\n")


def test_a_misspelt_verb_of_a_verb_gets_the_nearest_one():
    assert "no verb 'reahc'; did you mean 'reach'?" in run("goal", "reahc").output
    assert "`softarm goal --help` lists the verbs." in run("goal", "xyzzy").output
