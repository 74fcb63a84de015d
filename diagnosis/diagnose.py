"""From trials and a nominal model to a verdict: of the robot, or of another rig's single stages."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.engine.search import Progress
from softarm.diagnosis.robot.diagnose import Robot
from softarm.schemas.model import Model


def diagnose(
    trials: Sequence[Trial], model: Model | None = None, tell: Progress | None = None, processes: int = 1
) -> Diagnosis:
    """Where robot and simulator differ, which effect causes it, how far the gap shrinks. Deterministic.

    model: the nominal simulator, by default the seed's; tables of another rig bring their own. tell(what, share done).
    processes: stages of tables at a time.
    Raises TrialError when there are no trials, or trials of robot and rigs together, or nothing can be compared.
    """
    if not trials:
        raise TrialError("there is no trial to diagnose; name a campaign, a trial folder or a log")
    tables = [trial for trial in trials if trial.stage is not None]
    if tables and len(tables) < len(trials):
        raise TrialError(f"{tables[0].source}: another rig's table beside recordings of the robot; diagnose them apart")
    ordered = sorted(trials, key=lambda trial: (trial.name, str(trial.source)))
    say = tell or (lambda what, share: None)
    with _one_thread():
        if tables:
            # Another rig's laws are compiled when they are needed.
            from softarm.diagnosis.rigs.diagnose import diagnose_table
            from softarm.diagnosis.rigs.owner_units import in_owners_units

            return in_owners_units(diagnose_table(ordered, say, processes), ordered)
        return Robot(ordered, model or Model(), say).diagnosis()


@contextmanager
def _one_thread() -> Iterator[None]:
    """For BLAS and the boosted trees. Matrices are small: threads that spin for one another take twenty times the work.

    Workers of a pool have one each anyway (`common.processes`).
    """
    import sklearn  # noqa: F401  # what is loaded later is not limited

    with threadpool_limits(1):
        yield
