"""Refusals of every verb: wrong names, values, options and files end with the reason and the remedy."""

import json
import shlex
import shutil
from pathlib import Path

import pytest

from tests.cli.invoke import invoke

ROOT = Path(__file__).parents[3]
USAGE = 2  # exit code of a wrong option or argument; other refusals have 1
ONE_LINK = """
arm: {link_length_m: [0.4], link_mass_kg: [0.1], link_inertia_kg_m2: [0.001], stiffness_nm_rad: [0.01],
      damping_nm_s_rad: [0.01], muscle_gain_nm_kpa: [0.01], torque_offset_nm: [0.01]}
effects: {}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch, campaign):
    """Change to a folder with the files that the commands name, and return it."""
    for name in ("softarm.yaml", "twin.yaml", "softarm/simulator/models/seed.yaml"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "ports.yaml").write_text("api: {stop_port: 9001}\n")
    (tmp_path / "one-link.yaml").write_text(ONE_LINK)
    (tmp_path / "verdict.json").write_text(json.dumps({"verdict": "none", "effects": []}))
    (tmp_path / "reach.onnx").touch()
    (tmp_path / "a.mcap").write_text("no log")
    (tmp_path / "table.csv").write_text("a;b;c\n0;1;2\n")
    (tmp_path / "closed.before").mkdir()
    (tmp_path / "closed.before" / "summary.json").touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(folder, line, code):
    """Run a command that has to end with a code and to change no file, and return what it says."""
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    result = invoke(*shlex.split(line))
    assert result.exit_code == code, result.output
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
    return " ".join(result.stderr.split())


@pytest.mark.parametrize(
    ("line", "near"),
    [
        ("close-gap campaign --out closed --policy reech", "reach?"),
        ("close-gap campaign --out closed --robot no-dely", "no-delay?"),
        ("diagnose campaign --model no-dely", "no-delay?"),
        ("evaluate --all --only raech", "reach?"),
        ("evaluate --all --test gird", "grid?"),
        ("evaluate --all --test grid@no-dely", "no-delay?"),
        ("evaluate pid raech", "reach?"),
        ("evaluate reach --model nodelay", "no-delay?"),
        ("excite free-decay sed --simulated", "seed?"),
        ("model diff seed nodely", "no-delay?"),
        ("train raech", "reach?"),
        ("twin --config twin.yaml --fault mocap_freez", "mocap_freeze? allowed:"),
        ("twin --config twin.yaml --fault rail.delya=0.09", "rail.delay? `softarm twin --fault list` shows"),
        ("twin --config twin.yaml --model no-dely", "no-delay?"),
        ("twin --config twin.yaml --reality --fault rail.delay=0.09", "delay_s? write group.quantity=value"),
    ],
)
def test_a_misspelt_name_is_refused_with_the_nearest(folder, line, near):
    said = refused(folder, line, USAGE if line.startswith("train") else 1)
    assert f"did you mean {near}" in said


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("bridge natnet --server no.such.host.invalid --once", "no.such.host.invalid:1510: find: "),
        ("close-gap campaign --out closed --fault regulator.dead_time=0.06", "allowed here: inflate_s, deflate_s"),
        ("close-gap campaign --out closed --fault valve.stuck=1", "a group of regulator, rail, arm"),
        ("close-gap campaign --out closed --fault arm.payload_kg=heavy", "'heavy' is not a number"),
        ("close-gap campaign --out closed --fault arm.payload_kg=7", "allowed 0 to 0.5"),
        ("close-gap campaign --out closed.before", "already holds summary.json; name a new --out"),
        ("config new softarm.yaml", "softarm.yaml: exists and was not changed"),
        (
            "config new no/mine.yaml",
            "no/mine.yaml: cannot be read or written (No such file or directory); choose",
        ),
        ("config units torque", "no key contains 'torque'"),
        ("dev plan --out a.mcap/plans/p.npz", "a.mcap/plans: cannot be read or written (Not a directory); choose"),
        ("diagnose campaign --out a.mcap/x", "a.mcap/x: cannot be read or written (Not a directory); choose another"),
        ("diagnose campaign --json no/v.json", "no/v.json: the folder no does not exist; create it"),
        ("diagnose nowhere", "nowhere: does not exist; name an MCAP log, a trial folder"),
        ("evaluate --all --config missing.yaml", "missing.yaml"),
        ("evaluate --all --test held_back@no-delay", "takes no model"),
        ("evaluate hold", "policy hold: it takes no targets"),
        ("evaluate missing.onnx reach", "missing.onnx: does not exist; name an ONNX file"),
        ("evaluate pid reach.onnx", "reach.onnx: not an ONNX model that can be run"),
        ("evaluate campaign", "campaign: no policy (*.onnx or NAME/seed-K/*.onnx) in this folder"),
        ("evaluate verdict.json", "verdict.json: is no ONNX file"),
        ("evaluate ceiling --test shelf", "ceiling: is searched in the test grid alone"),
        ("evaluate ceiling --faults", "ceiling: is searched on the simulator alone; omit it, or omit --faults"),
        ("evaluate --test held_back --model no-delay", "takes no model: omit --model"),
        ("evaluate --report no/out.html", "no/out.html: the folder no does not exist; create it"),
        ("evaluate --film swing.avi", "the suffix is '.avi'; allowed .gif or .mp4"),
        ("evaluate --film swing.mp4", "needs the program ffmpeg, which is missing"),
        ("evaluate --film swing.gif --target 0.9 0.6", "--target 0.9 0.6: y_m 0.9 is outside the workspace; allowed"),
        ("evaluate ceiling --film swing.gif", "ceiling is a search, not a policy"),
        ("excite seed --reality --fault arm.paylod_kg=0.03", "write group.quantity=value"),
        ("identify nowhere --out m.yaml", "nowhere: does not exist; name an MCAP log, a trial folder"),
        ("identify nowhere --out m.yaml --json no/m.json", "no/m.json: the folder no does not exist"),
        ("identify campaign --check campaign --out m.yaml", "given for the fit and for the check"),
        ("incidents --folder nowhere", "nowhere: is not a folder; give the one of recorder.directory"),
        ("logs recover .", "a.mcap: not a log"),
        ("logs recover campaign", "campaign: no logs there; give the recorder's directory or a log"),
        ("model export --mjcf no/arm.xml seed", "cannot be read or written"),
        ("new policy Lean", "'Lean' is no valid name of a policy: allowed are lower-case letters, digits and single"),
        ("new policy ../lean", "allowed are lower-case letters"),
        ("new policy aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa", "at most 40 characters"),
        ("new policy lambda", "'lambda' is a keyword of Python; choose another name, such as my-lambda"),
        ("new policy lean --out campaign", "campaign: exists and is not overwritten; choose another --out"),
        ("new policy reach-wide", "the policy 'reach-wide' exists already"),
        ("new source zenoh", "the source 'zenoh' exists already"),
        ("new task shelf", "the task 'shelf' exists already"),
        ("new rig nowhere", "nowhere: does not exist; name the files or folders"),
        ("new rig table.csv --out no/stage.yaml", "no/stage.yaml: the folder no does not exist"),
        ("rail centre --config softarm.yaml --seconds 5 --url http://[", "no daemon at http://[: correct --url"),
        ("rail centre --config softarm.yaml --seconds 5 --url http://127.0.0.1:1", "no daemon at http://127.0.0.1:1: "),
        ("run --simulated --config none.yaml", "none.yaml"),
        ("run --simulated --model one-link.yaml", "has 1 links; the daemon flies an arm of 5"),
        ("run --simulated --config ports.yaml --port 9001", "--port 9001: stop_port is 9001 like port: choose"),
        ("service install", "root is required: put `sudo` before this command's full path"),
        ("status --url http://127.0.0.1:1", ":1 ([Errno 111] Connection refused): start one with `softarm run"),
        ("twin --config twin.yaml --fault arm.payload=heavy", "'heavy' is not a number"),
        ("twin --config twin.yaml --fault mocap_drop_body=link9", "allowed: cart, link1"),
        ("twin --config twin.yaml --fault pressure.lag=0.3", "write pressure.lag.inflate=VALUE or pressure.lag.d"),
        ("twin --config twin.yaml --fault rail.delay=9", "rail.delay.delay: is 9; allowed 0 to 0.1 s"),
        ("twin --config twin.yaml --fault rail_fault=3", "takes no value"),
        ("twin --config twin.yaml --fault rail_silence=-1", "seconds is -1.0; use a positive number"),
        ("twin --config twin.yaml --model one-link.yaml --reality", "has 1 links; the daemon flies an arm of 5"),
        ("twin --config twin.yaml --reality --fault rail.delay_s=3", "Rail.delay_s is 3; allowed 0 to 0.3 s"),
    ],
)
def test_a_value_that_cannot_be_used_is_refused_with_the_allowed_ones(folder, monkeypatch, line, message):
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setattr("shutil.which", lambda name: None)
    assert message in refused(folder, line, 1)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("bridge calibrate --server 127.0.0.1", "name the end of the rail where the last push stops: --end +y or"),
        ("bridge natnet", "--server ADDRESS of the computer that runs Motive"),
        ("check", "Missing argument 'FILE'"),
        ("check softarm.yaml --data .", "--data is for the data files of a stage.yaml: name one as FILE"),
        ("close-gap campaign --out closed --robot no-delay --fault arm.payload_kg=0.1", "for the independent robot"),
        ("evaluate reach --faults --test grid", "--faults has its own flights and table: omit"),
        ("close-gap campaign --out closed --twin", "--twin and --yes go with --config: name a configuration"),
        ("diagnose", "Missing argument 'INPUT...'"),
        ("diagnose campaign --data .", "--data is for the data files of a stage.yaml"),
        ("diagnose campaign --report campaign", "is a directory"),
        ("diagnose stage.yaml --limits limits.yaml", "--limits is for the rail of the robot"),
        ("diagnose stage.yaml --model seed", "is another rig and holds its own nominal model; omit --model"),
        ("doctor --url robot:8080", "e.g. http://127.0.0.1:8080"),
        ("doctor --url http://robot:port", "e.g. http://127.0.0.1:8080"),
        ("evaluate --all pid", "Choose rows with --only"),
        ("evaluate --matrix", "give its folder with --runs"),
        ("evaluate --matrix --runs . --model no-delay", "omit POLICY, --model and --all"),
        ("evaluate --model no-delay --test grid@no-delay", "names a model itself"),
        ("evaluate --only pid", "go with --all"),
        ("evaluate --target -0.3 0.6", "add --film FILE.gif"),
        ("evaluate --workers 2", "goes with a comparison"),
        ("evaluate shelf --film a.gif --target -0.45 0.6 --workers 1", "--workers goes with a comparison"),
        ("excite", "no excitation named: `softarm excite --list` shows all"),
        ("excite seed", "no robot chosen: use --config FILE for real devices, --simulated, or --reality"),
        ("excite seed --simulated --fault arm.payload_kg=0.03", "add --reality"),
        ("goal reach -0.2", "Missing argument 'Z'"),
        ("goal reach -0.2 0.6 --wiat", "--wiat"),
        ("goal reach nan 0.6", "nan is not a finite number; allowed are finite numbers; correct it"),
        ("goal run --seconds inf", "inf is not a finite number; allowed are finite numbers in the range x>0; correct"),
        ("goal reach left 0.6", "'left' is not a valid number"),
        ("status --watch --json", "--json one answer for a script: omit one"),
        (
            "twin --config twin.yaml fault list",
            "--config goes without a verb, or after it: `softarm twin fault --help`",
        ),
        ("goal xyzzy", "Try 'softarm goal --help' for help. Error: No such command 'xyzzy'."),
        ("incidents --out x.zip", "--out is for one file: give its NAME, or `latest`"),
        ("logs export --to xls a.mcap", "'xls' is not one of 'csv', 'parquet', 'foxglove'"),
        (
            "logs export --to csv a.mcap campaign/a.mcap",
            "have one name, which also names the export; allowed is each name",
        ),
        ("logs recover", "Missing argument 'PATHS...'"),
        ("new policy lean --out a.mcap", "'a.mcap' is a file"),
        ("new rig", "Missing argument 'DATA...'"),
        ("new rig table.csv --rate 0", "--rate"),
        ("new rig table.csv --unit b", "--unit b: has no value; write --unit NAME=VALUE"),
        ("polcy", "Did you mean 'policy'?"),
        ("policy lits", "Did you mean 'list'?"),
        ("rail centre --config softarm.yaml --seconds 5 --url robot", "e.g. http://127.0.0.1:8080"),
        ("rail centre --config softarm.yaml --seconds 5 --url ftp://robot", "e.g. http://127.0.0.1:8080"),
        ("rail home --config softarm.yaml --yes --speed 0", "0 is not in the range"),
        ("rail home --config softarm.yaml --yes --speed 0.5", "0.5 is not in the range"),
        ("rail home --config softarm.yaml --yes --speed nan", "allowed are finite numbers in the range 0.005<=x<=0.1"),
        ("run", "no robot chosen: use --config FILE for real devices"),
        ("run --config twin.yaml --model no-delay", "--model is for a simulated robot: add --simulated, or give it to"),
        ("run --simulated --foxglove 70000", "--foxglove 70000: allowed PORT or HOST:PORT, PORT 0 to 65535 (0: any)"),
        ("run --simulated --port 80800", "80800 is not in the range 0<=x<=65535"),
        ("service install --root . --user 'a b'", "is not a valid user name"),
        ("service install --root . --user 'ann\nExecStart=/bin/sh'", "is not a valid user name"),
        ("status --url 127.0.0.1:8080", "e.g. http://127.0.0.1:8080"),
        ("status --url http://[::1", "e.g. http://127.0.0.1:8080"),
        ("train reach --workers 4", "--workers is for many runs: add --sweep FILE"),
        ("twin", "no ports given: use --config FILE"),
        ("logs view", "which log? `softarm logs list` lists them"),
        ("xyzzy", "Try 'softarm --help' for help. Error: No such command 'xyzzy'."),
    ],
)
def test_a_wrong_use_is_refused_with_the_right_one(folder, line, message):
    assert message in refused(folder, line, USAGE)


@pytest.mark.parametrize("verb", ["diagnose", "identify --out mine.yaml"])
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("seed.yaml", "is a model of the robot; give it as --model, and name recordings"),
        ("softarm.yaml", "is a configuration of the daemon; name recordings, which are in its recorder.directory"),
        (
            "verdict.json",
            "is a verdict; name recordings here, and play its next experiment with `softarm excite --plan`",
        ),
        ("reach.onnx", "is a policy; name recordings here, and fly policies with `softarm evaluate`"),
    ],
)
def test_a_file_that_is_not_a_recording_is_recognised(folder, verb, name, message):
    assert refused(folder, f"{verb} {name}", 1) == f"{name}: {message}"


@pytest.mark.parametrize("verb", ["view --no-open", "export --to csv", "recover", "show", "replay"])
def test_a_file_that_is_not_a_log_is_refused(folder, verb):
    said = "a.mcap: not a log; a log is an MCAP file, as the recorder writes it"
    assert refused(folder, f"logs {verb} a.mcap", 1).startswith(said)
