"""Fixtures of the tests of training."""

from base64 import b64decode

import pytest

from softarm.training.learn.inference import workers
from softarm.training.record import curve
from softarm.training.run import report

PIXEL = b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg==")


@pytest.fixture
def pool():
    """Provide one thread for the learner."""
    with workers(1) as pool:
        yield pool


@pytest.fixture
def plain_pictures(monkeypatch):
    """Write one pixel as every picture of a run: to draw them takes longer than a short training."""
    monkeypatch.setattr(curve, "write_png", lambda rows, path, *_: path.write_bytes(PIXEL))
    monkeypatch.setattr(report, "write_png", lambda tested, task, path, title: path.write_bytes(PIXEL))


@pytest.fixture
def short_validation(monkeypatch):
    """Give `reach` short episodes, few validation and few test flights where a command starts the run."""
    from softarm.schemas import flights
    from softarm.training.run.recipe import RECIPES

    few = flights.grid()[::20]
    monkeypatch.setattr(flights, "grid", lambda *_: few)
    settings = {"run.validation_trials": 12, "task.episode_steps": 20}
    monkeypatch.setitem(RECIPES, "reach", RECIPES["reach"].model_copy(update={"settings": settings}))
