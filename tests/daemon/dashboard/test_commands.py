"""Every button works when it is enabled and explains why it is disabled."""

import re
import threading
from dataclasses import replace

import pytest

pytestmark = pytest.mark.slow


def can(page, button: str) -> bool:
    return page.locator(f"#do-{button}").get_attribute("aria-disabled") == "false"


def why(page, button: str) -> str:
    """Return the explanation after pressing a disabled button."""
    page.locator(f"#do-{button}").click(force=True)
    return page.locator("#why-not").inner_text()


def in_mode(page, mode: str) -> None:
    page.locator(f"#mode[data-mode={mode}]").wait_for()


def test_the_buttons_arm_and_disarm(page, robot):
    assert page.locator("#reasons .ready").inner_text() == "Ready to arm."
    page.locator("#do-arm").click()
    in_mode(page, "armed")
    assert robot.status["mode"] == "armed"
    assert page.locator("#mode-title").inner_text() == "Armed"
    page.locator("#do-disarm").click()
    page.locator("#mode:is([data-mode=stopping], [data-mode=disarmed])").wait_for()
    assert robot.status["mode"] in ("stopping", "disarmed")


def test_the_button_acknowledges_a_stop(page, robot):
    robot.ask("/api/stop")
    page.locator("#reasons .reason.refusal", has_text="latched").wait_for()
    assert "The emergency stop is latched" in page.locator("#reasons").inner_text()
    assert "POST" not in page.locator("main").inner_text()
    page.locator("#do-acknowledge").click()
    in_mode(page, "disarmed")
    assert robot.status["estop"] == "clear"


def test_the_button_resets_a_drive_in_fault_and_then_acknowledges(page, robot, daemon, monkeypatch):
    """The daemon resets a drive only on request, so the button works while the cause is present."""
    robot.arm()
    rail = daemon.loop._devices.rail
    read, reset = rail.read, threading.Event()
    monkeypatch.setattr(rail, "read", lambda: replace(read(), faults=() if reset.is_set() else ("E11",)))
    monkeypatch.setattr(type(rail), "reset_fault", lambda self: reset.set())
    robot.until(lambda status: status["estop"] == "engaged")
    page.locator("#do-acknowledge[aria-disabled=false]").click()
    page.locator("#said .refused", has_text="a fault reset was sent").wait_for()
    robot.until(lambda status: status["estop"] == "latched")
    page.locator("#do-acknowledge[aria-disabled=false]").click()
    in_mode(page, "disarmed")


def test_the_buttons_hold_and_cancel(page, robot):
    robot.arm()
    in_mode(page, "armed")
    page.locator("#do-hold").click()
    page.wait_for_function("() => document.querySelector('#goal').textContent.includes('hold')")
    assert robot.status["goal"]["goal"]["kind"] == "hold"
    robot.ask("/api/goal", {"kind": "reach", "y_m": 0.55, "z_m": 0.84})  # out of the policy's range
    page.locator("#do-cancel[aria-disabled=false]").dispatch_event("click")
    page.locator("#goal dd", has_text="cancelled,").wait_for()
    assert robot.status["goal"]["state"] == "cancelled"


def test_run_is_offered_for_a_policy_without_target(page, robot):
    assert page.locator("#do-run").is_hidden()
    page.get_by_role("button", name="Use hold").click()
    page.locator("#said >> text=Policy hold in use").wait_for()
    page.locator("#do-run").wait_for()
    robot.arm()
    page.locator("#do-run[aria-disabled=false]").click()
    page.wait_for_function("() => document.querySelector('#goal dd').textContent === 'run'")
    assert robot.status["goal"]["goal"]["kind"] == "run"
    robot.calm()
    page.get_by_role("button", name="Use reach", exact=True).click()
    page.locator("#said >> text=Policy reach in use").wait_for()


def test_a_disabled_button_explains_why(page, robot):
    assert {name for name in ("arm", "disarm", "acknowledge", "hold", "cancel") if can(page, name)} == {"arm"}
    assert why(page, "disarm") == "Disarm: The robot is not armed."
    assert why(page, "acknowledge") == "Acknowledge: No emergency stop is latched."
    assert why(page, "hold") == "Hold: Arm the robot first."
    assert robot.status["mode"] == "disarmed"
    robot.arm()
    in_mode(page, "armed")
    assert why(page, "arm") == "Arm: The robot is already armed."
    assert why(page, "cancel") == "Cancel goal: No goal is running."


def test_reasons_against_arming_are_shown_with_the_next_step(page, robot, daemon, monkeypatch):
    cameras = daemon.loop._devices.mocap
    real = cameras.read
    monkeypatch.setattr(cameras, "read", lambda now_ns: real(now_ns)[:0])  # the cameras are covered
    page.locator("#reasons .reason").first.wait_for()
    page.wait_for_function("() => document.querySelector('#reasons').textContent.includes('Cannot be armed')")
    refused = robot.ask("/api/arm")
    assert refused.status_code == 409
    shown = page.locator("#reasons").inner_text().lower()
    for reason in refused.json()["reasons"]:
        wrong = re.split(r"[(:]", reason)[0].strip().lower()
        assert wrong in shown
    assert "next: " in shown
    page.locator("#do-arm").click()
    page.locator("#said .notice.refused li").first.wait_for()
    assert robot.status["mode"] == "disarmed"
    assert page.locator("#drawing .links").get_attribute("points")  # the last pose stays
