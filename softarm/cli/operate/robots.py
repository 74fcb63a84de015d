"""Simulated robots and their faults, as verbs are asked for them."""

from typing import TYPE_CHECKING

from softarm.cli.shared.errors import fail, failing
from softarm.cli.shared.printing import print_table

if TYPE_CHECKING:
    from softarm.drivers.bodies.base import Body
    from softarm.schemas.model import Model

WIDTH = 160  # of tables where there is no terminal


def independent_body(model: "Model | None", faults: tuple[str, ...]) -> "Body":
    """Return the independent robot; end the command with a sentence if MuJoCo is missing or a fault is invalid."""
    try:
        from softarm.drivers.bodies.independent import IndependentBody
        from softarm.evaluation.robots import with_faults
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
    """Return the independent or the simulator's robot with faults; end the command if a fault is invalid."""
    if reality:
        return independent_body(model, faults)
    from softarm.drivers.bodies.simulated import SimulatedBody
    from softarm.evaluation.robots import with_effects
    from softarm.schemas.model import Model

    with failing(ValueError):
        return SimulatedBody(with_effects(model or Model(), faults))


def wire_fault(text: str) -> bytes:
    """Return a fault of the twin's wires as the message for the twin; end the command with a sentence if unknown."""
    from softarm.drivers.twin.faults import message

    try:
        return message(text)
    except ValueError as error:
        fail(f"{error}; `softarm twin --fault list` describes each fault")


def list_faults(reality: bool | None) -> None:
    """Print the faults of the wires, and those of the independent or the simulated robot unless reality is None."""
    from softarm.drivers.twin.faults import described

    columns = ("fault", "VALUE", "meaning")
    print_table(columns, described(), "faults of the wires", WIDTH)
    if reality:
        print_table(columns, _independent(), "faults of the independent robot (--reality)", WIDTH)
    elif reality is not None:
        print_table(columns, _simulated(), "faults of the simulated robot", WIDTH)


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
