"""Mistakes in a rig's table: each gives one sentence with file, column or key, and the next step."""

import re

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import TrialError
from tests.diagnosis.data.servo import changed, read, table

T = np.arange(400) * 0.01
COMMAND = 50 + 30 * np.sign(np.sin(1.7 * T))
MEASURED = 50 + 30 * np.tanh(4 * np.sin(1.7 * (T - 0.05))) + 0.05 * np.sin(97 * T)

STAGE = """
name: chamber
kind: tracking
channels:
  command: {time: {source: t, unit: s}, columns: {command: {source: u, unit: kPa}}}
  measured: {time: {source: t, unit: s}, columns: {pressure: {source: p, unit: kPa}}}
model: {lag_s: 0.05}
trials:
  - {name: one, kind: steps, files: {command: sent.csv, measured: seen.csv}}
"""


class Rig:
    """Files of a valid rig, which a test can change."""

    def __init__(self, folder):
        self.folder = folder
        self.sent = {"t": T.copy(), "u": COMMAND.copy()}
        self.seen = {"t": T.copy(), "p": MEASURED.copy()}
        self.stage = STAGE

    def lines(self, columns):
        return table(",".join(columns), *columns.values()).splitlines()

    def write(self):
        for name in ("sent", "seen"):
            path = self.folder / f"{name}.csv"
            if not path.exists():
                path.write_text("\n".join(self.lines(getattr(self, name))) + "\n")
        (self.folder / "stage.yaml").write_text(self.stage)
        return self.folder / "stage.yaml"

    def says(self, old, new):
        self.stage = changed(self.stage, (old, new))

    def cell(self, row, text):
        lines = self.lines(self.seen)
        lines[row - 1] = lines[row - 1].rpartition(",")[0] + "," + text
        (self.folder / "seen.csv").write_text("\n".join(lines) + "\n")


@pytest.fixture
def rig(tmp_path):
    return Rig(tmp_path)


BASE = "  base: {time: {source: t, unit: s}, columns: {position: {source: p, unit: m}}}\nmodel:"
MISSING = "table: {missing: [nan]}\n"
FILES = "{command: sent.csv, measured: seen.csv}"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("lag_s: 0.05", "tau_s: 1", r"stage.yaml:7: model.tau_s: unknown key; did you mean lag_s\?"),
        ("model:", BASE, r"stage.yaml:7: channels.base: unknown channel; a tracking stage has command, measured; call"),
        ("name: chamber", "name: v1.2", r"stage.yaml: v1.2: its name holds a dot, which separates .*; rename it"),
        ("kind: tracking", "kind: tracking\nlinks: 2", r"links: is for a chain or a pendulum"),
        ("kind: tracking", "kind: tracking\nangles: relative", r"angles: is for a chain"),
        ("tracking", "trakcing", r"stage.yaml:3: kind: is 'trakcing'; allowed 'tracking' or"),
        ("p, unit: kPa", "p, unit: kpa", r"pressure.unit: no unit 'kpa'; did you mean kPa\?"),
        ("p, unit: kPa", "p, unit: mm", r"stage.yaml:6: .*pressure.unit: is mm, not a unit of pressure; .* kPa"),
        ("u, unit: kPa", "u, unit: V", r"stage.yaml:7: model: the command is in V, .*: write `gain` \(kPa for one V\)"),
        ("t, unit: s", "t, unit: m", r"time.unit: is a unit of m, not of time; write s"),
        ("{pressure:", "{presure:", r"columns.presure: unknown column; did you mean pressure\? .*call it one of these"),
        ("source: p", "source: q", r"seen.csv: no column q; it has t, p; correct the stage.yaml"),
        ("source: p", "source: p - t", r"no column p - t; .*; for a difference write `source: p, minus: t`"),
        ("source: p", "source: 0", r"stage.yaml:6: channels.measured.columns.pressure.source: is 0; allowed"),
        ("source: p", "source: 3", r"seen.csv: no column 3; it has 2, counted from 1; correct `source`"),
        ("seen.csv", "gone.csv", r"gone.csv: does not exist; correct `files`"),
        ("seen.csv", "g" * 300 + ".csv", r"ggg.csv: does not exist; correct `files`"),
        (FILES, "'runs/*.csv'", r"stage.yaml: trial one: files: no file matches .*runs/\*.csv; correct the pattern"),
        (FILES, "'runs/**.csv'", r"runs/\*\*.csv: files: \*\*.csv has \*\* within a name; allowed as a whole folder"),
        ("measured: seen.csv}", "measurd: seen.csv}", r"files: no channel measurd; did you mean measured\? the file"),
        (", measured: seen.csv", "", r"trial one: names no file for the measured channel; add it under `files`"),
        ("kind: tracking", "kind: tracking\nelements: {a: 0}", r"sent.csv: column u contains plain numbers, not lists"),
        ("kind: steps,", "kind: steps, segment: a,", r"has a segment, but no `source` holds \{segment\}; put"),
        ("t, unit: s", "t, unit: ms", r"t: rows are 1e-05 s apart; its stamps look like s: write `unit: s`"),
    ],
)
def test_a_mistake_in_a_stage_file_is_reported_with_place_and_next_step(rig, old, new, says):
    rig.says(old, new)
    assert_refused(rig, says)


