"""The robot's stages alone: driven by what was measured each is as measured, and an effect shows where it should."""

from pathlib import Path

import numpy as np
import pytest

from softarm.diagnosis.data.trials import Series, Trial
from softarm.diagnosis.engine.structure import structure
from softarm.diagnosis.robot.candidates import candidates
from softarm.diagnosis.robot.trial_grid import on_grid
from softarm.diagnosis.robot.views import ON_MOTOR, robot_views
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY

MODEL = Model()
SEEN_STAGES = ("pressure", "rail", "arm", "mocap")


@pytest.fixture(scope="module")
def views(record):
    """All four stages of this very simulator, flown at 1200 Hz and seen through noisy sensors."""
    trials = [record(name, seed=i) for i, name in enumerate(("pressure-multisine", "rail-steps"))]
    return {view.stage: view for view in robot_views(on_grid(trials, MODEL), MODEL)}


@pytest.fixture(scope="module")
def points():
    """Effect -> its exemplar in every form of it (where an encoder sits, ...)."""
    found = {}
    for each in candidates(MODEL):
        own = {f"{each.name}.{p.name}": p.exemplar for p in REGISTRY[each.name].parameters}
        found.setdefault(each.name, []).append(own | dict(each.form))
    return found


@pytest.fixture(scope="module")
def changed(views, points):
    """(stage, effect) -> RMS change of the gap over the floor, of the form that shows most; one batch a stage."""
    names = [name for name, forms in points.items() for _ in forms]
    found = {}
    for stage, view in views.items():
        gaps = view.gap([{}, *(form for forms in points.values() for form in forms)])
        for name, gap in zip(names, gaps[1:], strict=True):
            size = float(np.sqrt(np.nanmean(((gap - gaps[0]) / view.floor) ** 2)))
            found[stage, name] = max(found.get((stage, name), 0.0), size)
    return found


def test_at_nominal_the_gap_is_the_sensors_noise(views):
    assert set(views) == set(SEEN_STAGES)
    for view in views.values():
        gap = view.gap([{}])[0]
        rms = np.sqrt(np.nanmean(gap**2, axis=0)) / view.floor
        assert (rms < 1.0).all(), (view.stage, rms)
        assert (rms > 0.01).all(), (view.stage, rms)  # noise there is


def test_views_agree_on_their_samples(views):
    for view in views.values():
        m, s = view.measured.shape
        assert view.gap([{}, {}]).shape == (2, m, s)
        assert (len(view.channels), len(view.floor)) == (s, s)
        assert view.t_s.shape == view.trial.shape == (m,)
        assert (np.diff(view.trial) >= 0).all()
        assert all(values.shape == (m,) and np.isfinite(values).all() for values in view.features.values())
        assert all(mask.shape == (m,) and mask.dtype == bool for mask in view.regimes.values())
        assert all(view.regimes[name].any() for name in ("inflating", "deflating", "cart moving"))


def test_every_effect_that_is_fitted_shows_in_some_view(views, points):
    declared = frozenset().union(*(view.acts for view in views.values()))
    assert {path.rpartition(".")[0] for path in declared if path.rpartition(".")[0] in REGISTRY} >= set(points)


@pytest.mark.parametrize("stage", SEEN_STAGES)
def test_an_effect_changes_the_views_that_declare_it_and_no_other(stage, views, points, changed):
    """At its exemplar. What a view does not declare it is never asked again for, so it must not depend on it."""
    shown = 0
    for name in points:
        declared = any(f"{name}.{p.name}" in views[stage].acts for p in REGISTRY[name].parameters)
        if declared:
            assert changed[stage, name] > 0.02, (stage, name)
            shown += 1
        else:
            assert changed[stage, name] == 0, (stage, name)
    assert shown >= 4


def test_an_effect_shows_most_in_its_own_stage_or_where_nothing_else_could(points, changed):
    for name in points:
        home = REGISTRY[name].stage
        if home in ("pressure", "rail") and name not in ("pressure.sensor_bias", "rail.gain", "rail.backlash"):
            assert changed[home, name] == max(changed[stage, name] for stage in SEEN_STAGES), name


@pytest.mark.parametrize("stage", SEEN_STAGES)
def test_a_batch_of_points_is_each_point_alone(stage, views, points):
    view = views[stage]
    some = [{}, *(forms[-1] for name, forms in points.items() if REGISTRY[name].stage == stage)][:6]
    assert len(some) > 3
    together = view.gap(some)
    for point, gap in list(zip(some, together, strict=True))[::2]:
        np.testing.assert_allclose(view.gap([point])[0], gap, atol=0.01 * float(view.floor.min()))


