"""Robots that are not there, as verbs are asked for them, and what may be wrong with them."""

from typing import TYPE_CHECKING

from softarm.cli.errors import fail
from softarm.cli.printing import print_table

if TYPE_CHECKING:
    from softarm.drivers.bodies.base import Body
    from softarm.schemas.model import Model

WIDTH = 160  # of tables where there is no terminal


def independent_body(model: "Model | None", faults: tuple[str, ...]) -> "Body":
    """The robot of `reality/`; a sentence when its extra is missing, or it cannot be of that model or have a fault."""
    try:
        from softarm.drivers.bodies.independent import IndependentBody
        from softarm.flights.robots import with_faults
        from softarm.reality.parameters import of_model
        from softarm.schemas.model import Model

        return IndependentBody(with_faults(of_model(model or Model()), faults))
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise
        fail("--reality needs the package 'mujoco': pip install 'softarm[mujoco]'")
    except ValueError as error:
        fail(f"--reality: {error}")


def faulty_body(model: "Model | None", reality: bool, faults: tuple[str, ...]) -> "Body":
    """The independent robot or the simulator's, with its faults; a sentence when it cannot have them."""
    if reality:
        return independent_body(model, faults)
    from softarm.drivers.bodies.simulated import SimulatedBody
    from softarm.flights.robots import with_effects
    from softarm.schemas.model import Model

    try:
        return SimulatedBody(with_effects(model or Model(), faults))
    except ValueError as error:
        fail(str(error))


def wire_fault(text: str) -> bytes:
    """A fault of the twin's wires, as the twin takes it; a sentence when there is none such."""
    from softarm.drivers.twin.faults import message

    try:
        return message(text)
    except ValueError as error:
        fail(f"{error}; `softarm twin --fault list` tells what each does")


def list_faults(reality: bool | None) -> None:
    """Print the faults of the wires, and those of one of the robots. None: of no robot."""
    from softarm.drivers.twin.faults import described

    rows = [(fault.name, fault.value, fault.meaning) for fault in described()]
    print_table(("fault", "VALUE", "what happens"), rows, "of the wires", WIDTH)
    if reality is not None:
        columns = ("fault", "VALUE", "what it is")
        rows_of_robot = _independent() if reality else _simulated()
        title = "of the independent robot (--reality)" if reality else "of the simulated robot"
        print_table(columns, rows_of_robot, title, WIDTH)


def _independent() -> list[tuple[str, str, str]]:
    from softarm.reality.parameters import GROUPS, RobotParameters
    from softarm.reality.quantities import of

    robot = RobotParameters()
    groups = {name: type(part) for name in robot.__dataclass_fields__ if type(part := getattr(robot, name)) in GROUPS}
    return [
        (f"{group}.{name}", str(each), each.meaning)
        for group, kind in groups.items()
        for name, each in of(kind).items()
    ]


def _simulated() -> list[tuple[str, str, str]]:
    from softarm.simulator.effects import REGISTRY

    rows = []
    for name, effect in REGISTRY.items():
        rows += [(name, "" if effect.parameters else "takes none", effect.meaning)]
        rows += [(f"  .{p.name}", f"{p}; {p.exemplar:g} without", p.meaning) for p in effect.parameters]
    return rows
