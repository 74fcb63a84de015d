"""Tests of the `softarm` command: help, usage errors, defects."""

import subprocess
import sys

import pytest

from softarm import cli
from softarm.cli.groups import Verb
from softarm.cli.main import VERBS
from softarm.cli.page import commands_of
from tests.cli.invoke import invoke, refuse, succeed

HEAVY = {"numba", "torch", "mujoco", "fastapi", "uvicorn", "zenoh", "onnxruntime", "matplotlib", "scipy", "ray"}
NAMES = [name for section in VERBS.values() for name in section]


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


@pytest.mark.parametrize("name", NAMES)
def test_every_verb_has_help_with_an_example_of_itself(name):
    for path, command in commands_of(name):
        result = succeed(*path.split()[1:], "--help")
        assert path in result.output.partition("Example")[2]
        assert command.get_short_help_str()


@pytest.mark.parametrize("name", NAMES)
def test_no_two_options_of_a_verb_share_a_parameter(name):
    """`--workers` once took the value of an option `--cases`."""
    for path, command in commands_of(name):
        names = [each.name for each in command.params if getattr(each, "is_flag", False) is False]
        assert len(names) == len(set(names)), path


def test_a_missing_package_is_reported_with_the_command_to_install_it(monkeypatch, tmp_path):
    (tmp_path / "needy_verb.py").write_text("import a_package_that_is_not_there\n")
    monkeypatch.setattr("softarm.cli.__path__", [*cli.__path__, str(tmp_path)])
    monkeypatch.setitem(VERBS["Run"], "needy", Verb("needy_verb:verb", "Needs it.", "train"))
    result = invoke("needy")
    message = "softarm needy needs the package 'a_package_that_is_not_there': pip install 'softarm[train]'\n"
    assert (result.exit_code, result.stderr) == (1, message)


def test_tools_of_makers_are_listed_below_dev_alone():
    first, below = invoke("--help").output, invoke("dev", "--help").output
    for name in ("export", "plan"):
        assert f"\n  {name} " in below
        assert f"\n  {name} " not in first


def test_the_modules_of_verbs_import_nothing_heavy():
    """A usage error and --help are quick, and a missing extra is reported when the verb is used."""
    modules = sorted({verb.target.partition(":")[0] for section in VERBS.values() for verb in section.values()})
    code = (
        "import sys, importlib\n"
        f"for name in {modules!r}: importlib.import_module('softarm.cli.' + name)\n"
        f"print(sorted({HEAVY!r} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


def test_a_defect_is_one_line_and_with_debug_a_traceback(monkeypatch, tmp_path):
    text = "import click\n\n@click.command()\ndef verb():\n    raise ZeroDivisionError('of the test')\n"
    (tmp_path / "broken_verb.py").write_text(text)
    monkeypatch.setattr("softarm.cli.__path__", [*cli.__path__, str(tmp_path)])
    monkeypatch.setitem(VERBS["Run"], "broken", Verb("broken_verb:verb", "Breaks."))
    result = invoke("broken")
    assert result.exit_code == 70
    where = "(broken_verb.py:5): ZeroDivisionError: of the test; report what `softarm --debug broken ...` shows\n"
    assert result.stderr == f"softarm broken: a defect in softarm {where}"
    assert isinstance(invoke("--debug", "broken").exception, ZeroDivisionError)


def test_a_name_that_is_too_long_for_a_file_is_no_defect():
    for verb in ("diagnose", "evaluate"):
        refuse("nnn...: no file system holds a name that long; name another file", verb, "n" * 300)
