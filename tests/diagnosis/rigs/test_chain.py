"""Free and driven chains: their law against MuJoCo and closed forms, and diagnoses of known causes."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data.trials import Series, TableStage
from softarm.diagnosis.rigs.chain.model import chain_of
from softarm.diagnosis.rigs.chain.view import ChainView
from softarm.diagnosis.rigs.stage import view_of
from tests.diagnosis.rigs.recordings import named, recording, shipped

GRAVITY = 9.81
# tanh(STEEP x rate) replaces the sign of a rate, s/rad.
STEEP = 200.0
FINE_S = 2.5e-4

ONE = {"mass_kg": 0.6, "centre_m": 0.12, "length_m": 0.2, "inertia_kg_m2": 2e-3, "damping_nm_s_rad": 0.01}
TWO = {
    "mass_kg": (0.6, 0.4),
    "centre_m": (0.12, 0.14),
    "length_m": (0.2, 0.25),
    "inertia_kg_m2": (2e-3, 1.5e-3),
    "armature_kg_m2": (2e-3, 1e-3),
    "damping_nm_s_rad": (0.02, 0.01),
}


class Made:
    """Independent simulation of a chain by MuJoCo with effects beyond its model.

    Effects: dry, viscous, offset, late (of the torque, s), gain, payload, weight and inertia (shares), drag, cubic,
    tilt, spring (N m/rad) and its rest. Dry friction is a steep function of the rate instead of a sheared bristle.
    """

    def __init__(self, model, **beyond):
        n = self.n = len(np.ravel(model["mass_kg"]))
        self.late, self.drag, self.cubic = (beyond.get(name, 0.0) for name in ("late", "drag", "cubic"))
        self.gain, self.offset, self.dry = (beyond.get(name, 0.0) for name in ("gain", "offset", "dry"))
        keys = "mass_kg", "centre_m", "inertia_kg_m2", "armature_kg_m2", "damping_nm_s_rad"
        mass, centre, own, armature, damping = (np.broadcast_to(model.get(key, 0.0), n) for key in keys)
        inertia = own + beyond.get("inertia", 0.0) * (own + mass * centre**2)
        damping = damping + beyond.get("viscous", 0.0)
        spring, rest = (beyond.get(name, 0.0) for name in ("spring", "rest"))
        length, load = np.append(0.0, model.get("length_m", 0.0)), beyond.get("payload", 0.0)
        end = f'<body pos="0 0 {-length[n]}"><inertial pos="0 0 0" mass="{load}" diaginertia="1e-9 1e-9 1e-9"/></body>'
        chain = end if load else ""
        for i in reversed(range(n)):
            joint = f'damping="{damping[i]}" armature="{armature[i]}" stiffness="{spring}" springref="{rest}"'
            chain = f"""<body pos="0 0 {-length[i]}"><joint axis="0 -1 0" {joint}/>
              <inertial pos="0 0 {-centre[i]}" mass="{mass[i]}" diaginertia="1 {inertia[i]} 1"/>{chain}</body>"""
        compiler = '<compiler angle="radian" balanceinertia="false"/>'
        option = f'<option timestep="{FINE_S}" integrator="RK4"/>'
        self.model = mujoco.MjModel.from_xml_string(
            f"<mujoco>{compiler}{option}<worldbody>{chain}</worldbody></mujoco>"
        )
        tilt, down = beyond.get("tilt", 0.0), GRAVITY * (1 + beyond.get("weight", 0.0))
        self.model.opt.gravity[:] = down * np.sin(tilt), 0.0, -down * np.cos(tilt)

    def swing(self, start, t, torque=None, push=lambda t: 0.0):
        """Return absolute angles [T, n] from joint angles at rest; torque: t -> requested torques [n]."""
        data, found = mujoco.MjData(self.model), []
        data.qpos[:], sideways = start, float(self.model.opt.gravity[0])
        each = round((t[1] - t[0]) / FINE_S)
        for k in range(each * len(t)):
            if k % each == 0:
                found.append(np.cumsum(data.qpos))
            middle = (k + 0.5) * FINE_S
            asked = 0.0 if torque is None else torque(middle - self.late) * (1 + self.gain) + self.offset
            data.qfrc_applied[:] = asked - self.dry * np.tanh(STEEP * data.qvel)
            self.model.opt.gravity[0] = sideways - push(middle)
            if self.drag or self.cubic:
                self._load(data)
            mujoco.mj_step(self.model, data)
        self.model.opt.gravity[0] = sideways
        return np.array(found)

    def _load(self, data):
        """Apply the drag of each link and the weight that grows with its angle."""
        velocity = np.zeros(6)
        for i, angle in enumerate(np.cumsum(data.qpos), 1):
            mujoco.mj_objectVelocity(self.model, data, mujoco.mjtObj.mjOBJ_BODY, i, velocity, 0)
            drag = -self.drag * np.linalg.norm(velocity[3:]) * velocity[3:]
            data.xfrc_applied[i, :3] = drag + self.model.body_mass[i] * self.cubic * angle**2 * self.model.opt.gravity


def tones(seed, n, size):
    """Return a torque function with a few sines for each joint."""
    draw = np.random.default_rng(seed)
    hertz = draw.uniform(0.2, 2.0, (n, 4))
    phase, part = draw.uniform(0, 2 * np.pi, (n, 4)), draw.uniform(0.5, 1.0, (n, 4))
    return lambda t: np.ravel(size) * np.sum(part * np.sin(2 * np.pi * hertz * t + phase), axis=1) / 2


def trial(name, t, angles, model, torques=None, base=None, *, kind="tones", noise=0.0, step=0.0, seed=0):
    """Return a recording with noise and step of an encoder; torques: requested, [T, n]; base: position, m [T]."""
    seen = angles + noise * np.random.default_rng(seed).normal(size=angles.shape)
    seen = np.round(seen / step) * step if step else seen
    channels = {"measured": {f"angle{i + 1}": x for i, x in enumerate(seen.T)}}
    if torques is not None:
        channels["torque"] = {f"torque{i + 1}": x for i, x in enumerate(torques.T)}
    if base is not None:
        channels["base"] = {"position": base}
    return recording(name, kind, t, channels, ("arm", "chain", model))


def driven(name, made, t, torque, model, start=0.2, **seen):
    """Return a recording of a chain whose motors receive a function of time; seen: options of `trial`."""
    angles = made.swing(start, t, torque)
    return trial(name, t, angles, model, np.array([torque(x) for x in t]), **seen)


def campaign(model, beyond=None, *, trials=4, seconds=6.0, size=0.15, noise=2e-4, nominal=None):
    """Return driven recordings of one chain with different sines."""
    made, t, found = Made(model, **(beyond or {})), np.arange(0, seconds, 1 / 200), []
    for k in range(trials):
        torque = tones(k, made.n, size * (0.6 + 0.3 * k))
        how = {"start": 0.1 * k, "noise": noise, "step": 2e-4, "seed": k}
        found.append(driven(f"run {k}", made, t, torque, nominal or model, **how))
    return found


BIG = np.array((0.5, 0.2))  # N m, of two motors


def view(trials):
    return ChainView([window for t in trials for window in ChainView.windows(t)])


def rms(of, points):
    """Return the RMS gap at each point, rad."""
    found = of.gap([{f"arm.{k}": v for k, v in point.items()} for point in points]).astype(float)
    return np.sqrt(np.nanmean(found**2, axis=(1, 2)))


# Effects of two simulated links, and the same effects as parameters of the view.
DRY = {"coulomb_friction.torque1": 0.03, "coulomb_friction.torque2": 0.015, "coulomb_friction.give": 1e-3}
LAWS = {
    "dry": (np.array((0.03, 0.015)), DRY),
    "viscous": (np.array((0.01, 0.005)), {"damping.scale1": 0.5, "damping.scale2": 0.5}),
    "drag": (0.2, {"drag.coefficient": 0.2}),
    "payload": (0.06, {"payload.mass": 0.06}),
    "weight": (0.1, {"stiffness.scale": 0.1}),
    "inertia": (0.2, {"inertia.scale": 0.2}),
    "gain": (np.array((0.15, 0.075)), {"gain.scale1": 0.15, "gain.scale2": 0.075}),
    "late": (0.02, {"dead_time.delay": 0.02}),
    "offset": (np.array((0.05, 0.025)), {"torque_offset.torque1": 0.05, "torque_offset.torque2": 0.025}),
    "tilt": (0.05, {"tilt.angle": 0.05}),
}


def test_stiffening_of_one_link_agrees_with_an_independent_simulation():
    """Stiffening of several links is defined differently in the simulation."""
    before, after = rms(view(campaign(ONE, {"cubic": 0.1}, trials=1, size=0.3)), [{}, {"stiffening.cubic": 0.1}])
    assert after < 0.12 * before
    assert before > 1e-3


@pytest.mark.parametrize(
    "names",
    [("dry",), ("viscous", "drag", "tilt"), ("payload", "inertia", "weight"), ("gain", "late", "offset")],
)
def test_every_law_of_two_links_agrees_with_an_independent_simulation(names):
    beyond, point = {}, {}
    for name in names:
        beyond[name], sizes = LAWS[name]
        point |= sizes
    lacking = [{path: size for path, size in point.items() if path not in LAWS[name][1]} for name in names]
    after, *before = rms(view(campaign(TWO, beyond, trials=1, seconds=2.5, size=BIG)), [point, *lacking])
    assert after < 0.12 * min(before)
    assert min(before) > 1e-3


def test_an_inertia_about_the_joint_is_the_same_chain():
    own = 2e-3 + 0.6 * 0.12**2
    about = {k: v for k, v in ONE.items() if k != "inertia_kg_m2"} | {"inertia_joint_kg_m2": own}
    one, other = (chain_of(TableStage("arm", "chain", m)) for m in (ONE, about))
    np.testing.assert_allclose(one.rows(), other.rows())


def test_a_moving_base_drives_the_chain():
    t = np.arange(0, 3, 0.005)
    way, wave = 0.05, 2 * np.pi * 0.9

    def push(t):
        return -way * wave**2 * np.sin(wave * t)

    angles = Made(TWO).swing(0.1, t, push=push)
    carried = view([trial("carried", t, angles, TWO, base=way * np.sin(wave * t))])
    stands = view([trial("stands", t, angles, TWO, base=0 * t)])
    assert rms(carried, [{}])[0] < 1e-3
    assert rms(stands, [{}])[0] > 0.03


def test_relative_encoders_are_compared_with_relative_angles():
    t = np.arange(0, 4, 0.005)
    angles = Made(TWO).swing(0.3, t)
    off = angles + 0.02 * np.array((1.0, 1.0))  # the first encoder's zero moves both absolute angles
    seen = trial("swing", t, off, TWO)
    relative = TableStage("arm", "chain", TWO, {}, True)
    found = view([replace(seen, stage=relative)])
    before, after = rms(found, [{}, {"sensor_bias.bias1": 0.02}])
    assert 100 * after < before


def test_windows_last_some_periods_and_include_the_torque_around_them():
    t = np.arange(0, 12, 0.005)
    angles = Made(ONE).swing(0.3, t)
    free, driven = trial("free", t, angles, ONE), trial("driven", t, angles, ONE, np.zeros((len(t), 1)))
    period = chain_of(TableStage("arm", "chain", ONE)).periods_s[0]
    assert len(ChainView.windows(free)) == round(12 / (4 * period))
    parts = ChainView.windows(driven)
    assert len(parts) == round(12 / period)
    inside, around = parts[3].channels["measured"].t_s, parts[3].channels["torque"].t_s
    assert around[0] == pytest.approx(inside[0] - 0.5 * period, abs=0.01)
    assert around[-1] == pytest.approx(inside[-1] + 0.5 * period, abs=0.01)
    slow = {**ONE, "gravity_m_s2": 0.0}  # the data give the period without gravity
    drift = trial("drift", t, 0.3 * np.sin(t)[:, None], slow)
    assert len(ChainView.windows(drift)) == 1


def widest(recorded):
    """Return the largest angle of a recording, rad."""
    return max(np.abs(angle).max() for angle in recorded.channels["measured"].columns.values())


@pytest.mark.prove
def test_windows_with_a_link_over_the_top_are_left_out_with_a_warning():
    t, made = np.arange(0, 6, 0.005), Made(TWO)
    calm, strong = tones(3, 2, (0.3, 0.1)), tones(4, 2, (3.0, 0.6))
    parts = []
    for name, torque in (("calm", calm), ("more", calm), ("strong", strong)):
        recorded = driven(name, made, t, torque, TWO, noise=2e-4)
        assert (widest(recorded) > np.pi) == (name == "strong")
        parts += ChainView.windows(recorded)
    found = ChainView(parts)
    out = [s.name for k, s in enumerate(parts) if not np.isfinite(found.measured[found.trial == k]).any()]
    assert out
    assert all(name.startswith("strong") for name in out)
    assert any(f"{len(out)} of {len(parts)} windows are left out" in text for text in found.warnings({}))


def over_the_top(beyond, trials=4, seconds=6.0):
    """Return recordings of a strongly driven arm whose links turn over and over."""
    made, t = Made(TWO, **beyond), np.arange(0, seconds, 0.005)
    found = [
        driven(f"strong {k}", made, t, tones(10 + k, 2, (3.0, 0.6)), TWO, noise=2e-4, seed=k) for k in range(trials)
    ]
    assert min(map(widest, found)) > 4 * np.pi
    return found


def test_windows_over_the_top_are_as_short_as_the_growth_of_errors_demands():
    calm, strong = campaign(TWO, trials=1, seconds=2.0, size=BIG), over_the_top({}, trials=1, seconds=3.0)
    whole, halved = (len(ChainView.windows(trials[0])) for trials in (calm, strong))
    assert len(view_of(calm)[1].trials) == whole
    found, parts = view_of(strong)
    assert len(parts.trials) > 2 * halved
    assert set(parts.origins) == {0}
    assert np.isfinite(found.measured).all(axis=1).mean() > 0.9
    grown = ChainView(ChainView.windows(strong[0])).growth
    assert grown.max() > 20
    assert np.quantile(found.growth, 0.8) < 5


def test_a_missing_row_at_a_torque_jump_excludes_the_window():
    """The torque between the neighbouring rows is unknown; interpolation would halve the jump."""
    t, jump = np.arange(0, 6, 0.005), 600
    torque = np.where(np.arange(len(t)) < jump, 0.0, 0.5)[:, None] * (1.0, 0.2)
    angles = Made(TWO).swing(0.1, t, lambda now: torque[min(int((now + 1e-9) / 0.005), len(t) - 1)])
    whole = trial("jump", t, angles, TWO, torque, noise=2e-4)
    for late_rows in (0, 40):  # at the jump, and while the torque is constant
        keep = np.delete(np.arange(len(t)), jump + late_rows - 1)
        channels = {
            name: Series(s.t_s[keep], {c: x[keep] for c, x in s.columns.items()}) for name, s in whole.channels.items()
        }
        parts = ChainView.windows(replace(whole, channels=channels))
        found, ends = ChainView(parts), [part.channels["measured"].t_s[[0, -1]] for part in parts]
        out = [k for k in range(len(parts)) if not np.isfinite(found.measured[found.trial == k]).any()]
        assert out == ([] if late_rows else [k for k, (start, end) in enumerate(ends) if start <= t[jump] <= end])
        left = f"1 of {len(parts)} windows are left out"
        said = [text for text in found.warnings({}) if left in text and "rows are missing" in text]
        assert bool(said) != bool(late_rows)


def test_small_errors_of_each_links_mass_are_nuisances():
    t = np.arange(0, 3, 0.005)
    torque = tones(5, 2, (0.5, 0.15))
    other = {**TWO, "mass_kg": (0.603, 0.398), "inertia_kg_m2": (2.04e-3, 1.47e-3)}
    found = view([driven("tones", Made(other), t, torque, TWO)])
    gap, ways = found.gap([{}])[0].ravel(), found.own_directions().reshape(4, -1)
    assert list(found.own_nuisances) == ["arm.mass1", "arm.mass2", "arm.inertia1", "arm.inertia2"]
    u, *_ = np.linalg.lstsq(ways.T.astype(float), -gap, rcond=None)
    assert rms(found, [{}])[0] > 10 * np.sqrt(np.mean((gap + u @ ways) ** 2))
    np.testing.assert_allclose(u * (0.01, 0.01, 0.05, 0.05), (0.005, -0.005, 0.02, -0.02), atol=2e-3)


def test_the_inertia_is_as_uncertain_as_the_masses():
    """Otherwise a real triple pendulum gave an inertia 0.4 % too small, in addition to drag and dry friction."""
    t = np.arange(0, 4, 0.005)
    angles = Made(TWO).swing(0.3, t)
    still, carried = trial("free", t, angles, TWO), trial("free", t, angles[:, :1], ONE, base=0.01 * np.sin(t))
    assert view([still]).tolerances["inertia.scale"] == view([carried]).tolerances["inertia.scale"] == 0.01
    assert "stiffness.scale" not in view([still]).model_uncertainty
    alone = view([trial("free", t, angles[:, :1], ONE)])  # shows the ratio of weight and inertia
    assert "inertia.scale" not in alone.tolerances
    assert alone.model_uncertainty["stiffness.scale"] == 0.01


def test_a_delay_is_as_uncertain_as_a_torque_that_is_held_between_samples():
    t = np.arange(0, 3, 0.01)
    torque = tones(5, 2, (0.5, 0.15))
    found = view([driven("tones", Made(TWO, late=0.02), t, lambda x: torque(np.floor(100 * x + 1e-9) / 100), TWO)])
    delays = 0.02 + 0.001 * np.arange(10)
    best = delays[np.argmin(rms(found, [{"dead_time.delay": x} for x in delays]))]
    assert found.model_uncertainty["dead_time.delay"] == pytest.approx(best - 0.02, abs=0.001) == 0.005


def test_bounds_scale_with_the_chain():
    heavier = {k: 1000 * np.array(TWO[k]) for k in ("mass_kg", "inertia_kg_m2", "armature_kg_m2")}
    small, large = TWO, {**TWO, **heavier}
    t = np.arange(0, 4, 0.005)
    angles = Made(TWO).swing(0.3, t)
    tops = []
    for model in (small, large):
        found = {e.name: e for e in view([trial("swing", t, angles, model)]).effects}
        tops.append([p.high for p in found["arm.coulomb_friction"].parameters[:2]])
        assert found["arm.payload"].parameters[0].high == pytest.approx(sum(np.ravel(model["mass_kg"])))
        assert {"arm.gain", "arm.dead_time", "arm.torque_offset"}.isdisjoint(found)  # nothing drives it
    np.testing.assert_allclose(np.array(tops[1]) / tops[0], 1000, rtol=1e-6)


def test_the_bound_of_viscous_friction_grows_with_the_motor():
    """A light forearm with a strong motor can have more than five times the model's friction."""
    light = {**TWO, "inertia_kg_m2": (2e-3, 1e-4), "centre_m": (0.12, 0.02), "armature_kg_m2": (0.0, 0.0)}
    t = np.arange(0, 4, 0.005)
    angles, torque = 0.5 * np.sin(np.stack((3 * t, 4 * t), axis=1)), 0.3 * np.sin(np.stack((3 * t, 4 * t), axis=1))
    rate = np.sqrt(np.mean(np.gradient(angles[:, 1] - angles[:, 0], 0.005) ** 2))
    found = {e.name: e for e in view([trial("tones", t, angles, light, torque)]).effects}
    free = {e.name: e for e in view([trial("tones", t, angles, light)]).effects}
    high = [each["arm.damping"].parameters[1].high for each in (found, free)]
    assert high[0] == pytest.approx(0.3 / rate / 0.01 - 1, rel=0.02)
    assert high[1] == 4.0


