"""Mistakes in a rig's table: each gives one sentence with file, column or key, and the next step."""

import re
import warnings

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import TrialError

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
        rows = zip(*(map(str, c.tolist()) for c in columns.values()), strict=True)
        return [",".join(columns), *map(",".join, rows)]

    def write(self):
        for name in ("sent", "seen"):
            path = self.folder / f"{name}.csv"
            if not path.exists():
                path.write_text("\n".join(self.lines(getattr(self, name))) + "\n")
        (self.folder / "stage.yaml").write_text(self.stage)
        return self.folder / "stage.yaml"

    def says(self, old, new):
        assert old in self.stage
        self.stage = self.stage.replace(old, new)

    def cell(self, row, text):
        lines = self.lines(self.seen)
        lines[row - 1] = lines[row - 1].rpartition(",")[0] + "," + text
        (self.folder / "seen.csv").write_text("\n".join(lines) + "\n")


@pytest.fixture
def rig(tmp_path):
    return Rig(tmp_path)


def test_the_unchanged_rig_is_valid(rig):
    (trial,) = tables.read(rig.write())
    assert trial.warnings == ()


def _clock_back(rig):
    rig.seen["t"][200:] -= 60.0


def _repeated(rig):
    rig.seen["t"][1::2] = rig.seen["t"][::2]


def _short(rig):
    rig.seen = {name: values[:15] for name, values in rig.seen.items()}


def _long(rig):
    rig.sent = {name: values[:100] for name, values in rig.sent.items()}


def _parquet(rig, values):
    parquet.write_table(pa.table({"t": T, "p": values}), rig.folder / "seen.parquet")
    rig.says("seen.csv", "seen.parquet")


def _ragged(rig):
    lines = rig.lines(rig.seen)
    lines[9] += ",7"
    (rig.folder / "seen.csv").write_text("\n".join(lines))


def _headerless(rig):
    (rig.folder / "seen.csv").write_text("\n".join(rig.lines(rig.seen)[1:]))


def _gap_of_the_clock(rig):
    rig.seen["t"][300:] += 1e6