@pytest.mark.parametrize(
    ("cell", "says"),
    [
        ("oops", r"'oops' is not a finite number; repair it"),
        ("", r"'' is not .* write `table: \{missing: \[\"\"\]\}`"),
        ("nan", r"'nan' is .* write `table: \{missing: \[nan\]\}`"),
    ],
)
def test_a_cell_without_a_number_is_reported_with_its_row(rig, cell, says):
    rig.cell(7, cell)
    assert_refused(rig, r"seen.csv: column p, row 7: " + says)


@pytest.mark.parametrize(("wrong", "says"), [(1.0, ()), (2.2, ("velocity is 2.2 times the slope of position",))])
def test_only_a_wrong_velocity_beside_its_position_gives_a_warning(rig, wrong, says):
    rig.seen["v"] = wrong * np.gradient(rig.seen["p"], T)
    rig.says("pressure: {source: p, unit: kPa}", "position: {source: p, unit: mm}, velocity: {source: v, unit: mm/s}")
    rig.says("command: {source: u, unit: kPa}", "command: {source: u, unit: mm}")
    (trial,) = tables.read(rig.write())
    assert len(trial.warnings) == len(says)
    assert all(text in warning for text, warning in zip(says, trial.warnings, strict=True))


def test_commands_beyond_a_map_reach_the_ends_of_its_lines(rig):
    rig.says("lag_s: 0.05", "map: [[0, 0], [10, 10]]")
    (trial,) = tables.read(rig.write())
    assert trial.warnings == ()
    assert trial.stage.reached(np.array([-1.0, 5.0, 80.0])) == pytest.approx([-1.0, 5.0, 80.0])


def _short(rig):
    rig.seen = {name: values[:15] for name, values in rig.seen.items()}


def _parquet(rig, values, stage=""):
    parquet.write_table(pa.table({"t": T, "p": values}), rig.folder / "seen.parquet")
    rig.says("seen.csv", "seen.parquet")
    rig.stage += stage


def _ragged(rig):
    lines = rig.lines(rig.seen)
    lines[9] += ",7"
    (rig.folder / "seen.csv").write_text("\n".join(lines))


def _headerless(rig):
    (rig.folder / "seen.csv").write_text("\n".join(rig.lines(rig.seen)[1:]))


def _other_file(rig, name):
    (rig.folder / name).write_text("x")
    rig.says("seen.csv", name)


def _times(factor):
    """Multiply the stamps of both channels."""
    return lambda rig: (rig.seen["t"].__imul__(factor), rig.sent["t"].__imul__(factor))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda rig: _parquet(rig, np.full(400, np.nan)), r"column p, every row is nan; leave such rows out, or write"),
        (lambda rig: _parquet(rig, np.full(400, np.nan), MISSING), r"column p has no value in any row; leave it out"),
        (lambda rig: _parquet(rig, ["on"] * 400), r"seen.parquet: column p does not contain numbers; correct it or"),
        (_ragged, r"seen.csv: row 10 has 3 cells, the header 2; repair that row"),
        (lambda rig: (rig.folder / "seen.csv").write_text(""), r"seen.csv: has no rows; record some"),
        (_headerless, r"seen.csv: no column t; it has no header, but 2 columns: name them by number, from 1"),
        (lambda rig: _other_file(rig, "seen.xlsx"), r"seen.xlsx: tables are .csv, .*, .bag; export it as one"),
        (lambda rig: _other_file(rig, "seen.parquet"), r"seen.parquet: cannot be read \(.*\); export it again"),
        (lambda rig: (rig.seen["p"].fill(1.0), rig.sent["u"].fill(0.0)), r"column p: nothing moves in this trial, n"),
        (lambda rig: rig.seen["p"].__imul__(1e3), r"seen.csv: column p: .*e\+03 times .*; pressure looks like Pa or"),
        (lambda rig: rig.seen["p"].__itruediv__(6.895), r"moves 0.145 times .*pressure looks like psi: correct `unit`"),
        (_times(1e3), r"seen.csv: column t: rows are 10 s apart; its stamps look like ms: write `unit: ms`"),
        (
            lambda rig: (rig.seen["t"].__imul__(100), rig.sent["t"].__imul__(0.1)),
            r"sent.csv: column t: the command channel lasts .* measured .*: the stamps of one|correct its `unit`",
        ),
        (lambda rig: rig.seen["t"].__iadd__(500.0), r"command channel runs from 0 to 3.99 s, measured from 500 .*one"),
        (lambda rig: rig.seen["t"][200:].__isub__(60.0), r"clock is set back by 59.99 s at row 202 .*; split the"),
        (lambda rig: rig.seen["t"][300:].__iadd__(1e6), r"the clock jumps ahead by 1e\+06 s at row 302; split the"),
        (lambda rig: rig.seen["t"].fill(3.0), r"seen.csv: column t: every row has the stamp 3 s; name the"),
        (_short, r"seen.csv: column t: 15 rows over 0.14 s; the measured channel needs 20 rows over 0.8 s"),
    ],
)
def test_a_mistake_in_a_table_is_reported_with_place_and_next_step(rig, change, says):
    change(rig)
    assert_refused(rig, says)


