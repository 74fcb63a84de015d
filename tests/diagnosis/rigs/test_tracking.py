"""Actuators that follow a command: laws against an independent integration, bounds and noise floors from data."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from softarm.diagnosis.data.trials import Series, TableStage, TableUnit
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.rigs.candidates import candidates, nuisances
from softarm.diagnosis.rigs.diagnose import diagnose_table
from softarm.diagnosis.rigs.scales import fastest, lateness, repeatability, white_noise
from softarm.diagnosis.rigs.tracking import TrackingView, resolving_hz
from tests.diagnosis.rigs.recordings import alone, recording

STEP_S, FINE = 0.02, 20
T = STEP_S * np.arange(800)
# Effects that look alike between command and reading; backlash and dead band only without a lag.
ALIKE = {"sensor_bias": "gain", "latency": "dead_time", "deadband": "backlash", "backlash": "deadband"}
KINDS = "steps", "multisine", "sweep", "ramps"
TWO = "steps", "multisine"


def commands(t=T):
    """Return commands of several kinds, at most about 1."""
    late = t / t[-1]
    return {
        "steps": np.select([np.sin(12 * late * (1 + i)) > 0.3 * i for i in range(3)], (0.8, -0.5, 0.2), -0.9),
        "multisine": sum(0.3 * np.sin(2 * np.pi * f * 16 * late + f) for f in (0.2, 0.5, 1.1, 2.3)),
        "sweep": (0.4 + 0.5 * late) * np.sin(2 * np.pi * 16 * late * (0.2 + 1.2 * late)),
        "ramps": 0.9 * np.abs((8 * late) % 2 - 1) - 0.4,
    }


def rig(command, truth):
    """Simulate the readings of an actuator independently, in steps of a twentieth of a sample."""
    h = STEP_S / FINE
    fine = np.repeat(command, FINE)
    late = round((truth.get("delay", 0.0) + truth.get("latency", 0.0)) / h)
    fine = np.concatenate((np.full(late, fine[0]), fine))[: len(fine)]
    fine = np.minimum(fine * (1 + truth.get("scale", 0.0)) + truth.get("offset", 0.0), truth.get("limit", math.inf))
    gap, width = truth.get("gap", 0.0), truth.get("width", 0.0)
    lags = "lag" in truth or "rise" in truth
    lag = truth.get("lag", h)
    rise, fall = max(truth.get("rise", lag), h), max(truth.get("fall", lag), h)
    rate, most = truth.get("rate", math.inf), truth.get("acceleration", math.inf) * h
    down = truth.get("down", rate)
    loop, height = truth.get("loop", 0.0), truth.get("height", 0.0)
    w, zeta, between = (truth.get(key, 0.0) for key in ("w", "zeta", "between"))

    def slope(error):
        beyond = math.copysign(max(abs(error) - width, 0.0), error)
        return min(max(beyond / (rise if beyond > 0 else fall), -down), rate)

    y = v = x = 0.0
    seen = hung = speed = 0.0
    out = np.empty(len(command))
    for i, target in enumerate(fine.tolist()):
        if i % FINE == 0:
            seen = min(max(seen, x - gap / 2), x + gap / 2)
            out[i // FINE] = seen + truth.get("bias", 0.0) - height * hung
        wanted, led, before = slope(target - y), y, x
        if lags:
            wanted = 0.5 * (wanted + slope(target - (y + h * wanted)))
        v += min(max(wanted - v, -most), most)
        y += h * v
        if w:  # semi-implicit: a spring, a damper, a mass
            damped = 2 * zeta * w
            speed += h * (w**2 * (y - x) - damped * speed)
            speed += damped * between * (y - led)
            x += h * speed
        else:
            x = y
        if height:
            way = x - before
            parts = 1 + int(abs(way) / (0.01 * loop))
            for _ in range(parts):
                hung += (way - abs(way) * hung) / loop / parts
    return out


@cache
def readings(kind, truth):
    """Return the readings of a rig with these effects ((name, value), ...) under a command."""
    return rig(commands()[kind], dict(truth))


def trial(command, seen, t=T, kind="steps", model=None, column="position"):
    channels = {"command": {"command": command}, "measured": {column: seen}}
    return recording(kind, kind, t, channels, ("axis", "tracking", model or {}))


def flown(truth, noise=1e-3, quick=1.0, large=1.0, seed=0, kinds=KINDS):
    """Return trials of one rig under commands of these kinds; quick: factor of speed; large: factor of the unit."""
    draw = np.random.default_rng(seed)
    found = []
    for kind in kinds:
        command = commands()[kind]
        seen = readings(kind, tuple(truth.items())) + noise * draw.normal(size=len(T))
        found.append(trial(large * command, large * seen, T / quick, kind))
    return found


def fitted(trials):
    """Return the best fit of every effect alone, by name, the best first."""
    return alone(TrackingView(trials), [t.kind for t in trials])[0]


CASES = [
    ("gain", {"scale": -0.12, "offset": 0.06}, {"gain.scale": -0.12, "gain.offset": 0.06}),
    ("ceiling", {"limit": 0.55}, {"ceiling.limit": 0.55}),
    ("deadband", {"width": 0.06}, {"deadband.width": 0.06}),
    ("lag", {"rise": 0.25, "fall": 0.08}, {"lag.rise": 0.25, "lag.fall": 0.08}),
    ("dead_time", {"delay": 0.13}, {"dead_time.delay": 0.13}),
    ("latency", {"latency": 0.07}, {"latency.delay": 0.07}),
    ("rate_limit", {"rate": 2.0, "down": 5.0}, {"rate_limit.rate": 2.0, "rate_limit.fall": 5.0}),
    ("second_order", {"w": 12.0, "zeta": 0.3}, {"second_order.frequency": 1.91, "second_order.damping": 0.3}),
    ("second_order", {"w": 9.0, "zeta": 0.2, "between": 1.0},
     {"second_order.frequency": 1.432, "second_order.damping": 0.2, "second_order.coupling": 1.0}),
    ("backlash", {"gap": 0.1}, {"backlash.gap": 0.1}),
    ("hysteresis", {"height": 0.06, "loop": 0.3}, {"hysteresis.strength": 0.2, "hysteresis.width": 0.3}),
    ("sensor_bias", {"bias": 0.05}, {"sensor_bias.bias": 0.05}),
]  # fmt: skip


def predicted(trials, point):
    view = TrackingView(trials)
    (gap,) = view.gap([{f"axis.{k}": x for k, x in point.items()}])
    return float(np.sqrt(np.nanmean(gap.astype(float) ** 2)))


def test_an_acceleration_limit_agrees_with_an_independent_integration():
    """The acceleration limit is tested with a lag, because alone it rings."""
    trials = flown({"acceleration": 80.0, "lag": 0.1}, noise=0.0, kinds=TWO)
    lag = {"lag.rise": 0.1, "lag.fall": 0.1}
    nominal, own = predicted(trials, lag), predicted(trials, lag | {"acceleration_limit.acceleration": 80.0})
    assert own < 0.15 * nominal
    assert own < 0.012


# Of two effects of one kind the second is left to `make prove`.
SECOND = ("latency", "deadband", "sensor_bias")


@pytest.mark.parametrize(
    ("name", "truth", "point"),
    [pytest.param(*each, marks=pytest.mark.prove if each[0] in SECOND else ()) for each in CASES],
)
def test_the_cause_fits_best_with_its_true_size(name, truth, point):
    found = fitted(flown(truth, kinds=TWO))
    assert next(iter(found)) in {name, ALIKE.get(name)}
    if name == "latency":  # indistinguishable
        name, point = "dead_time", {"dead_time.delay": truth["latency"]}
    for path, value in point.items():  # stepped commands resolve a delay to half a step
        near = 0.55 * (T[1] - T[0]) if path == "dead_time.delay" else 0.006
        assert found[name].point[f"axis.{path}"] == pytest.approx(value, rel=0.12, abs=near)


@pytest.mark.parametrize("lag", [0.0, 0.1])
@pytest.mark.parametrize("late", [0.3, 0.5, 0.99])
def test_a_rate_limit_acts_from_the_change_of_the_command(lag, late):
    """Otherwise limits were 0.6 % low if the grid was half a sample off the command's clock."""
    command = np.where(T < 4.0, 0.0, 1.0)
    since = T + late * STEP_S - 4.0
    full = max(1.0 - 0.8 * lag, 0.0) / 0.8  # until the lag alone is slower
    after = 1.0 - 0.8 * lag * np.exp(-np.maximum(since - full, 0.0) / max(lag, 1e-9))
    seen = np.where(since < full, np.maximum(0.8 * since, 0.0), after)
    given = trial(command, seen, model={"lag_s": lag} if lag else {})
    measured = Series(T + late * STEP_S, {"position": seen})
    view = TrackingView([replace(given, channels={**given.channels, "measured": measured})])
    gap = view.gap([{"axis.rate_limit.rate": 0.8, "axis.rate_limit.fall": 0.8}])[0]
    assert np.nanmax(np.abs(gap)) < 1e-4


