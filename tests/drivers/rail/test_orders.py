"""Validity of the daemon's set-points, and the packets that carry them."""

import contextlib
import math
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from softarm.drivers.rail import pair
from softarm.drivers.rail.orders import Orders
from softarm.drivers.rail.pair import Reading, Report, SetPoint

MS = 1_000_000
HOLD_MS, LIVE_MS = 45, 150

# Each step: a time that passes, then a set-point with its delay (negative: stamped in the future), or None.
steps = st.lists(
    st.tuples(
        st.integers(0, 250),
        st.none() | st.tuples(st.booleans(), st.integers(-60, 60), st.floats(-1, 1) | st.just(math.nan)),
    ),
    max_size=40,
)


@given(steps)
def test_only_a_fresh_and_permitted_set_point_moves_the_cart(script: list[Any]) -> None:
    orders, now_ms = Orders(HOLD_MS / 1e3, LIVE_MS / 1e3), 1000
    was_disabled = permitted = False
    sent_ms, velocity = -math.inf, 0.0
    for passed_ms, received in script:
        now_ms += passed_ms
        if permitted and now_ms - sent_ms > LIVE_MS:
            was_disabled = permitted = False
        orders.expire(now_ms * MS)
        assert (orders.permitted_since_ns is not None) == permitted
        if received is not None:
            enable, delay_ms, velocity = received
            stamp_ms = max(sent_ms, now_ms - delay_ms)
            sent_ms = min(stamp_ms, now_ms)
            begins = orders.accept(SetPoint(1, round(stamp_ms * MS), enable, velocity), now_ms * MS)
            assert begins == (enable and was_disabled)
            permitted = enable and (permitted or was_disabled)
            was_disabled = not enable
        allowed = orders.velocity_m_s(now_ms * MS)
        fresh = now_ms - sent_ms <= HOLD_MS
        assert allowed == (velocity if permitted and fresh and math.isfinite(velocity) else 0.0)


numbers = st.floats(allow_nan=False)
sentences = st.text(st.characters(exclude_characters="\0", exclude_categories=("Cs",)), max_size=60)
stamps = st.integers(0, 2**62)
readings = st.builds(
    Reading, stamps, numbers, numbers, st.booleans(), st.booleans(), stamps, stamps, st.lists(sentences).map(tuple)
)


@given(st.builds(SetPoint, st.integers(0, 2**32 - 1), stamps, st.booleans(), numbers, st.integers(0, 2**32 - 1)))
def test_set_points_survive_encoding(message: SetPoint) -> None:
    assert pair.decode_set_point(pair.encode_set_point(message)) == message


@given(st.builds(Report, st.integers(0, 2**32 - 1), st.booleans(), st.none() | readings, st.none() | sentences))
def test_reports_survive_encoding(message: Report) -> None:
    assert pair.decode_report(pair.encode_report(message)) == message


def test_a_begin_message_carries_whether_the_drive_may_move() -> None:
    assert [pair.decode_begin(pair.encode_begin(may_move)) for may_move in (True, False)] == [True, False]


def test_long_sentences_are_cut() -> None:
    packet = pair.encode_report(Report(1, True, None, "x" * 20_000))
    assert len(packet) == pair.PACKET_MAX
    assert set(pair.decode_report(packet).problem or "") == {"x"}


@given(st.binary(max_size=80))
def test_an_invalid_packet_raises_value_error_only(packet: bytes) -> None:
    for decode in (pair.decode_set_point, pair.decode_report, pair.decode_begin):
        with contextlib.suppress(ValueError):
            decode(packet)  # type: ignore[operator]
            assert packet[0] == pair.VERSION