WRONG = {
    "an unknown key of the model": (
        lambda rig: rig.says("lag_s: 0.05", "time_constant_s: 1"),
        r"stage.yaml:7: model.time_constant_s: unknown key; did you mean lag_s\? the model of a tracking stage",
    ),
    "a channel of another kind": (
        lambda rig: rig.says(
            "model:", "  base: {time: {source: t, unit: s}, columns: {position: {source: p, unit: m}}}\nmodel:"
        ),
        r"stage.yaml:7: channels.base: unknown channel; a tracking stage has command, measured; call it one of these",
    ),
    "links of a tracking stage": (
        lambda rig: rig.says("kind: tracking", "kind: tracking\nlinks: 2"),
        r"links: is for a chain or a pendulum",
    ),
    "angles of a tracking stage": (
        lambda rig: rig.says("kind: tracking", "kind: tracking\nangles: relative"),
        r"angles: is for a chain",
    ),
    "a negative lag": (lambda rig: rig.says("0.05", "-1"), r"stage.yaml:7: model.lag_s: is -1; allowed 0 to 1000 s"),
    "a lag as text": (
        lambda rig: rig.says("0.05", "50 ms"),
        r"model.lag_s: is '50 ms'; .*write a bare number in s: 0.05",
    ),
    "an unknown kind": (
        lambda rig: rig.says("tracking", "trakcing"),
        r"stage.yaml:3: kind: is 'trakcing'; allowed 'tracking' or",
    ),
    "a mistyped key": (
        lambda rig: rig.says("trials:", "trails:"),
        r"stage.yaml:8: trails: unknown key; did you mean trials\?",
    ),
    "an unknown unit": (
        lambda rig: rig.says("p, unit: kPa", "p, unit: kpa"),
        r"pressure.unit: no unit 'kpa'; did you mean kPa\?",
    ),
    "a unit of another thing": (
        lambda rig: rig.says("p, unit: kPa", "p, unit: mm"),
        r"stage.yaml:6: channels.measured.columns.pressure.unit: is mm, not a unit of pressure; .* kPa; correct it",
    ),
    "a command in volts": (
        lambda rig: rig.says("u, unit: kPa", "u, unit: V"),
        r"stage.yaml:7: model: the command is in V, the measured pressure in kPa: write `gain` \(kPa for one V\)",
    ),
    "a time in metres": (
        lambda rig: rig.says("t, unit: s", "t, unit: m"),
        r"time.unit: is a unit of m, not of time; write s",
    ),
    "an unknown column's name": (
        lambda rig: rig.says("{pressure:", "{presure:"),
        r"columns.presure: unknown column; did you mean pressure\? .*call it one of these",
    ),
    "no such column": (
        lambda rig: rig.says("source: p", "source: q"),
        r"seen.csv: no column q; it has t, p; correct the stage.yaml",
    ),
    "a difference in one source": (
        lambda rig: rig.says("source: p", "source: p - t"),
        r"seen.csv: no column p - t; it has t, p; for a difference write `source: p, minus: t`",
    ),
    "no such file": (lambda rig: rig.says("seen.csv", "gone.csv"), r"gone.csv: does not exist; correct `files`"),
    "a pattern that nothing fits": (
        lambda rig: rig.says("{command: sent.csv, measured: seen.csv}", "'runs/*.csv'"),
        r"stage.yaml: trial one: files: no file matches .*runs/\*.csv; correct the pattern",
    ),
    "files for no channel": (
        lambda rig: rig.says("measured: seen.csv}", "measurd: seen.csv}"),
        r"stage.yaml: trial one: files: no channel measurd; did you mean measured\? the file describes command",
    ),
    "no file for a channel": (
        lambda rig: rig.says(", measured: seen.csv", ""),
        r"stage.yaml: trial one: names no file for the measured channel; add it under `files`",
    ),
    "a text for a number": (
        lambda rig: rig.cell(7, "oops"),
        r"seen.csv: column p, row 7: 'oops' is not a finite number; repair it",
    ),
    "an empty cell": (
        lambda rig: rig.cell(7, ""),
        r"seen.csv: column p, row 7: '' is not .* write `table: \{missing: \[\"\"\]\}`",
    ),
    "a nan": (
        lambda rig: rig.cell(7, "nan"),
        r"seen.csv: column p, row 7: 'nan' is .* write `table: \{missing: \[nan\]\}`",
    ),
    "an infinity": (
        lambda rig: rig.cell(7, "inf"),
        r"seen.csv: column p, row 7: 'inf' is not a finite number; repair it",
    ),
    "a decimal comma among commas": (
        lambda rig: rig.cell(7, '"1,5"'),
        r"seen.csv: column p, row 7: '1,5' is not a finite number; write `table: \{decimal: ','\}`",
    ),
    "a column of nothing but nan": (
        lambda rig: _parquet(rig, np.full(400, np.nan)),
        r"seen.parquet: column p, every row is nan; leave such rows out, or write `table: \{missing: \[nan\]\}`",
    ),
    "nothing was measured in any row": (
        lambda rig: (_parquet(rig, np.full(400, np.nan)), rig.says("trials:", "table: {missing: [nan]}\ntrials:")),
        r"seen.parquet: column p has no value in any row; leave it out of the stage.yaml, or this trial",
    ),
    "a column of text": (
        lambda rig: _parquet(rig, ["on"] * 400),
        r"seen.parquet: column p does not contain numbers; correct it or name another",
    ),
    "a ragged row": (_ragged, r"seen.csv: row 10 has 3 cells, the header 2; repair that row"),
    "an empty file": (lambda rig: (rig.folder / "seen.csv").write_text(""), r"seen.csv: has no rows; record some"),
    "no header": (_headerless, r"seen.csv: no column t; it has no header, but 2 columns: name them by number, from 1"),
    "a file of another kind": (
        lambda rig: ((rig.folder / "seen.xlsx").write_text("x"), rig.says("seen.csv", "seen.xlsx")),
        r"seen.xlsx: tables are .csv, .* or .mat; export it as one of these",
    ),
    "a damaged file": (
        lambda rig: ((rig.folder / "seen.parquet").write_text("x"), rig.says("seen.csv", "seen.parquet")),
        r"seen.parquet: cannot be read \(.*\); export it again",
    ),
    "a dead sensor": (
        lambda rig: rig.seen["p"].fill(101.3),
        r"seen.csv: column p: pressure is 101.3 kPa in every row; a dead sensor or the wrong column: name another",
    ),
    "a trial that moves nothing": (
        lambda rig: (rig.seen["p"].fill(1.0), rig.sent["u"].fill(0.0)),
        r"seen.csv: column p: nothing moves in this trial, neither pressure nor command; leave the trial out",
    ),
    "pascals called kilopascals": (
        lambda rig: rig.seen["p"].__imul__(1e3),
        r"seen.csv: column p: pressure moves 1.*e\+03 times .*sent.csv: column u\); pressure looks like Pa or comm",
    ),
    "psi called kilopascals": (
        lambda rig: rig.seen["p"].__itruediv__(6.895),
        r"seen.csv: column p: pressure moves 0.145 times .*pressure looks like psi: correct `unit`",
    ),
    "a command in another unit": (
        lambda rig: rig.sent["u"].__itruediv__(100),
        r"sent.csv: column u\); (pressure looks like|command looks like) \w+: correct `unit`",
    ),
    "milliseconds called seconds": (
        lambda rig: (rig.seen["t"].__imul__(1e3), rig.sent["t"].__imul__(1e3)),
        r"seen.csv: column t: rows are 10 s apart; its stamps look like ms: write `unit: ms`",
    ),
    "microseconds called seconds": (
        lambda rig: rig.seen["t"].__imul__(1e6),
        r"seen.csv: column t: rows are 1e\+04 s apart; its stamps look like us: write `unit: us`",
    ),
    "seconds called milliseconds": (
        lambda rig: rig.says("t, unit: s", "t, unit: ms"),
        r"t: rows are 1e-05 s apart; its stamps look like s: write `unit: s`",
    ),
    "one clock in milliseconds": (
        lambda rig: (rig.seen["t"].__imul__(100), rig.sent["t"].__imul__(0.1)),
        r"sent.csv: column t: the command channel lasts .* measured .*: the stamps of one|correct its `unit`",
    ),
    "clocks that never meet": (
        lambda rig: rig.seen["t"].__iadd__(500.0),
        r"sent.csv: column t: the command channel runs from 0 to 3.99 s, measured from 500 .*; stamp both by one clock",
    ),
    "a clock set back": (
        _clock_back,
        r"seen.csv: column t: the clock is set back by 59.99 s at row 202 \(1.99 s, then -58 s\); split the recording",
    ),
    "a clock set ahead": (
        _gap_of_the_clock,
        r"seen.csv: column t: the clock jumps ahead by 1e\+06 s at row 302; split the",
    ),
    "one stamp for all": (
        lambda rig: rig.seen["t"].fill(3.0),
        r"seen.csv: column t: every row has the stamp 3 s; name the",
    ),
    "too short a record": (
        _short,
        r"seen.csv: column t: 15 rows over 0.14 s; the measured channel needs 20 rows over 0.8 s",
    ),
    "elements of plain numbers": (
        lambda rig: rig.says("kind: tracking", "kind: tracking\nelements: {a: 0}"),
        r"sent.csv: column u contains plain numbers, not lists; leave `elements` out",
    ),
    "a segment for no source": (
        lambda rig: rig.says("kind: steps,", "kind: steps, segment: a,"),
        r"stage.yaml: trial one: has a segment, but no `source` holds \{segment\}; put it there",
    ),
    "two trials of one name": (
        lambda rig: rig.says(
            "trials:", "trials:\n  - {name: one, kind: x, files: {command: sent.csv, measured: seen.csv}}"
        ),
        r"stage.yaml: two trials are called one; give one of them another `name`",
    ),
    "a number below the first column": (
        lambda rig: rig.says("source: p", "source: 0"),
        r"stage.yaml:6: channels.measured.columns.pressure.source: is 0; allowed",
    ),
    "a column beyond the last": (
        lambda rig: rig.says("source: p", "source: 3"),
        r"seen.csv: no column 3; it has 2, counted from 1; correct `source`",
    ),
}