def rubbed(command, lag, loss):
    """Simulate a velocity loop with dry friction: lag dv/dt = command - v - loss."""
    h, v, out = STEP_S / 100, 0.0, np.empty(len(command))
    for i, wanted in enumerate(command):
        out[i] = v
        for _ in range(100):
            free = v + h * (wanted - v) / lag
            v = 0.0 if abs(free) <= h * loss / lag else free - math.copysign(h * loss / lag, free)
    return out


@pytest.mark.parametrize("lag", [0.1, 0.004])
def test_dry_friction_in_a_velocity_loop_is_not_a_dead_band(lag):
    draw, given = np.random.default_rng(0), {"axis.lag.rise": lag, "axis.lag.fall": lag}
    trials = []
    for kind in TWO:
        command = commands()[kind]
        seen = rubbed(command, lag, 0.08) + 1e-3 * draw.normal(size=len(T))
        trials.append(trial(command, seen, kind=kind, model={"lag_s": lag}, column="velocity"))
    view = TrackingView(trials)
    unseen, seen = view.gap([given, given | {"axis.coulomb_friction.loss": 0.08}]).astype(float)
    assert np.sqrt(np.nanmean(seen**2)) < 0.05 * np.sqrt(np.nanmean(unseen**2))
    found = fitted(trials)
    assert next(iter(found)) == "coulomb_friction"
    assert found["coulomb_friction"].point["axis.coulomb_friction.loss"] == pytest.approx(0.08, rel=0.03)
    assert "axis.coulomb_friction" not in {e.name for e in TrackingView(flown({"lag": 0.1}, kinds=TWO)).effects}


