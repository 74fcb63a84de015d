"""Diagnosis of trials of the robot or of a rig."""

import gc
from collections.abc import Sequence

from threadpoolctl import threadpool_limits

from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.engine.work import Progress
from softarm.diagnosis.robot.diagnose import diagnose_robot
from softarm.schemas.model import Model

BUDGET_S = 120.0


def diagnose(
    trials: Sequence[Trial],
    model: Model | None = None,
    progress: Progress = lambda what, share: None,
    processes: int = 1,
    budget_s: float = BUDGET_S,
) -> Diagnosis:
    """Find where robot and simulator differ, by which effects, and how far the gap shrinks with them.

    The result is deterministic.

    Args:
        trials: trials of the robot or of a rig.
        model: nominal model of the robot, by default the seed's; a rig's tables bring their own.
        progress: called with the current step and the finished share, 0 to 1.
        processes: number of a rig's stages that are diagnosed at the same time.
        budget_s: processor time for a rig, s; of longer recordings only the most informative stretches are used.

    Raises:
        TrialError: there are no trials, or trials of the robot and of rigs, or nothing can be compared.
    """
    if not trials:
        raise TrialError("no trial to diagnose; name a campaign, a trial folder or a log")
    tables = [trial for trial in trials if trial.stage is not None]
    if tables and len(tables) < len(trials):
        raise TrialError(f"{tables[0].source}: tables of a rig and recordings of the robot; diagnose them separately")
    ordered = sorted(trials, key=lambda trial: (trial.name, str(trial.source)))
    import sklearn  # noqa: F401  # the limit only holds for loaded libraries

    # With small matrices, BLAS and the boosted trees take twenty times the work on several threads.
    try:
        with threadpool_limits(1):
            if tables:
                # The laws of rigs are compiled on import.
                from softarm.diagnosis.rigs.diagnose import diagnose_table
                from softarm.diagnosis.rigs.owner_units import in_owners_units

                return in_owners_units(diagnose_table(ordered, progress, processes, budget_s), ordered)
            return diagnose_robot(ordered, model or Model(), progress)
    finally:
        # A search refers to itself, and the collector does not count its arrays: a hundred robots kept 5 GB.
        gc.collect()
