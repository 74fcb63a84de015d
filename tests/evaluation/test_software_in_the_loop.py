"""Twin and daemon as separate processes: a daemon that cannot start is reported."""

from contextlib import ExitStack

import pytest

from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError

pytestmark = pytest.mark.timeout(120)


@pytest.mark.slow
def test_a_daemon_that_ends_at_once_is_reported_with_its_output(tmp_path):
    alone = SoftwareInTheLoop(tmp_path / "logs", {"control": {"policy": "raech"}})
    with ExitStack() as end:
        end.push(alone)
        with pytest.raises(SoftwareInTheLoopError, match=r"`softarm run` ended with 1:\n.*no policy 'raech'"):
            alone.start_daemon()
