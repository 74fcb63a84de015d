"""A set that one sine cannot split is split by the flight that is asked for, on the independent robot."""

from dataclasses import replace

import pytest

from softarm.diagnosis.data import folder
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.thresholds import ROBOT
from softarm.diagnosis.robot.candidates import candidates, nuisances
from softarm.diagnosis.robot.experiments import splitting
from softarm.diagnosis.robot.trial_grid import on_grid
from softarm.diagnosis.robot.views import robot_views
from softarm.reality.parameters import RobotParameters
from softarm.reality.record import record
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model

TWO = ("rail.delay", "rail.lag")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def fly(tmp_path_factory):
    """A trial of an independent robot whose rail is 30 ms later than the model has it."""
    robot = RobotParameters()
    robot = replace(robot, rail=replace(robot.rail, delay_s=robot.rail.delay_s + 0.03))
    place = tmp_path_factory.mktemp("campaign")

    def flown(kind):
        excitation = EXCITATIONS[kind]
        record(excitation.at, place / kind, excitation.duration_s, robot, 1, kind=kind)
        return folder.read(place / kind)

    return flown


def _examined(trials):
    """The engine on the robot's views, these two the only candidates."""
    kinds, model = [trial.kind for trial in trials], Model()
    setup = Setup(robot_views(on_grid(trials, model), model), nuisances(model), kinds)
    known = [each for each in candidates(model) if each.name in TWO]
    return Examination(setup, known, ROBOT, lambda what, share: None)


@pytest.mark.prove
def test_the_flight_that_is_asked_for_splits_the_set(fly):
    trials = [fly("both")]  # the cart's one sine: late is late
    found = _examined(trials)
    (effect,) = found.choice.selected
    assert {effect.candidate.name, *effect.equivalents} == set(TWO)
    explanations = {effect.candidate.name: found.choice.chosen.point} | {
        fit.effects[-1].name: fit.point for fit, _ in effect.rivals
    }
    asked = splitting(Model(), explanations, found.plain, ["both"])
    assert asked.excitation in EXCITATIONS
    assert asked.excitation != "both"
    (effect,) = _examined([*trials, fly(asked.excitation)]).choice.selected
    assert effect.candidate.name == "rail.delay"
    assert effect.equivalents == ()
