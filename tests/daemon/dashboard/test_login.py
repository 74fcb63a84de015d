"""Log-in by token in three roles; each keeps the stop."""

import re
from urllib.parse import urlsplit

import pytest

pytestmark = pytest.mark.slow

TOKENS = {"command": "c" * 32, "view": "v" * 32, "stop": "s" * 32}


@pytest.fixture(scope="module")
def daemon(tmp_path_factory, browser, started):
    """Yield a daemon that requires a token."""
    folder = tmp_path_factory.mktemp("tokens")
    keys = {"command": "token_file", "view": "view_token_file", "stop": "stop_token_file"}
    for role, token in TOKENS.items():
        (folder / role).touch(0o600)
        (folder / role).write_text(token)
    with started(folder, **{key: folder / role for role, key in keys.items()}) as made:
        yield made


@pytest.fixture
def authorization():
    return {"Authorization": f"Bearer {TOKENS['command']}"}


def log_in(page, token: str) -> None:
    page.locator("#token").fill(token)
    page.get_by_role("button", name="Log in").click()


# Over 3 s: a log-in in each of three roles.
def test_a_log_in_has_the_rights_of_its_role_and_leaves_no_token_in_the_page(robot, opened, daemon, press):
    robot.arm()
    page = opened(look=False)
    page.locator("#login").wait_for()
    assert page.locator("#arm").is_hidden()
    log_in(page, "w" * 32)
    page.locator("#login-said >> text=The token is wrong").wait_for()
    page.locator("#token").fill("")
    page.locator("#token").press_sequentially("a b")
    assert page.locator("#token").input_value() == "a b"
    page.locator("#stop").click()
    page.locator("#stopped[data-state=unconfirmed]").wait_for()
    assert "NOT confirmed. Use the emergency-stop button" in page.locator("#stopped").inner_text()
    assert "token" in page.locator("#stopped").inner_text()
    assert robot.status["mode"] == "armed"
    log_in(page, TOKENS["stop"])
    page.locator("#login-why >> text=Your token may only stop the robot").wait_for()
    assert page.locator("#arm").is_hidden()
    with page.expect_response(lambda answer: answer.url == f"{daemon.url}/api/stop" and answer.ok):
        page.locator("#stop").click()
    page.locator("#stopped[data-state=stopped]").wait_for()
    assert robot.status["mode"] == "stopped"

    robot.calm()
    log_in(page, TOKENS["command"])
    page.locator("#link[data-link=live]").wait_for()
    assert page.locator("#who").inner_text().split() == ["command", "Log", "out"]
    page.locator("#do-arm[aria-disabled=false]").click()
    page.locator("#mode[data-mode=armed]").wait_for()
    assert page.locator("#token").input_value() == ""
    kept = page.evaluate(
        "() => [document.cookie, ...Object.values(localStorage), ...Object.values(sessionStorage)].join()"
    )
    assert kept == ""
    page.reload()
    page.locator("#link[data-link=live]").wait_for()
    page.route(lambda url: urlsplit(url).port == daemon.port, lambda route: route.abort())
    with page.expect_event("requestfailed", lambda request: request.url == f"{daemon.url}/api/stop"):
        page.keyboard.press("Space")
    page.locator("#stopped[data-state=stopped]").wait_for()
    by = r": confirmed (via the dedicated stop port|by the robot's status)"
    assert re.search(by, page.locator("#stopped").inner_text())
    assert robot.status["mode"] == "stopped"
    page.locator("#mode[data-mode=stopped]").wait_for()
    page.unroute_all()
    page.get_by_role("button", name="Log out").click()
    page.locator("#login").wait_for()

    robot.calm()
    robot.arm()
    log_in(page, TOKENS["view"])
    page.locator("#link[data-link=live]").wait_for()
    page.locator("#why-not >> text=may only view and stop").wait_for()
    for button in ("arm", "disarm", "acknowledge", "hold", "reach"):
        assert page.locator(f"#do-{button}").get_attribute("aria-disabled") == "true"
    page.locator("#drawing svg").wait_for()
    page.locator("#stopped").wait_for(state="hidden")
    press(page, -0.2, 0.65)
    page.locator("#said .notice.refused >> text=may only view and stop").wait_for()
    assert robot.status["goal"]["number"] == 0
    page.keyboard.press("Space")
    page.locator("#stopped[data-state=stopped]").wait_for()
    assert robot.status["mode"] == "stopped"

    page.locator("#mode[data-mode=stopped]").wait_for()
    page.evaluate("() => fetch('api/logout', { method: 'POST' })")  # as in another tab
    page.locator("#login").wait_for()
    page.locator("body.old #mode[data-mode=stopped]").wait_for()  # the mode is old, and grey
    assert page.title() == "Not connected · softarm"
