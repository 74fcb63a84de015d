"""Robots that are not there, as verbs are asked for them."""

from typing import TYPE_CHECKING

from softarm.cli.errors import fail

if TYPE_CHECKING:
    from softarm.drivers.bodies.base import Body
    from softarm.schemas.model import Model


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