def test_a_dead_band_without_a_lag_equals_backlash_of_twice_its_width():
    found = fitted(flown({"width": 0.06}, kinds=TWO))
    assert found["backlash"].loss == pytest.approx(found["deadband"].loss, rel=0.05)
    assert found["backlash"].point["axis.backlash.gap"] == pytest.approx(0.12, rel=0.05)


def test_neutral_parameters_change_no_bit():
    trials = flown({"lag": 0.1}, kinds=TWO)
    view = TrackingView(trials)
    neutral = {f"{e.name}.{p.name}": p.neutral for e in view.effects for p in e.parameters}
    np.testing.assert_array_equal(*view.gap([{}, neutral]))
    shaped = {"axis.hysteresis.width": 0.7, "axis.second_order.damping": 1.3}
    np.testing.assert_array_equal(*view.gap([{}, shaped]))


@pytest.mark.parametrize(("quick", "large"), [(0.01, 300.0), (40.0, 2e-3), (1.0, 57.3)])
def test_bounds_and_boxes_scale_with_units_of_length_and_time(quick, large):
    truth = {"rise": 0.3, "fall": 0.1, "width": 0.05}
    powers = {"s": (1, 0), "Hz": (-1, 0), "-": (0, 0), "rad": (0, 1), "rad/s": (-1, 1), "rad/s^2": (-2, 1)}
    views = [TrackingView(flown(truth, quick=q, large=x, kinds=TWO)) for q, x in ((1.0, 1.0), (quick, large))]
    assert views[1].block_s * quick == pytest.approx(views[0].block_s)
    one, other = (candidates(view) for view in views)
    for a, b in zip(one, other, strict=True):
        for p, r in zip(a.parameters, b.parameters, strict=True):
            time, length = powers[p.unit]
            factor = quick**-time * large**length
            factor = 1 / factor if p.inverse else factor
            for of in ("low", "high", "size", "tolerance", "nominal"):
                assert getattr(r, of) == pytest.approx(getattr(p, of) * factor, rel=1e-6, abs=1e-12)


