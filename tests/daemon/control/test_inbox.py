import pytest

from softarm.daemon.control.inbox import Inbox, InboxFull
from softarm.schemas.goals import Goal


def kinds(inbox: Inbox) -> list[str]:
    return [post.request.kind for post in inbox.take()]


def test_requests_come_out_once_in_order_with_growing_numbers():
    inbox = Inbox()
    first = inbox.post("arm")
    second = inbox.post("goal", goal=Goal("hold"))
    assert second > first
    assert kinds(inbox) == ["arm", "goal"]
    assert kinds(inbox) == []


def test_a_stop_is_first_and_accepted_by_a_full_inbox():
    inbox = Inbox(capacity=2)
    inbox.post("arm")
    inbox.post("cancel_goal")
    with pytest.raises(InboxFull, match="has not taken the last 2 requests"):
        inbox.post("arm")
    inbox.post("stop")
    assert kinds(inbox) == ["stop", "arm", "cancel_goal"]


def test_waiting_stops_share_one_number():
    inbox = Inbox(capacity=2)
    number = inbox.post("stop")
    inbox.post("arm")
    assert {inbox.post("stop") for _ in range(1000)} == {number}
    assert kinds(inbox) == ["stop", "arm"]
    assert inbox.post("stop") > number
