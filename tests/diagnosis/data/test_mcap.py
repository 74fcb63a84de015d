"""The daemon's log as a trial: same values, measured stamps."""

from dataclasses import replace

import numpy as np
import pytest

from softarm.daemon.logbook import logs
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.logbook.ticks import TickFile
from softarm.daemon.runtime.offline import Lockstep
from softarm.diagnosis.data import mcap
from softarm.diagnosis.data.trials import TrialError
from softarm.policies.excite import Excite
from softarm.recordings import flight
from softarm.schemas.config import Config
from softarm.schemas.config import Recorder as RecorderConfig
from softarm.schemas.goals import Goal


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    config = Config(recorder=RecorderConfig(directory=tmp_path_factory.mktemp("logs")))
    policy = Excite("pressure-multisine")
    recorder = Recorder(config, policy.spec)
    recorder.start()
    lockstep = Lockstep(config, policy, record=recorder.tick)
    lockstep.arm()
    lockstep.tick(lockstep.request("goal", Goal("run")))
    for _ in range(240):
        lockstep.tick()
    lockstep.tick(lockstep.request("disarm"))
    recorder.stop()
    return recorder.path


def test_the_trial_has_the_values_of_the_log(recording):
    trial = mcap.read(recording)
    ticks = list(logs.read(recording).ticks())
    origin = ticks[0][0].mocap[0].t_capture_ns
    frames = [frame for inputs, _ in ticks for frame in inputs.mocap]
    mocap = trial.channels["mocap"]
    np.testing.assert_allclose(mocap.t_s, [(f.t_capture_ns - origin) * 1e-9 for f in frames], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(mocap["link5_z"], [f.bodies[5].z_m for f in frames])
    sent = [(o.t_ns, o.sent.pressure_kpa) for _, o in ticks]
    first = next(i for i, (_, o) in enumerate(ticks) if o.sent.enable)
    np.testing.assert_array_equal(trial.channels["command"]["pressure"], [kpa for _, kpa in sent[first:]])
    np.testing.assert_array_equal(trial.channels["pressure"]["pressure"], [i.pressure.pressure_kpa for i, _ in ticks])
    assert trial.channels["observation"]["tip_z"][-1] == ticks[-1][1].observed.values.tip_z_m
    assert (trial.kind, trial.not_observable, trial.warnings) == ("excite", {}, ())


def test_a_cart_that_the_arm_moves_is_not_held(recording):
    trial = mcap.read(recording)
    assert not trial.channels["command"]["cart_velocity"].any()
    assert np.ptp(trial.channels["rail"]["position"]) > mcap.HELD_M
    assert trial.rail == "free"


def test_a_truncated_log_is_read_to_its_end(recording, tmp_path):
    whole = mcap.read(recording)
    live = tmp_path / "killed.mcap"
    # Unfinished logs have no chunks: write one as the recorder does while it runs, and cut it.
    with live.open("wb") as file:
        writer = TickFile(file)
        for tick in logs.read(recording):
            writer.write(tick)
        writer.flush()
    live.write_bytes(live.read_bytes()[: live.stat().st_size // 2])
    half = mcap.read(live)
    count = len(half.channels["mocap"])
    assert 0.3 < count / len(whole.channels["mocap"]) < 0.7
    np.testing.assert_array_equal(half.channels["mocap"].t_s, whole.channels["mocap"].t_s[:count])


def test_frames_of_another_clock_are_left_out_and_set_no_zero(recording, tmp_path):
    early = tmp_path / "early.mcap"
    with early.open("wb") as file:
        writer = TickFile(file)
        for inputs, outputs, timing in logs.read(recording):
            wrong = tuple(replace(f, t_capture_ns=f.t_receive_ns + 10**9) for f in inputs.mocap)
            writer.write((replace(inputs, mocap=wrong) if outputs.tick < 3 else inputs, outputs, timing))
        writer.flush()
    trial, begin_ns = mcap.read(early), flight.first_stamp_ns(early)
    first = next(frame for inputs, outputs, _ in logs.read(recording) if outputs.tick >= 3 for frame in inputs.mocap)
    assert trial.channels["mocap"].t_s[0] == (first.t_capture_ns - begin_ns) * 1e-9


def test_a_file_that_is_not_a_log_is_rejected(tmp_path):
    path = tmp_path / "x.mcap"
    path.write_bytes(b"no log at all, just some bytes")
    with pytest.raises(TrialError, match="not a log; a log is an MCAP file"):
        mcap.read(path)
    with pytest.raises(TrialError, match="cannot be read"):
        mcap.read(tmp_path / "none.mcap")
