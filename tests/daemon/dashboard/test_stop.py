"""The stop button: always visible, independent of the API, with a report of what confirmed it."""

import itertools
import re
from urllib.parse import urlsplit

import pytest

from tests.processes import until

pytestmark = pytest.mark.slow


@pytest.fixture
def armed(page, robot):
    robot.arm()
    page.locator("#mode[data-mode=armed]").wait_for()
    return page


def arm_again(page, robot) -> None:
    """Arm after a stop, whose report leaves the page, and let all requests through."""
    page.locator("#mode[data-mode=stopped]").wait_for()
    page.unroute_all()
    robot.calm()
    robot.arm()
    page.locator("#stopped").wait_for(state="hidden")
    page.locator("#mode[data-mode=armed]").wait_for()


def banner(page) -> str:
    return page.locator("#stopped").inner_text()


def since_arming(robot) -> list[str]:
    """Return the kinds of the requests since the newest one to arm."""
    events = robot.client.get("/api/events").json()["events"]
    kinds = [one["what"] for one in events if one["kind"] == "request"]
    return kinds[len(kinds) - kinds[::-1].index("arm") :]


def api_stop(page, daemon):
    """Wait for the API's answer: each stop also goes there after 0.3 s, which would stop an arm that is armed again."""
    return page.expect_response(lambda answer: answer.url == f"{daemon.url}/api/stop" and answer.ok)


def cut(page, daemon, stop_too: bool = False, hang: bool = False) -> None:
    """Let the API fail, or hang; with stop_too let the dedicated stop port fail as well."""
    page.route(
        lambda url: urlsplit(url).port == daemon.port or (stop_too and urlsplit(url).port == daemon.stop_port),
        lambda route: None if hang else route.abort(),
    )
    if not hang:  # a key press can reach the page before the route does
        page.evaluate("async () => { while (await fetch('api/robot').then(() => true, () => false)); }")


# Over 3 s: seven stops, after each of which the robot is armed again.
def test_the_button_stops_on_every_screen_and_space_wherever_the_focus_is_but_not_in_a_text_field(armed, robot, daemon):
    for width, height in ((360, 640), (390, 844), (768, 1024), (1280, 720)):
        armed.set_viewport_size({"width": width, "height": height})
        armed.evaluate("scrollTo(0, document.body.scrollHeight)")
        button = armed.locator("#stop")
        box = button.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width
        assert box["y"] >= 0
        assert box["y"] + box["height"] <= height
        top = armed.evaluate(
            "([x, y]) => document.elementFromPoint(x, y).closest('button')?.id",
            [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2],
        )
        assert top == "stop"
    with api_stop(armed, daemon):
        button.click()
    armed.locator("#stopped[data-state=stopped]").wait_for()
    assert re.match(
        r"Stopped at [0-9:]{8}: confirmed (via the (dedicated stop port|API) in \d+ ms|by the robot's status)",
        banner(armed),
    )
    assert robot.status["mode"] == "stopped"
    arm_again(armed, robot)

    armed.evaluate("document.body.append(Object.assign(document.createElement('textarea'), {id: 'note'}))")
    armed.locator("#note").focus()
    armed.keyboard.type("a b")
    assert armed.locator("#note").input_value() == "a b"
    assert robot.status["mode"] == "armed"
    armed.locator("#note").evaluate("(note) => note.remove()")
    for focus in ("body", "#do-disarm", "#drawing", "#target-y", "#panel-events-tab", "#pause"):
        if focus != "body":
            armed.locator(focus).focus()
        with api_stop(armed, daemon):
            armed.keyboard.press("Space")
        armed.locator("#stopped[data-state=stopped]").wait_for()
        assert robot.status["mode"] == "stopped"
        assert armed.locator("#pause").get_attribute("aria-pressed") == "false"
        assert armed.locator("#panel-events-tab").get_attribute("aria-selected") == "false"
        until(lambda: since_arming(robot).count("stop") == 2, "the requests of both ports")
        assert since_arming(robot) == ["stop", "stop"]  # no disarm
        arm_again(armed, robot)


def test_each_port_stops_without_the_other_and_a_stop_without_answer_is_retried(armed, robot, daemon):
    cut(armed, daemon)
    with armed.expect_event("requestfailed", lambda request: request.url == f"{daemon.url}/api/stop"):
        armed.locator("#stop").click()
    armed.locator("#stopped[data-state=stopped]").wait_for()
    assert robot.status["mode"] == "stopped"
    arm_again(armed, robot)

    cut(armed, daemon, stop_too=True)
    failed = itertools.count(1)
    with armed.expect_event("requestfailed", lambda request: "/api/stop" in request.url and next(failed) > 4):
        armed.keyboard.press("Space")
        armed.locator("#stopped[data-state=unconfirmed]").wait_for()
        armed.keyboard.press("Space")  # replaces the first press, which waits to try again
    armed.locator("#stopped[data-state=unconfirmed]").wait_for()
    assert "NOT confirmed. Use the emergency-stop button" in banner(armed)
    assert robot.status["mode"] == "armed"
    assert armed.locator("#stop-text").inner_text() == "Not confirmed"
    with api_stop(armed, daemon):
        armed.unroute_all()
    armed.locator("#stopped[data-state=stopped]").wait_for()
    assert robot.status["mode"] == "stopped"
    arm_again(armed, robot)

    armed.route(lambda url: urlsplit(url).port == daemon.stop_port, lambda route: route.abort())
    with api_stop(armed, daemon):
        armed.locator("#stop").click()
    armed.locator("#stopped[data-state=stopped]").wait_for()
    assert robot.status["mode"] == "stopped"
    with api_stop(armed, daemon):  # again, since the status may have confirmed the first one
        armed.locator("#stop").click()
    armed.locator("#stopped >> text=confirmed via the API").wait_for()
    arm_again(armed, robot)

    cut(armed, daemon, hang=True)
    armed.keyboard.press("Space")
    armed.locator("#stopped[data-state=stopped]").wait_for()
    assert robot.status["mode"] == "stopped"


UNCOVERED = """(place) => {
  const box = document.querySelector(place).getBoundingClientRect();
  return [box.top + 2, box.bottom - 2].every((y) => document.elementFromPoint(box.left + 20, y)?.closest(place));
}"""


def test_a_lost_connection_does_not_cover_the_report_of_a_stop(page):
    page.context.set_offline(True)
    page.locator("#lost").wait_for()
    page.keyboard.press("Space")
    page.locator("#stopped[data-state=unconfirmed]").wait_for()
    for width in (390, 1280):
        page.set_viewport_size({"width": width, "height": 800})
        page.evaluate("scrollTo(0, document.body.scrollHeight)")
        assert [page.evaluate(UNCOVERED, banner) for banner in ("header", "#stopped", "#lost")] == [True] * 3
    page.context.set_offline(False)
