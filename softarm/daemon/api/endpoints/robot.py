"""The answer of GET /api/robot: constants of one run of the daemon."""

from softarm import __version__
from softarm.daemon.control.workspace import HINGE_Z_M
from softarm.schemas.config import Config
from softarm.schemas.flights import BOARD_BELOW_M
from softarm.schemas.messages import BODY_NAMES
from softarm.schemas.model import Arm
from softarm.schemas.rest import RobotAnswer
from softarm.schemas.robot import RAIL_TRAVEL_M


def robot_answer(config: Config, *, run: str, simulated: bool, stop_port: int | None) -> RobotAnswer:
    """Return dimensions and limits of the configured robot.

    Args:
        config: the configuration in force.
        run: identifier of this run of the daemon.
        simulated: True if the robot is simulated in this process.
        stop_port: dedicated stop port, or None without one.
    """
    rail, pressure, goals = config.limits.rail, config.limits.pressure, config.goals
    links = Arm().link_length_m
    return RobotAnswer(
        version=__version__,
        run=run,
        simulated=simulated,
        stop_port=stop_port,
        rate_hz=config.control.rate_hz,
        bodies=BODY_NAMES,
        hinge_z_m=HINGE_Z_M,
        link_length_m=links,
        reach_m=sum(links) + goals.success_radius_m,
        rail_travel_m=(-RAIL_TRAVEL_M, RAIL_TRAVEL_M),
        rail_limit_m=(rail.position_min_m, rail.position_max_m),
        rail_margin_m=rail.margin_m,
        cart_velocity_max_m_s=rail.velocity_max_m_s,
        pressure_limit_kpa=(pressure.min_kpa, pressure.max_kpa),
        workspace=goals.workspace,
        success_radius_m=goals.success_radius_m,
        time_limit_s=goals.time_limit_s,
        shelf_board_below_m=BOARD_BELOW_M,
    )
