"""History of the newest events, each with a log line."""

import logging
from dataclasses import replace

from softarm.daemon.control.records import EStop, Inputs, Mode, Outputs
from softarm.daemon.logbook.history import KEPT, History

OUTPUTS = Outputs(0, 1, 0, 0, 0, Mode.DISARMED, EStop.CLEAR)


def history():
    return History("abc", lambda: 1_000, lambda: 1_800_000_000_000_001_000)


def turned(made, times):
    """Take ticks whose mode changes every time."""
    for tick in range(1, times + 1):
        mode = Mode.ARMED if tick % 2 else Mode.DISARMED
        made.take(Inputs(tick), replace(OUTPUTS, t_ns=tick * 10**9, tick=tick, mode=mode))


def test_each_entry_is_one_log_line_and_a_stop_a_warning(caplog):
    made = history()
    with caplog.at_level(logging.INFO, "softarm.events"):
        turned(made, 2)
        stop = replace(OUTPUTS, t_ns=3, tick=3, mode=Mode.STOPPED, last_stop="a hand", last_stop_ns=3)
        made.take(Inputs(3), stop)
    assert [(record.levelname, record.message) for record in caplog.records] == [
        ("INFO", "disarmed → armed"),
        ("INFO", "armed → disarmed"),
        ("WARNING", "emergency stop: a hand"),
    ]


def test_a_thousand_entries_are_kept():
    made = history()
    turned(made, KEPT + 7)
    assert [made.entries[0].number, made.entries[-1].number] == [8, KEPT + 7]
    assert len(made.entries) == KEPT
