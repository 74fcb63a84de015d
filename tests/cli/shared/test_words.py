"""Tests that texts of the daemon name verbs instead of HTTP requests."""

import ast
import logging
import re
from pathlib import Path

import click
import pytest

from softarm.cli.main import main
from softarm.cli.operate.run import announce
from softarm.cli.shared.words import COMMANDS, REQUEST, Formatter, in_commands
from softarm.daemon.assembly import Daemon, latch_of
from softarm.daemon.control.failsafe import TABLE, Event
from softarm.daemon.control.records import EStop, Mode
from softarm.daemon.runtime.devices import real_devices
from softarm.schemas.config import Config

ROOT = Path(__file__).parents[3]
HTTP = re.compile(r"(GET|POST|PUT|DELETE) /")


def texts_of(path):
    """Yield the text literals of a program except docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docs = {id(node.body[0].value) for node in ast.walk(tree) if isinstance(node, documented) and is_doc(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
            yield node.value


def is_doc(node):
    return bool(node.body) and isinstance(node.body[0], ast.Expr) and isinstance(node.body[0].value, ast.Constant)


def test_every_request_in_the_daemons_texts_has_a_verb():
    named = {
        f"{found[1]} {found[2]}"
        for path in (ROOT / "softarm" / "daemon").rglob("*.py")
        for text in texts_of(path)
        for found in REQUEST.finditer(text)
    }
    assert len(named) >= 3
    assert named <= COMMANDS.keys()


def test_every_translated_verb_exists():
    from softarm.cli.main import VERBS

    verbs = {name for section in VERBS.values() for name in section}
    assert {command.split()[1] for command in COMMANDS.values()} <= verbs


@pytest.mark.parametrize(
    ("text", "translated"),
    [
        ("the emergency stop is latched: POST /api/acknowledge first", "is latched: `softarm acknowledge` first"),
        ("latched until `POST /api/acknowledge`", "latched until `softarm acknowledge`"),
        ("choose another with PUT /api/policy, or mend it", "with `softarm policy use NAME`, or mend it"),
        ("GET /api/incidents/NAME gives one", "`softarm incidents` gives one"),
        ("send it to POST /api/unheard-of", "send it to the API's /api/unheard-of (POST)"),
    ],
)
def test_a_request_is_translated_into_its_verb(text, translated):
    assert in_commands(text).endswith(translated)


@pytest.mark.parametrize("arguments", [["status"], ["status", "--json"]])
def test_status_translates_requests_into_verbs(softarm, daemon, make_status, arguments):
    events = tuple(Event(name, "0.3").active() for name in TABLE)
    refusals = ("the emergency stop is latched: POST /api/acknowledge first", *(event.text for event in events))
    changes = {
        "events": events,
        "arming_refusals": refusals,
        "last_stop": events[0].text,
        "policy_fault": events[1].text,
    }
    daemon.on("GET", "/api/status", make_status(mode=Mode.STOPPED, estop=EStop.LATCHED, **changes))
    output = softarm(*arguments).output
    assert "then run `softarm acknowledge`" in output
    assert not HTTP.search(output)


def test_a_refusal_is_translated_into_verbs(softarm, daemon):
    daemon.on("POST", "/api/goal", {"detail": "the arm is disarmed: POST /api/arm first"}, code=409)
    result = softarm("goal", "hold")
    assert (result.exit_code, result.stderr) == (1, "the arm is disarmed: `softarm arm` first\n")


def test_the_log_in_the_terminal_is_translated_into_verbs():
    record = logging.LogRecord("softarm", logging.WARNING, "", 0, "stopped: then %s", ("POST /api/acknowledge",), None)
    assert Formatter("%(levelname)s %(message)s").format(record) == "WARNING stopped: then `softarm acknowledge`"


def test_the_cause_of_an_earlier_stop_is_translated_into_verbs(tmp_path, capsys):
    config = Config(api={"port": 0}, control={"policy": "hold"}, recorder={"directory": tmp_path})
    keeper = latch_of(config)
    keeper.left = Event("remote_off").text
    daemon = Daemon(config, real_devices(config), keeper)
    with click.Context(main):
        announce(daemon)
    output = capsys.readouterr().out
    assert "release the emergency-stop button, then run `softarm acknowledge`" in output
    assert not HTTP.search(output.replace("POST http", ""))
