"""Data of the dashboard: constants, the last minutes, poses of the bodies and their times."""

import json
import math
import time
from dataclasses import replace

import pytest

from softarm import __version__
from softarm.daemon.api.context import ApiContext
from softarm.daemon.api.status import StatusView
from softarm.daemon.control.inbox import Inbox
from softarm.daemon.control.records import Outputs
from softarm.daemon.logbook.recent import NAMES, Recent
from softarm.daemon.runtime.devices import simulated_devices
from softarm.schemas.config import Config
from softarm.schemas.messages import BODY_NAMES, MocapFrame, Pose
from softarm.schemas.rest import RobotAnswer

BODIES = tuple(Pose(0.01 * n, 0.9 - 0.1 * n, 0.0) for n in range(6))


def test_the_robots_constants_are_served(loop, app, client_of):
    config = Config(limits={"rail": {"position_max_m": 0.2}}, goals={"success_radius_m": 0.03})
    answer = client_of(app(loop, config, stop_port=lambda: 8081)).get("/api/robot").json()
    assert RobotAnswer.model_validate(answer).version == __version__
    assert answer["bodies"] == list(BODY_NAMES)
    assert answer["hinge_z_m"] == 0.965
    assert answer["reach_m"] == pytest.approx(0.4425 + 0.03)
    assert sum(answer["link_length_m"]) == pytest.approx(0.4425)
    assert answer["rail_travel_m"] == [-0.3, 0.3]
    assert answer["rail_limit_m"] == [-0.25, 0.2]
    assert answer["pressure_limit_kpa"] == [-0.7, 20.0]
    assert answer["workspace"]["z_max_m"] == 0.85
    assert (answer["stop_port"], answer["simulated"], answer["rate_hz"]) == (8081, False, 30)
    assert client_of(app(loop, simulated=True)).get("/api/robot").json()["simulated"] is True
    assert simulated_devices().simulated


def test_the_robots_constants_are_served_before_the_first_tick(silent):
    client, loop = silent
    loop.outputs = None
    assert client.get("/api/robot").status_code == 200
    assert client.get("/").status_code == 200
    assert client.get("/api/recent").json() == {name: [] for name in NAMES}


def test_the_last_minutes_are_served_as_columns(loop, app, client_of):
    recent = Recent(time.monotonic_ns, time.time_ns)
    outputs = loop.outputs
    recent.take(outputs)
    client = client_of(app(loop, recent=recent))
    answer = client.get("/api/recent?seconds=5")
    assert answer.headers["content-type"] == "application/json"
    said = answer.json()
    assert said["tick"] == [outputs.tick]
    assert said["time"] == [pytest.approx(time.time(), abs=5)]


def view_of(outputs: Outputs, frame: MocapFrame | None, wall_ns: int = 0, now_ns: int = 0) -> dict:
    clocks = {"clock": lambda: now_ns, "wall_ns": lambda: wall_ns}
    context = ApiContext(Config(), Inbox(), lambda: outputs, frame=lambda: frame, **clocks)
    return json.loads(StatusView(context, {}).json())


def test_the_status_has_the_time_of_its_tick(silent):
    outputs = replace(silent[1].outputs, t_ns=3_000_000_000)
    status = view_of(outputs, None, wall_ns=1_700_000_000_000_000_000, now_ns=5_000_000_000)
    assert status["time"] == pytest.approx(1_699_999_998.0, abs=1e-5)


def test_the_bodies_are_from_the_newest_good_frame(silent):
    outputs = silent[1].outputs
    assert view_of(outputs, None)["bodies"] is None
    lost = (*BODIES[:4], BODIES[4]._replace(tracked=False), BODIES[5]._replace(z_m=math.inf))
    assert view_of(outputs, MocapFrame(7, 0, 0, lost))["bodies"] == [
        *([body.y_m, body.z_m] for body in BODIES[:4]),
        None,
        None,
    ]


def test_bodies_without_an_observation_have_an_age(silent):
    outputs = replace(silent[1].outputs, observed=None, t_ns=50_000_000)
    assert view_of(outputs, MocapFrame(7, 10_000_000, 0, BODIES))["ages_ms"] == {
        "mocap": 40.0,
        "pressure": None,
        "rail": None,
    }
    assert view_of(outputs, None)["ages_ms"]["mocap"] is None
