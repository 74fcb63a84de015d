"""The answer of GET /api/robot: constants of one run of the daemon."""

from softarm import __version__
from softarm.daemon.api.context import ApiContext
from softarm.daemon.control.workspace import HINGE_Z_M
from softarm.schemas.flights import BOARD_BELOW_M
from softarm.schemas.messages import BODY_NAMES
from softarm.schemas.model import Arm
from softarm.schemas.rest import RobotAnswer
from softarm.schemas.robot import RAIL_TRAVEL_M


def robot_answer(context: ApiContext) -> RobotAnswer:
    """Return dimensions and limits of the configured robot."""
    config = context.config
    rail, pressure, goals = config.limits.rail, config.limits.pressure, config.goals
    links = Arm().link_length_m
    return RobotAnswer(
        version=__version__,
        run=context.history.run,
        simulated=context.simulated,
        stop_port=context.stop_port(),
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