def test_an_encoder_on_the_motor_believes_in_a_wrong_feed(views):
    """Its read-back is as commanded whatever the belt does; mocap sees the true way. On the cart it is the reverse."""
    wrong = {"rail.gain.scale": 0.1}
    on_cart, on_motor, right = wrong, wrong | {ON_MOTOR: 1.0}, {}
    rail, mocap, arm = (views[stage].gap([right, on_cart, on_motor]) for stage in ("rail", "mocap", "arm"))
    assert np.nanmax(np.abs(rail[1] - rail[0])) > 0.01
    np.testing.assert_array_equal(rail[2], rail[0])
    np.testing.assert_array_equal(mocap[1], mocap[0])
    np.testing.assert_array_equal(arm[1], arm[0])
    way = views["mocap"].grid
    expected = 0.1 * way.flat(way.axis_m)
    np.testing.assert_allclose((mocap[0] - mocap[2])[:, 0], expected, atol=1e-6)
    assert np.nanmax(np.abs(arm[2] - arm[0])) > 1e-3


def test_an_encoder_on_the_motor_never_sees_play(views):
    play = {"rail.backlash.gap": 0.004}
    rail, mocap = (views[stage].gap([{}, play, play | {ON_MOTOR: 1.0}]) for stage in ("rail", "mocap"))
    assert np.nanmax(np.abs(rail[1] - rail[0])) > 0.01
    np.testing.assert_array_equal(rail[2], rail[0])
    np.testing.assert_array_equal(mocap[1], mocap[0])
    moved = np.abs(mocap[2] - mocap[0])[:, 0]
    assert 0.001 < np.nanmax(moved) < 0.0021  # half the play, either way


def _swing(late_s):
    """Ten seconds of an arm that swings at 1.1 Hz under a cart that is not driven, with late poses."""
    t, n = np.arange(600) / 60, MODEL.arm.links
    angle = 0.3 * np.sin(2 * np.pi * 1.1 * (t - late_s))
    cart = np.zeros(len(t))
    poses = {"cart_y": cart, "cart_z": cart + MODEL.arm.base_height_m, "cart_angle": cart}
    for i, reach in enumerate(np.cumsum(MODEL.arm.link_length_m), 1):
        y, z = reach * np.sin(angle), MODEL.arm.base_height_m - reach * np.cos(angle)
        poses |= {f"link{i}_y": y, f"link{i}_z": z, f"link{i}_angle": angle}
    assert len(poses) == 3 * (n + 1)
    channels = {
        "command": Series(t, {"cart_velocity": cart, "pressure": cart}),
        "rail": Series(t, {"position": cart, "velocity": cart}),
        "mocap": Series(t, poses),
    }
    return Trial("swing", "swing", Path("swing"), channels, "free")


def test_late_poses_push_the_cart_late_without_a_gap_of_the_rail():
    """The arm's push is taken from mocap: with the latency known the axis is pushed as it was seen without one."""
    late_s = 0.04
    prompt, late = (
        next(v for v in robot_views(on_grid([_swing(x)], MODEL), MODEL) if v.stage == "rail") for x in (0.0, late_s)
    )
    inner = slice(60, -60)
    right = prompt.gap([{}])[0, inner]
    uncorrected, known = late.gap([{}, {"mocap.latency.delay": late_s}])[:, inner]
    assert np.abs(uncorrected - right).max() > 0.1 * np.abs(right).max()
    assert np.abs(known - right).max() < 0.02 * np.abs(right).max()


def test_a_start_that_was_seen_wrong_shows_in_its_own_trial(views):
    directions = views["arm"].start_directions()
    assert directions.shape == (10, *views["arm"].measured.shape)
    assert (np.nanmax(np.abs(directions), axis=(1, 2)) > 5e-4).all()


def test_the_rail_is_looked_at_by_end_and_by_direction(views):
    regimes, grid = views["rail"].regimes, views["rail"].grid
    ends = [regimes[f"cart beyond 0.1 m at the {end} end"] for end in ("+y", "-y")]
    ways = [regimes[f"cart going to {way}"] for way in ("+y", "-y")]
    for parts, whole, signal in ((ends, "cart beyond 0.1 m", grid.hinge_m), (ways, "cart moving", grid.hinge_m_s)):
        np.testing.assert_array_equal(parts[0] | parts[1], regimes[whole])
        assert (grid.flat(signal)[parts[0]] > 0).all()
        assert (grid.flat(signal)[parts[1]] < 0).all()


@pytest.mark.parametrize(("stage", "where"), [("rail", "in the first 4 s"), ("pressure", "from 5 to 10 kPa")])
def test_an_effect_in_one_regime_is_found_there(stage, where, views):
    """On the whole it is within the floor, and it is the same each time."""
    view = views[stage]
    noise = 0.3 * np.random.default_rng(2).normal(size=view.measured.shape)
    assert structure(view, view.floor * noise).energy == 0
    found = structure(view, view.floor * (noise + np.where(view.regimes[where][:, None], 1.5, 0.0)))
    assert found.energy > 1.0
    assert found.where.startswith(where), found.where