def test_no_effect_is_named_on_a_healthy_noisy_arm():
    verdict, found = named(campaign(TWO, trials=2, seconds=3.0, size=BIG, noise=5e-4))
    assert (verdict.verdict, found) == ("none", {})


@pytest.mark.prove
@pytest.mark.parametrize(
    ("beyond", "name", "sizes"),
    [
        ({"payload": 0.06}, "payload", {"mass": 0.06}),
        ({"dry": np.array((0.06, 0.02))}, "coulomb_friction", {"torque1": 0.06}),
    ],
)
def test_only_the_cause_is_named_in_an_arm_that_turns_over(beyond, name, sizes):
    verdict, found = named(over_the_top(beyond))
    assert (verdict.verdict, set(found)) == ("named", {name})
    assert {of: found[name][of] for of in sizes} == pytest.approx(sizes, rel=0.1)


@pytest.mark.prove
def test_dry_friction_is_named_next_to_viscous_friction_that_was_fitted_alone():
    """The nominal viscous friction is the best one without dry friction: eight and three times the true one."""
    owned = {**TWO, "damping_nm_s_rad": (0.164, 0.0289)}
    trials = campaign(TWO, {"dry": np.array((0.2, 0.0667))}, size=BIG, seconds=4.0, nominal=owned)
    verdict, found = named(trials)
    assert verdict.verdict == "named"
    assert set(found) == {"coulomb_friction", "damping"}
    assert found["coulomb_friction"]["torque1"] == pytest.approx(0.2, rel=0.05)
    assert found["coulomb_friction"]["torque2"] == pytest.approx(0.0667, rel=0.05)
    assert 0.164 * (1 + found["damping"]["scale1"]) == pytest.approx(0.02, rel=0.15)


@pytest.mark.prove
def test_a_real_double_pendulum_has_dry_friction_in_both_joints(data):
    """Its authors give 0.093 and 0.078 N m times arctan(100 rate), at most 0.146 and 0.123 N m."""
    verdict, found = named(shipped("double-pendulum.yaml", data))
    assert "coulomb_friction" in found
    assert "damping" not in found
    assert verdict.effects[0].name == "arm.coulomb_friction"
    assert verdict.effects[0].equivalents == ()
    assert found["coulomb_friction"]["torque1"] == pytest.approx(0.146, rel=0.2)
    assert found["coulomb_friction"]["torque2"] == pytest.approx(0.123, rel=0.2)
