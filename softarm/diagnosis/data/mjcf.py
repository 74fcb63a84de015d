"""Loading of MJCF and URDF files."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from softarm.common import files
from softarm.diagnosis.data.poses import pose_joints
from softarm.diagnosis.data.trials import TrialError

INSTALL = "needs MuJoCo; install it with: pip install 'softarm[mujoco]'"


def places(mujoco: Any, model: Any) -> dict[str, tuple[str, ...]]:
    """Return the sites and bodies of a model that have a name, with the columns of all joints that move them."""
    columns = columns_of_joints(mujoco, model)
    found = {model.site(i).name: int(model.site_bodyid[i]) for i in range(model.nsite)}
    for i in range(1, model.nbody):
        found.setdefault(model.body(i).name, i)
    movers = {name: carriers(model, body) for name, body in found.items() if name}
    return {name: tuple(column for joint in of for column in columns[joint]) for name, of in movers.items()}


def carriers(model: Any, body: int) -> Iterator[int]:
    """Yield the numbers of the joints that move a body."""
    while body:
        first = int(model.body_jntadr[body])
        yield from range(first, first + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])


def columns_of_joints(mujoco: Any, model: Any) -> dict[int, tuple[str, ...]]:
    """Return the columns of each joint by its number, in the order of qpos."""
    poses = pose_joints(mujoco, model)
    return {j: poses[j].columns if j in poses else (str(model.joint(j).name),) for j in range(model.njnt)}


def load(path: Path) -> tuple[Any, Any]:
    """Return the module `mujoco` and the model of a file; raise TrialError if one of them is missing or invalid."""
    try:
        import mujoco
    except ImportError:
        raise TrialError(f"{path}: {INSTALL}") from None
    if not files.is_file(path):
        raise TrialError(f"{path}: does not exist; write the path of the MJCF or URDF file under `model: mjcf`")
    try:
        return mujoco, mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        said = " ".join(str(error).split())
        raise TrialError(f"{path}: MuJoCo cannot read the model ({said}); correct the file") from None
