"""Which law moved the cart is read off its motion, whatever else is wrong with the rail; fits then go by it."""

import pytest

from softarm.diagnosis.diagnose import diagnose
from softarm.diagnosis.robot.drive import SERVO, with_identified_drive, with_servo
from softarm.diagnosis.robot.trial_grid import on_grid
from softarm.schemas.model import Model
from validation.blind.shrink import measure_shrink

pytestmark = pytest.mark.slow
MODEL, KINDS = Model(), ("both", "rail-steps")
SERVED = (SERVO, ())
LAG_S = 0.04
FURTHER = {
    "nothing": (),
    "lag": (("rail.lag", (("time", LAG_S),)),),
    "friction": (("rail.coulomb_friction", (("force", 3.0), ("viscous", 0.0))),),
    "force limit": (("rail.force_limit", (("force", 1.4),)),),
    "delay": (("rail.delay", (("delay", 0.08),)),),
}
QUICK = ((True, "force limit"), (False, "lag"))


def law(trials, model=MODEL):
    return with_identified_drive(on_grid(trials, model), model, [trial.kind for trial in trials])


@pytest.mark.parametrize(
    ("servo", "further"),
    [
        pytest.param(servo, further, marks=() if (servo, further) in QUICK else pytest.mark.prove)
        for servo in (True, False)
        for further in FURTHER
    ],
)
def test_the_law_that_moved_the_cart_is_recognised(campaign, further, servo):
    found = law(campaign((*FURTHER[further], *([SERVED] if servo else [])), KINDS))
    assert found == (with_servo(MODEL) if servo else MODEL)


def test_a_model_with_a_servo_and_a_held_rail_are_unchanged(campaign):
    trials = campaign((SERVED,), KINDS)
    assert law(trials, with_servo(MODEL)) == with_servo(MODEL)
    grid = on_grid(trials, MODEL)
    grid.held[:] = True
    assert with_identified_drive(grid, MODEL, KINDS) is MODEL


@pytest.mark.prove
def test_a_lag_of_a_servo_is_named_alone_with_its_size_and_the_patch_has_its_law(campaign):
    found = diagnose(campaign((*FURTHER["lag"], SERVED), KINDS), MODEL)
    (effect,) = found.verdict.effects
    assert (found.verdict.verdict, effect.name) == ("named", "rail.lag")
    assert effect.parameters["time"].value == pytest.approx(LAG_S, rel=0.01)
    assert SERVO in found.patched.effects
    assert SERVO not in found.nominal.effects
    assert any(SERVO in warning for warning in found.verdict.warnings)


def test_an_effect_is_not_credited_with_the_law(campaign):
    trials = campaign((*FURTHER["lag"], SERVED), KINDS)
    truth = MODEL.model_copy(update={"effects": MODEL.effects | {"rail.lag": {"time": LAG_S}}})
    lag = measure_shrink(trials, MODEL, with_servo(truth))["rail"]
    assert lag > 0.9
    assert measure_shrink(trials, MODEL, with_servo(MODEL))["rail"] == pytest.approx(0.0, abs=1e-6)
    assert measure_shrink(trials, MODEL, truth)["rail"] < lag