def assert_refused(rig, says):
    text = refusal(rig.write())
    assert re.search(says, text), text
    assert len(text.splitlines()) <= 2  # the same of each of two channels at most


def refusal(stage):
    """Return the error of reading a stage."""
    try:
        tables.read(stage)
    except TrialError as error:
        return str(error)
    return "nothing"


CART = """
name: cart
kind: driven_mass
channels:
  force: {time: {source: t, unit: s}, columns: {current: {source: i, unit: mA}}}
  measured: {time: {source: t, unit: s}, columns: {position: {source: x, unit: mm}, velocity: {source: v, unit: mm/s}}}
model: {mass_kg: 2, gain: 8}
trials: [{files: cart.csv}]
"""


SPEED = ", velocity: {source: v, unit: mm/s}"


def cart(folder, *changes):
    """Write a cart of 2 kg under 0.5 A of a motor that gives 8 N/A."""
    moved = 500 * np.sin(3 * T), -1e3 * 2 / 9 * np.sin(3 * T), -1e3 * 2 / 3 * np.cos(3 * T)
    (folder / "cart.csv").write_text(table("t,i,x,v", T, *moved))
    (folder / "stage.yaml").write_text(changed(CART, *changes))
    return folder / "stage.yaml"


def test_the_unchanged_cart_is_valid(tmp_path):
    (trial,) = tables.read(cart(tmp_path))
    assert trial.warnings == ()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("unit: mm/s", "unit: m/s", r"column v: velocity is 1e\+03 times .* position looks like m or velocity"),
        ("unit: mm}", "unit: m}", r"column v: velocity is 0.001 times .* position looks like mm or velocity looks"),
        (SPEED, "", "nothing"),
        (", gain: 8", "", r"stage.yaml:7: model: the input is a current or a voltage: write `gain`, in N or N m per A"),
        ("mass_kg", "inertia_kg_m2", r"model: the measured columns are in m or m/s: write mass_kg"),
        ("unit: mA", "unit: mV", r"current.unit: is mV, not a unit of current; allowed are units of A; correct it"),
    ],
)
def test_a_mistake_in_a_cart_is_reported(tmp_path, old, new, says):
    stage = cart(tmp_path, (old, new))
    assert re.search(says, refusal(stage)), refusal(stage)


def test_a_position_that_no_force_explains_is_reported(tmp_path):
    stage = cart(tmp_path, (SPEED, ""), ("unit: mm}", "unit: m}"))
    assert re.search(r"column x: position accelerates by 1\.\d+e\+03 .* allow 12", refusal(stage)), refusal(stage)


@pytest.mark.parametrize(("keys", "shown"), [("", "512 mm/s"), (", scale: 0.25", "512"), (", scale: 0", "0")])
def test_a_velocity_that_never_changes_is_a_dead_sensor(tmp_path, keys, shown):
    cart(tmp_path, ("unit: mm/s", f"unit: mm/s{keys}"))
    (tmp_path / "cart.csv").write_text(table("t,i,x,v", T, np.sin(3 * T), np.sin(3 * T), 0 * T + 512))
    assert f"column v: velocity is {shown} in every row; a dead sensor" in refusal(tmp_path / "stage.yaml")


PENDULUM = """
name: joint
kind: pendulum
channels:
  measured: {time: {source: t, unit: s}, columns: {angle1: {source: a, unit: deg}}}
model: {mass_kg: 1, centre_m: 0.1, inertia_kg_m2: 0}
trials: [{files: swing.csv}]
"""


def test_a_wrapped_angle_and_a_pendulum_at_pi_are_reported(tmp_path):
    wrapped = (350 + 60 * np.sin(3 * T)) % 360 - 180
    says = r"swing.csv: column a: angle1 starts again after a whole turn at .*unwrap"
    with pytest.raises(TrialError, match=says):
        read(tmp_path, table("t,a", T, wrapped), stage=PENDULUM, name="swing.csv")
    (trial,) = read(tmp_path, table("t,a", T, 180 + 20 * np.sin(3 * T)), stage=PENDULUM, name="swing.csv")
    says = r"column a: the median of angle1 is 3.1\d* rad, .* hangs at 0; write `add: -3.141593`"
    assert re.search(says, trial.warnings[0])


