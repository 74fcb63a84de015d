"""Loading of MJCF and URDF files."""

from pathlib import Path
from typing import Any

from softarm.common import files
from softarm.diagnosis.data.trials import TrialError

INSTALL = "needs MuJoCo; install it with: pip install 'softarm[mujoco]'"


def places(model: Any) -> tuple[str, ...]:
    """Return the names of a model's sites and bodies."""
    named = [model.site(i).name for i in range(model.nsite)] + [model.body(i).name for i in range(1, model.nbody)]
    return tuple(filter(None, named))


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