def refusal(stage):
    """Return the error of reading a stage; warnings of numpy are errors too."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            tables.read(stage)
        except TrialError as error:
            return str(error)
    return "nothing"


@pytest.mark.parametrize("case", WRONG)
def test_a_mistake_gives_one_sentence_with_place_and_next_step(rig, case):
    change, says = WRONG[case]
    change(rig)
    stage = rig.write()
    text = refusal(stage)
    assert re.search(says, text), text
    assert len(text.splitlines()) <= 2  # the same of each of two channels at most


CART = """
name: cart
kind: driven_mass
channels:
  force: {time: {source: t, unit: s}, columns: {current: {source: i, unit: mA}}}
  measured: {time: {source: t, unit: s}, columns: {position: {source: x, unit: mm}, velocity: {source: v, unit: mm/s}}}
model: {mass_kg: 2, gain: 8}
trials: [{files: cart.csv}]
"""


def cart(folder, **changed):
    """A cart of 2 kg under 0.5 A of a motor that gives 8 N/A."""
    moved = {"t": T, "i": 500 * np.sin(3 * T), "x": -1e3 * 2 / 9 * np.sin(3 * T), "v": -1e3 * 2 / 3 * np.cos(3 * T)}
    moved |= changed
    rows = zip(*(c.tolist() for c in moved.values()), strict=True)
    (folder / "cart.csv").write_text("\n".join([",".join(moved), *(",".join(map(str, r)) for r in rows)]))
    (folder / "stage.yaml").write_text(CART)
    return folder / "stage.yaml"


def test_the_unchanged_cart_is_valid(tmp_path):
    (trial,) = tables.read(cart(tmp_path))
    assert trial.warnings == ()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "unit: mm/s",
            "unit: m/s",
            r"cart.csv: column v: velocity is 1e\+03 times .* position looks like m or velocity looks like mm/s",
        ),
        (
            "unit: mm}",
            "unit: m}",
            r"cart.csv: column v: velocity is 0.001 times .* position looks like mm or velocity looks",
        ),
        (", velocity: {source: v, unit: mm/s}", "", "nothing"),
        ("gain: 8", "gain: 0", r"stage.yaml:7: model.gain: is 0, so nothing would move"),
        (
            ", gain: 8",
            "",
            r"stage.yaml:7: model: the input is a current or a voltage: write `gain`, in N or N m per A",
        ),
        ("mass_kg", "inertia_kg_m2", r"model: the measured columns are in m or m/s: write mass_kg"),
        ("unit: mA", "unit: mV", r"current.unit: is mV, not a unit of current; allowed are units of A; correct it"),
    ],
)
def test_a_mistake_in_a_cart_is_reported(tmp_path, old, new, says):
    stage = cart(tmp_path)
    assert old in CART
    stage.write_text(CART.replace(old, new))
    assert re.search(says, refusal(stage)), refusal(stage)


def test_a_position_that_no_force_explains_is_reported(tmp_path):
    stage = cart(tmp_path)
    stage.write_text(CART.replace(", velocity: {source: v, unit: mm/s}", "").replace("unit: mm}", "unit: m}"))
    assert re.search(r"column x: position accelerates by 1\.\d+e\+03 .* allow 12", refusal(stage)), refusal(stage)


def test_a_wrapped_angle_and_a_pendulum_at_pi_are_reported(tmp_path):
    rows = "".join(f"{t:.2f},{(a + 180) % 360 - 180}\n" for t, a in zip(T, 170 + 60 * np.sin(3 * T), strict=True))
    (tmp_path / "swing.csv").write_text("t,a\n" + rows)
    (tmp_path / "stage.yaml").write_text(
        "name: joint\nkind: pendulum\nchannels:\n  measured: {time: {source: t, unit: s}, columns: {angle1: {source: a"
        ", unit: deg}}}\nmodel: {mass_kg: 1, centre_m: 0.1, inertia_kg_m2: 0}\ntrials: [{files: swing.csv}]\n"
    )
    assert re.search(
        r"swing.csv: column a: angle1 starts again after a whole turn at .*unwrap", refusal(tmp_path / "stage.yaml")
    )
    (tmp_path / "swing.csv").write_text("t,a\n" + "".join(f"{t:.2f},{180 + 20 * np.sin(3 * t)}\n" for t in T))
    (trial,) = tables.read(tmp_path / "stage.yaml")
    assert re.search(
        r"column a: the median of angle1 is 3.1\d* rad, .* hangs at 0; write `add: -3.141593`", trial.warnings[0]
    )


ODD = {
    "stamps twice": (_repeated, r"seen.csv: measured: 200 rows repeat a stamp .*; write every row once"),
    "commands that end early": (
        _long,
        r"seen.csv: column t: goes on for 3 s after the last command, .*; cut those rows",
    ),
    "a command that never changes": (
        lambda rig: rig.sent["u"].fill(50.0),
        r"sent.csv: column u: the command is 50 kPa in every row, but the measured values change; correct the column",
    ),
    "a velocity that is not there": (
        lambda rig: (
            rig.seen.update(v=np.zeros(400)),
            rig.says("kPa}}}\nmodel", "kPa}, effort: {source: v, unit: A}}}\nmodel"),
        ),
        r"seen.csv: column v: effort is 0 A in every row; leave the column out",
    ),
    "rows that are counted, or milliseconds": (
        lambda rig: (rig.seen["t"].__imul__(100), rig.sent["t"].__imul__(100)),
        r"seen.csv: column t: rows are 1 s apart; if its stamps are in ms, write `unit: ms`; if they count rows",
    ),
    "mostly missing": (
        lambda rig: (
            rig.seen["p"].__setitem__(slice(0, 300), -999),
            rig.says("trials:", "table: {missing: [-999]}\ntrials:"),
        ),
        r"seen.csv: column p has no value in 75% of the rows, which are left out",
    ),
}


@pytest.mark.parametrize("case", ODD)
def test_doubtful_data_are_read_with_a_warning(rig, case):
    change, says = ODD[case]
    change(rig)
    stage = rig.write()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (trial,) = tables.read(stage)
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
