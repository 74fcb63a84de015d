"""Trials on one grid: every command comes when it came, every gap stays a gap, and what is missing is missing alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softarm.diagnosis.data.trials import Series, Trial, TrialError, mocap_columns
from softarm.diagnosis.robot.trial_grid import STEP_S, on_grid
from softarm.diagnosis.robot.views import robot_views
from softarm.schemas.model import Model

LENGTH_S = 6.0
MODEL = Model()
BRIEF = Series(5.0 + 0.1 * np.arange(15), {"pressure": np.zeros(15)})


def _trial(commands_s=None, **changed):
    """Pressure, rail and mocap at 60 Hz from time 2 on; the i-th command asks for i kPa at commands_s[i]."""
    t = 2.0 + np.arange(round(LENGTH_S * 60) + 1) / 60
    commands_s = 2.0 + np.arange(0, LENGTH_S, 1 / 30) if commands_s is None else np.asarray(commands_s)
    number = np.arange(len(commands_s), dtype=float)
    way = 0.05 * np.sin(2 * np.pi * (t - 2.0))
    poses = {name: np.zeros(len(t)) for name in mocap_columns()}
    poses["t_receive"] = t + 0.004
    for i, body in enumerate(("cart", *(f"link{i}" for i in range(1, 6)))):
        poses[f"{body}_y"], poses[f"{body}_z"] = way.copy(), np.full(len(t), 0.965 - 0.0885 * i)
    channels = {
        "command": Series(commands_s, {"cart_velocity": 0.01 * number, "pressure": number}),
        "pressure": Series(t.copy(), {"pressure": 5 + np.sin(t)}),
        "rail": Series(t.copy(), {"position": way.copy(), "velocity": np.gradient(way, 1 / 60)}),
        "mocap": Series(t.copy(), poses),
    }
    return Trial("one", "one", Path("campaign/one"), channels | changed)


def _came(shown, number):
    """When a command takes effect on the grid, s."""
    step = int(np.flatnonzero(shown.pressure_command_kpa[:, 0] == number)[0])
    return shown.t_s[step, 0] + shown.late_s[step, 0]


def _without(trial, *channels):
    return replace(trial, channels={k: v for k, v in trial.channels.items() if k not in channels})


def test_a_link_that_no_trial_tracked_is_refused():
    mocap = _trial().channels["mocap"]
    trials = 2 * [_trial(mocap=Series(mocap.t_s, {**mocap.columns, "link5_y": np.full(len(mocap), np.nan)}))]
    with pytest.raises(TrialError, match=r"campaign/one: no trial has a pose of link5; track each link's end"):
        on_grid(trials, MODEL)
    assert on_grid([*trials, _trial()], MODEL).links == 5


def test_commands_keep_their_stamps():
    late = 0.009 * np.random.default_rng(0).random(170)
    stamps = 2.0 + np.arange(170) / 30 + late
    shown = on_grid([_trial(stamps)], MODEL)
    assert shown.t_s[0, 0] == stamps[0]
    for number in range(1, 160):
        assert _came(shown, number) == pytest.approx(stamps[number], abs=1e-9)
    np.testing.assert_allclose(shown.cart_velocity_m_s, 0.01 * shown.pressure_command_kpa)


def test_of_two_commands_within_a_step_both_come_one_after_the_other():
    stamps = 2.0 + np.array([0.0, 1.0, 1.002, 1.5, 6.0])
    shown = on_grid([_trial(stamps)], MODEL)
    assert _came(shown, 1) == pytest.approx(3.0, abs=1e-9)
    assert _came(shown, 2) == pytest.approx(3.002, abs=STEP_S)
    assert _came(shown, 2) > _came(shown, 1)
    assert _came(shown, 3) == pytest.approx(3.5, abs=1e-9)


def test_a_missing_tick_leaves_the_command_as_it_was():
    stamps = np.delete(2.0 + np.arange(170) / 30, [50, 51, 52])
    shown = on_grid([_trial(stamps)], MODEL)
    t = shown.t_s[:, 0]
    silent = (t > stamps[49] + 1e-6) & (t < stamps[50] - 1e-6)
    assert silent.sum() > 5
    assert set(shown.pressure_command_kpa[silent, 0]) == {49.0}
    assert _came(shown, 50) == pytest.approx(stamps[50], abs=1e-9)


def test_gaps_are_not_bridged():
    pressure = _trial().channels["pressure"]
    t, values = pressure.t_s, pressure["pressure"]
    here = ~(((t > 4.0) & (t < 4.5)) | ((t > 5.0) & (t < 5.04)))
    shown = on_grid([_trial(pressure=Series(t[here], {"pressure": values[here]}))], MODEL)
    grid, seen = shown.t_s[:, 0], np.isfinite(shown.pressure_kpa[:, 0])
    assert not seen[(grid > 4.01) & (grid < 4.49)].any()
    assert seen[(grid < 3.98) | (grid > 4.52)].all()
    np.testing.assert_allclose(shown.pressure_kpa[seen, 0], 5 + np.sin(grid[seen]), atol=1e-4)


def test_a_hidden_marker_is_missing_alone():
    trial = _trial()
    poses = {name: values.copy() for name, values in trial.channels["mocap"].columns.items()}
    poses["link3_y"][100:160] = np.nan
    shown = on_grid([_trial(mocap=Series(trial.channels["mocap"].t_s, poses))], MODEL)
    hidden = np.isnan(shown.links_m[110:150, 0])
    assert hidden[:, 2].all()
    assert not np.delete(hidden, 2, axis=1).any()
    assert np.isfinite(shown.hinge_m).all()


def test_the_cameras_drift_is_taken_out():
    """A clock that runs half a part in a thousand slow is 3 ms off after six seconds: reception shows it."""
    draw = np.random.default_rng(0)
    true = 2.0 + np.arange(round(LENGTH_S * 120)) / 120
    stamps = 2.0 + (true - 2.0) * (1 - 5e-4)
    still = _trial().channels["mocap"]
    poses = {name: np.interp(true, still.t_s, still[name]) for name in mocap_columns()}
    poses["cart_y"] = 0.05 * np.sin(2 * np.pi * (true - 2.0))
    poses["t_receive"] = true + 0.004 + 0.001 * draw.random(len(true))
    shown = on_grid([_trial(mocap=Series(stamps, poses))], MODEL)
    late = shown.t_s[:, 0] > 2.0 + LENGTH_S - 1
    wanted = 0.05 * np.sin(2 * np.pi * (shown.t_s[late, 0] - 2.0))
    left = np.sqrt(np.mean((shown.cart_y_m[late, 0] - wanted) ** 2))
    untouched = np.interp(shown.t_s[late, 0], stamps, poses["cart_y"])
    assert left < 0.2 * np.sqrt(np.mean((untouched - wanted) ** 2))


def test_a_steady_delay_of_reception_is_no_drift():
    shown = on_grid([_trial()], MODEL)
    np.testing.assert_allclose(shown.cart_y_m[:, 0], 0.05 * np.sin(2 * np.pi * (shown.t_s[:, 0] - 2.0)), atol=1e-4)


def test_a_held_rail_stands_still():
    held = on_grid([replace(_trial(), rail="held")], MODEL)
    assert not held.cart_velocity_m_s.any()
    assert np.ptp(held.hinge_m) == 0
    both = robot_views(on_grid([_trial(), replace(_trial(), rail="held")], MODEL), MODEL)
    rail = next(view for view in both if view.stage == "rail")
    assert [bool(np.isfinite(rail.measured[rail.trial == k]).any()) for k in (0, 1)] == [True, False]
    assert {v.stage for v in robot_views(held, MODEL)} == {"pressure", "mocap", "arm"}


@pytest.mark.parametrize(
    ("channels", "stages"),
    [
        ((), {"pressure", "rail", "mocap", "arm"}),
        (("pressure",), {"rail", "mocap"}),
        (("rail",), {"pressure", "arm"}),
        (("mocap",), {"pressure", "rail"}),
        (("rail", "mocap"), {"pressure"}),
    ],
    ids=lambda x: "+".join(sorted(x)) or "none",
)
def test_a_missing_channel_takes_its_own_stages_away_and_no_other(channels, stages):
    trial = _without(_trial(), *channels)
    views = robot_views(on_grid([trial], MODEL), MODEL)
    assert {view.stage for view in views} == stages
    for view in views:
        assert np.isfinite(view.gap([{}])).any()


def test_a_stage_that_keeps_its_channels_does_not_see_that_others_are_gone():
    whole, part = (robot_views(on_grid([each], MODEL), MODEL) for each in (_trial(), _without(_trial(), "mocap")))
    np.testing.assert_array_equal(whole[0].gap([{}]), part[0].gap([{}]))


def _halved(trial):
    halves = {}
    for name, series in trial.channels.items():
        n = len(series) // 2
        halves[name] = Series(series.t_s[:n], {column: values[:n] for column, values in series.columns.items()})
    return replace(trial, name="two", channels=halves)


def test_trials_of_unlike_lengths_lie_side_by_side():
    short = _halved(_trial())
    both, alone = on_grid([_trial(), short], MODEL), on_grid([short], MODEL)
    (step, trial), length = both.sample, len(alone.t_s)
    assert np.bincount(trial).tolist() == [len(both.t_s) - 30, length - 30]
    np.testing.assert_array_equal(both.pressure_kpa[:length, 1], alone.pressure_kpa[:, 0])
    assert step[trial == 1].max() == length - 1


MOCAP = _trial().channels["mocap"]
FOUR = Series(MOCAP.t_s, {name: x for name, x in MOCAP.columns.items() if not name.startswith("link5")})


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda t: _without(t, "command"), "command"),
        (lambda t: _without(t, "pressure", "rail", "mocap"), "no measurements"),
        (lambda t: replace(t, channels=t.channels | {"pressure": BRIEF}), r"cover only 1\.4 s, at least 2 s"),
        (lambda t: replace(t, channels=t.channels | {"mocap": FOUR}), "mocap sees 4 links, the model has 5"),
    ],
    ids=["no commands", "nothing measured", "too short", "other links"],
)
def test_errors_name_the_file_and_the_next_step(spoil, message):
    with pytest.raises(TrialError, match=message) as caught:
        on_grid([spoil(_trial())], MODEL)
    assert str(Path("campaign/one")) in str(caught.value)