def _repeated(rig):
    rig.seen["t"][1::2] = rig.seen["t"][::2]


def _ends_early(rig):
    rig.sent = {name: values[:100] for name, values in rig.sent.items()}


def _dead_effort(rig):
    rig.seen["v"] = np.zeros(400)
    rig.says("kPa}}}\nmodel", "kPa}, effort: {source: v, unit: A}}}\nmodel")


def _mostly_missing(rig):
    rig.seen["p"][:300] = -999
    rig.says("trials:", "table: {missing: [-999]}\ntrials:")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_repeated, r"seen.csv: measured: 200 rows repeat a stamp .*; write every row once"),
        (_ends_early, r"seen.csv: column t: goes on for 3 s after the last command, .*; cut those rows"),
        (lambda rig: rig.sent["u"].fill(50.0), r"sent.csv: column u: the command is 50 kPa in every row, but the me"),
        (_dead_effort, r"seen.csv: column v: effort is 0 A in every row; leave the column out"),
        (_times(100), r"column t: rows are 1 s apart; if its stamps are in ms, write `unit: ms`; if they count rows"),
        (_mostly_missing, r"seen.csv: column p has no value in 75% of the rows, which are left out"),
    ],
)
def test_doubtful_data_are_read_with_a_warning(rig, change, says):
    change(rig)
    (trial,) = tables.read(rig.write())
    assert len(trial.warnings) <= 2, trial.warnings  # the same of each of two channels at most
    assert re.search(says, trial.warnings[-1]), trial.warnings


def test_commands_may_be_logged_only_when_they_change(rig):
    changed = np.concatenate(([True], np.diff(COMMAND) != 0))
    assert changed.sum() < 10
    rig.sent = {name: values[changed] for name, values in rig.sent.items()}
    rig.says("trials:", "trials:\n  - {name: hold, kind: hold, files: {command: set.csv, measured: long.csv}}")
    t = np.arange(0, 200, 0.05)
    (rig.folder / "set.csv").write_text("t,u\n0,20\n5,80\n12,20\n112,80\n")
    held = np.interp(t, [0, 5, 5.2, 12, 12.2, 112, 112.2], [20, 20, 80, 80, 20, 20, 80])
    (rig.folder / "long.csv").write_text("t,p\n" + "".join(f"{a:.2f},{b}\n" for a, b in zip(t, held, strict=True)))
    hold, one = tables.read(rig.write())
    assert (hold.name, one.warnings) == ("hold", ())
    (late,) = hold.warnings
    assert "long.csv: column t: goes on for 87.9 s after the last command" in late


def two_trials(rig, sent, seen):
    """Add a second trial to the rig."""
    rig.says("trials:", "trials:\n  - {name: two, kind: hold, files: {command: sent2.csv, measured: seen2.csv}}")
    (rig.folder / "sent2.csv").write_text("\n".join(rig.lines({"t": T, "u": sent})))
    (rig.folder / "seen2.csv").write_text("\n".join(rig.lines({"t": T, "p": seen})))
    return rig.write()


def test_a_trial_without_motion_is_left_out_with_a_warning(rig):
    (trial,) = tables.read(two_trials(rig, np.full(400, 20.0), np.full(400, 20.5)))
    assert trial.name == "one"
    assert re.search(r"seen2.csv: column p: nothing moves in this trial, .*; it is left out", trial.warnings[0])


def test_no_motion_under_a_small_command_is_a_warning_and_under_a_large_one_an_error(rig):
    two, one = tables.read(two_trials(rig, 50 + 5 * np.sin(T), np.full(400, 50.2)))
    assert (two.name, one.warnings) == ("two", ())
    assert re.search(r"seen2.csv: column p: pressure is 50.2 kPa in every row, under a small command", two.warnings[0])
    (rig.folder / "sent2.csv").write_text("\n".join(rig.lines({"t": T, "u": 50 + 25 * np.sin(T)})))
    assert re.search(
        r"seen2.csv: column p: pressure is 50.2 kPa in every row; a dead sensor", refusal(rig.folder / "stage.yaml")
    )


def test_a_trial_with_a_constant_command_is_valid(rig):
    two, _ = tables.read(two_trials(rig, np.full(400, 50.0), 50 + 0.05 * np.sin(97 * T)))
    assert two.warnings == ()


def test_a_dead_column_is_reported_in_the_tables_unit_before_add(rig):
    rig.says("source: p, unit: kPa}", "source: p, unit: mbar, add: -101.3}")
    rig.seen["p"] = np.full_like(T, 1013.0)
    assert "pressure is 1013 mbar in every row" in refusal(rig.write())