def parameter(trials, name):
    """Return a parameter of an effect of a rig."""
    return next(p for e in TrackingView(trials).effects for p in e.parameters if p.name == name)


def test_bounds_exclude_limits_that_the_recording_exceeds():
    assert 1.5 < parameter(flown({"rate": 2.0}, noise=0.01, kinds=TWO), "rate").low < 2.0  # includes the true limit
    assert parameter(flown({"lag": 0.03}, noise=0.01), "rate").low > 8.0
    ceiling = parameter(flown({"limit": 0.5}, kinds=TWO), "limit")
    assert 0.45 < ceiling.low < 0.5 < ceiling.high
    steps = commands()["steps"]
    reached = TrackingView([trial(steps, rig(steps, {"lag": 0.05}))])
    assert not [e for e in reached.effects if e.name == "axis.ceiling"]  # every command was reached


def test_noise_is_not_mistaken_for_speed():
    still = [np.random.default_rng(i).normal(size=4000) for i in range(3)]
    assert fastest(still, 0.01, 1, 1.0) < 0.02 * fastest([np.diff(s) / 0.01 for s in still], 0.01, 1, 0.0)
    ramp = 3.0 * 0.01 * np.arange(4000) + 0.05 * still[0]
    assert fastest([ramp], 0.01, 1, white_noise([ramp])) == pytest.approx(3.0, rel=0.05)
    throw = 0.5 * 9.81 * (0.01 * np.arange(400)) ** 2 + 0.001 * still[0][:400]
    assert fastest([throw], 0.01, 2, white_noise([throw])) == pytest.approx(9.81, rel=0.2)
    assert fastest([throw], 0.01, 2, white_noise([throw])) < 9.81


def test_noise_floors_come_from_noise_repeats_and_resolution():
    draw = np.random.default_rng(1)
    smooth = np.sin(2 * np.pi * T / 4)
    assert white_noise([smooth + 0.02 * draw.normal(size=len(T))]) == pytest.approx(0.02, rel=0.15)
    assert white_noise([smooth]) < 1e-4
    assert lateness(STEP_S, [smooth], [np.roll(smooth, 15)], 2.0) == pytest.approx(0.3, abs=0.05)
    command = commands()["steps"]
    once = trial(command, rig(command, {"lag": 0.2}))
    assert TrackingView([once]).floor[0] < 2e-3
    drift = [trial(command, once.channel("measured")["position"] + 0.02 * np.sin(T + k)) for k in range(3)]
    assert repeatability([command] * 3, [d.channel("measured")["position"] for d in drift]) == pytest.approx(
        0.011, rel=0.3
    )
    assert TrackingView(drift).floor[0] > 0.008
    assert repeatability([command, 0.9 * command], [smooth, -smooth]) == 0.0
    coarse = trial(command, 0.05 * np.round(rig(command, {"lag": 0.2}) / 0.05))
    assert TrackingView([coarse]).floor[0] > 0.0499


def test_the_nominal_model_has_gain_or_map_lag_and_limits():
    volts = 5 + 2.5 * commands()["multisine"]
    seen = rig(40 * volts - 80, {"lag": 0.15, "delay": 0.04})
    line = {"gain": 40.0, "offset": -80.0, "lag_s": 0.15, "delay_s": 0.04}
    assert predicted([trial(volts, seen, model=line, column="pressure")], {}) < 0.01 * np.std(seen)
    bent = {"map": ((0.0, 0.0), (4.0, 100.0), (10.0, 200.0))}
    reached = np.interp(np.append(volts[0], volts[:-1]), *zip(*bent["map"], strict=True))
    assert predicted([trial(volts, reached, model=bent, column="value")], {}) < 1e-3 * np.std(reached)
    (found,) = {e.name for e in TrackingView([trial(volts, seen, model=line)]).effects if "rate" in e.name}
    assert found == "axis.rate_limit"
    limited = rig(volts, {"rate": 6.0})
    assert predicted([trial(volts, limited, model={"rate_limit": 6.0})], {}) < 0.01


def test_a_fast_source_is_averaged_without_losing_motion():
    t = np.arange(0, 20, 2e-4)
    slow = Series(t, {"position": np.sin(t) + 1e-3 * np.random.default_rng(2).normal(size=len(t))})
    assert 20 < resolving_hz(slow, "position") < 320
    fast = Series(t, {"position": np.sign(np.sin(40 * t))})
    assert resolving_hz(fast, "position") > 2000
    rare = Series(t[::100], {"position": np.sin(t[::100])})
    assert resolving_hz(rare, "position") == pytest.approx(50, rel=0.01)


@pytest.mark.prove
def test_a_delay_without_a_lag_is_resolved_to_half_a_sample():
    """Without a lag, all delays within a sample give the same readings."""
    command = commands()["multisine"]
    seen = [rig(command, {"delay": delay}) for delay in (0.1208, 0.1302, 0.1392)]
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-9)
    np.testing.assert_allclose(seen[0], seen[2], atol=1e-9)
    effects = diagnose_table(flown({"delay": 0.13})).verdict.effects
    delay = next(e for e in effects if e.name == "axis.dead_time").parameters["delay"]
    assert delay.low < 0.13 < delay.high
    assert 0.99 * STEP_S < delay.high - delay.low < 2.2 * STEP_S
    view = TrackingView(flown({"lag": 0.1}))
    assert not view.unresolved({"axis.lag.rise": 0.1, "axis.lag.fall": 0.1})
    half = pytest.approx(STEP_S / 2)
    assert view.unresolved({}) == {"dead_time.delay": half, "latency.delay": half}


def test_a_delay_and_a_lag_are_as_uncertain_as_the_nominal_lag():
    """A second pole of a twentieth of the lag is within tolerance and changes the fitted delay or lag as much."""
    model = {"lag_s": 0.2}
    trials = [
        replace(t, stage=replace(t.stage, model=model)) for t in flown({"lag": 0.2, "delay": 0.1}, kinds=("steps",))
    ]
    times = ("lag.rise", "lag.fall", "dead_time.delay", "latency.delay")
    assert TrackingView(trials).model_uncertainty == {time: pytest.approx(0.012) for time in times}
    assert TrackingView(flown({"delay": 0.1}, kinds=("steps",))).model_uncertainty["dead_time.delay"] == 0.0


def test_a_zero_wrong_by_many_times_the_motion_is_fitted_as_soon_as_the_gain():
    """At one level both explain the gap. A zero that began near 0 was still far from its value after a rough fit."""
    command = 10 + 0.06 * commands()["multisine"]
    settled = rig(np.append(np.full(100, command[0]), command), {"lag": 0.1})[100:]
    view = TrackingView([trial(command, settled + 1.0, model={"lag_s": 0.1})])
    problem = Setup([view], nuisances(view), ["steps"]).weighed()
    losses = {
        c.name: min(fit.loss for fit in problem.fit([((c,), (start,)) for start in c.starts], 2))
        for c in candidates(view)
    }
    assert losses["axis.sensor_bias"] < 2 * losses["axis.gain"] < 0.01 * losses["axis.dead_time"]


def test_units_follow_the_measured_channel():
    trials = flown({"lag": 0.1}, kinds=TWO)
    for unit, rate, acceleration in (
        ("m/s", "m/s^2", "m/s^3"),
        ("kPa", "kPa/s", "kPa/s^2"),
        ("counts", "counts/s", "counts/s^2"),
    ):
        stage = TableStage("axis", "tracking", {}, {"measured": {"position": TableUnit(unit, 1.0, unit)}})
        view = TrackingView([replace(each, stage=stage) for each in trials])
        units = {p.name: p.unit for e in view.effects for p in e.parameters}
        assert (units["offset"], units["gap"], units["rate"], units["acceleration"]) == (unit, unit, rate, acceleration)
        assert (units["rise"], units["strength"], units["frequency"]) == ("s", "-", "Hz")
