"""Proposals of a stage file: inference from recordings, and questions."""

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.describe.proposal import Answers, Unknown, propose
from softarm.diagnosis.describe.survey import survey
from tests.diagnosis.describe.conftest import T, U, Y


def proposal(path, **answers):
    return propose(survey([path]), Answers(**answers))


def questions(path, **answers):
    with pytest.raises(Unknown) as caught:
        proposal(path, **answers)
    return [(q.option + (f" {q.prefix}" if q.prefix else ""), q.likely) for q in caught.value.questions]


def columns(found):
    return {
        channel: {name: (use.signal.label, use.unit) for name, use in own.items()}
        for channel, own in found.channels.items()
    }


def test_a_servo_with_units_in_its_headers_needs_no_answer(table):
    path = table("run.csv", "t/ms;Sollwinkel [deg];angle [deg];temp_C;torque_Nm", 1e3 * T, U, Y, 0 * T + 21, 0.1 * Y,
                 delimiter=";", decimal=",")  # fmt: skip
    found = proposal(path)
    assert found.kind == "tracking"
    assert columns(found) == {
        "command": {"command": ("Sollwinkel [deg]", "deg")},
        "measured": {"position": ("angle [deg]", "deg")},
    }
    clock = found.clocks["measured"]
    assert (clock.source, clock.unit, clock.note) == ("t/ms", "ms", "50 rows a second; unit from the header")
    assert "the first leads by 0.0" in found.notes[0]


@pytest.mark.parametrize("swapped", [False, True])
def test_the_column_that_leads_is_the_command_where_headers_say_nothing(table, swapped):
    path = table("run.csv", "t,one,two", T, *((Y, U) if swapped else (U, Y)))
    assert questions(path) == [("--kind", "tracking")]
    units = {"one": "deg", "two": "deg"}
    found = columns(proposal(path, kind="tracking", units=units))
    assert found["command"]["command"][0] == ("two" if swapped else "one")


@pytest.mark.parametrize(("factor", "unit", "rate"), [(1, "s", 50), (1e3, "ms", 50), (1e6, "us", 50)])
def test_the_unit_of_the_time_follows_from_its_step(table, factor, unit, rate):
    found = proposal(table("run.csv", "time,cmd_deg,pos_deg", factor * T, U, Y))
    assert found.clocks["command"].unit == unit
    assert found.clocks["command"].note == f"{rate} rows a second; unit from the step"
    given = proposal(table("run.csv", "time,cmd_deg,pos_deg", factor * T, U, Y), units={"time": unit})
    assert given.clocks["command"].note == f"{rate} rows a second; unit as given"


def test_gaps_and_other_time_columns_are_noted(table):
    keep = np.delete(np.arange(300), np.arange(100, 140))
    found = proposal(table("run.csv", "t,stamp,cmd_deg,pos_deg", T[keep], T[keep] + 5, U[keep], Y[keep]))
    assert found.clocks["command"].note == "50 rows a second, 1 gaps; unit from the step; or stamp"


def test_a_table_without_time_needs_its_rate(table):
    path = table("run.csv", "cmd_deg,pos_deg", U, Y)
    assert questions(path) == [("--rate", "")]
    clock = proposal(path, rate_hz=50).clocks["command"]
    assert (clock.source, clock.scale, clock.unit) == ("rows", 0.02, "s")


@pytest.mark.parametrize(
    ("head", "stamps"),
    [
        ("step", [np.arange(300)]),
        ("stamp.secs,stamp.nsecs", [np.floor(T / 2 + 0.001), np.round((T / 2 + 0.001) % 1 * 1e9)]),
    ],
)
def test_counted_rows_and_the_nanoseconds_of_split_stamps_are_no_time(table, head, stamps):
    path = table("run.csv", f"{head},cmd_deg,pos_deg", *stamps, U, Y)
    assert questions(path) == [("--rate", "")]


def test_a_second_table_without_time_needs_a_rate_although_the_first_has_one(table):
    files = [table("cmd.csv", "t,cmd_deg", T, U), table("meas.csv", "pos_deg,temp_C", Y, 0 * T + 21)]
    with pytest.raises(Unknown) as caught:
        propose(survey(files), Answers(kind="tracking", time="t"))
    assert [question.option for question in caught.value.questions] == ["--rate"]


def test_a_longer_recording_without_readings_does_not_show_which_column_leads(tmp_path):
    files = []
    for name, rows, seen in (("a1", 300, np.full(300, np.nan)), ("a2", 200, Y[:200])):
        files.append(tmp_path / f"{name}.parquet")
        parquet.write_table(pa.table({"t": T[:rows], "one": U[:rows], "two": seen}), files[-1])
    units = {"one": "deg", "two": "deg"}
    found = columns(propose(survey(files), Answers(kind="tracking", units=units)))
    assert found["command"]["command"][0] == "one"


def test_a_clock_that_falls_is_named(table):
    with pytest.raises(Unknown) as caught:
        proposal(table("run.csv", "t,cmd_deg,pos_deg", -T, U, Y))
    assert caught.value.questions[0].text == "rows a second, since t does not rise"


def test_recordings_without_motion_are_refused(table):
    with pytest.raises(
        TrialError, match="needs a command and an output that move; moving: cmd_deg, constant: pos_deg;"
    ):
        proposal(table("run.csv", "t,cmd_deg,pos_deg", T, U, 0 * T), kind="tracking")


def test_units_that_no_header_has_are_asked_for_with_a_guess(table):
    path = table("run.csv", "t,cmd_angle,angle", T, U, Y)
    assert questions(path) == [("--unit cmd_angle=", "deg"), ("--unit angle=", "deg")]
    assert columns(proposal(path, units={"*angle": "deg"}))["command"] == {"command": ("cmd_angle", "deg")}


def test_a_gain_is_asked_for_between_different_units(table):
    path = table("run.csv", "t,valve_V,Druck (mbar)", T, U / 10, 20 * Y)
    ((option, likely),) = questions(path)
    assert option == "--nominal gain="
    assert 150 < float(likely) < 220
    assert proposal(path, nominal={"gain": "200"}).model == {"gain": 200.0}


def test_a_driven_mass_is_found(table):
    path = table("run.csv", "t,force [N],x_mm,v_mm_s", T, U, 300 * np.sin(T), 300 * np.cos(T))
    assert questions(path) == [("--nominal mass_kg=", "")]
    assert columns(proposal(path, nominal={"mass_kg": "2"})) == {
        "force": {"force": ("force [N]", "N")},
        "measured": {"velocity": ("v_mm_s", "mm/s"), "position": ("x_mm", "mm")},
    }


def test_two_columns_of_one_kind_are_asked_for(table):
    path = table("run.csv", "t,force_N,x_m,y_m", T, U, np.sin(T), np.cos(T))
    assert questions(path, kind="driven_mass") == [("--measured", "x_m")]
    with pytest.raises(TrialError, match="--measured: x_m and y_m cannot both be the position; allowed is one; name"):
        proposal(path, kind="driven_mass", measured=("x_m", "y_m"))
    with pytest.raises(TrialError, match="--command: x_m and force_N cannot both be the command"):
        proposal(path, kind="tracking", command=("x_m", "force_N"), measured=("y_m",))


CHAIN = {"mass_kg": "1,1", "centre_m": "0.1,0.1", "inertia_kg_m2": "0.01,0.01", "length_m": "0.2,0.2"}


def test_a_chain_has_measured_torques_and_rates_by_their_slopes(table):
    head = "t,q1_rad,q2_rad,qd1,qd2,tau_cmd1 [Nm],tau_cmd2 [Nm],tau_meas1 [Nm],tau_meas2 [Nm]"
    one, two = np.sin(T), 0.5 * np.sin(3 * T)
    path = table("run.csv", head, T, one, two, np.cos(T), 1.5 * np.cos(3 * T), U, U, U + 1, U + 1)
    assert questions(path) == [("--angles", "")]
    assert [option for option, _ in questions(path, angles="relative")] == [f"--nominal {key}=" for key in CHAIN]
    found = proposal(path, angles="relative", nominal=CHAIN)
    assert (found.kind, found.links, found.model["mass_kg"]) == ("chain", 2, (1.0, 1.0))
    assert columns(found)["torque"] == {"torque1": ("tau_meas1 [Nm]", "Nm"), "torque2": ("tau_meas2 [Nm]", "Nm")}
    assert columns(found)["measured"] == {
        "angle1": ("q1_rad", "rad"),
        "angle2": ("q2_rad", "rad"),
        "rate1": ("qd1", "rad/s"),
        "rate2": ("qd2", "rad/s"),
    }


@pytest.mark.parametrize(
    ("angles", "torque", "name"),
    [("q1,q2", "tau2", "torque2"), ("q0,q1", "tau1", "torque2"), ("hip,knee", "tau2", "torque2"), ("q1,q2", "tau", "")],
)
def test_a_single_torque_of_a_chain_has_the_number_of_its_header(table, angles, torque, name):
    one, two = angles.split(",")
    path = table("run.csv", f"t,{one}_rad,{two}_rad,{torque} [Nm]", T, np.sin(T), 0.5 * np.sin(3 * T), U)
    found = proposal(path, kind="chain", angles="relative", nominal=CHAIN, command=(f"{torque} [Nm]",))
    assert list(found.channels["torque"]) == [name or "torque1"]
    assert any(f"{torque} [Nm] show no link" in note for note in found.notes) == (not name)


def test_both_inertias_of_a_chain_are_refused(table):
    path = table("run.csv", "t,q1_rad,q2_rad,tau1_Nm,tau2_Nm", T, np.sin(T), 0.5 * np.sin(3 * T), U, U)
    with pytest.raises(TrialError, match="inertia_joint_kg_m2: is given together with inertia_kg_m2; keep one"):
        proposal(path, kind="chain", angles="relative", nominal=CHAIN | {"inertia_joint_kg_m2": "0.1,0.1"})


def test_a_pendulum_that_hangs_at_half_a_turn_is_shifted(table):
    path = table("run.csv", "t,theta_deg", T, 180 + 20 * np.sin(5 * T) * np.exp(-0.1 * T))
    nominal = {"mass_kg": "0.2", "centre_m": "0.1", "inertia_kg_m2": "1e-4"}
    found = proposal(path, nominal=nominal)
    assert found.kind == "pendulum"
    assert found.channels["measured"]["angle1"].add == pytest.approx(-np.pi)


@pytest.mark.parametrize(
    ("answers", "says"),
    [
        ({"command": ("cmb_deg",)}, r"--command cmb_deg: no such column, .*; did you mean cmd_deg\?"),
        (
            {"measured": ("lost_deg",)},
            "--measured lost_deg: has no reading; allowed is a column with readings; name one",
        ),
        ({"units": {"pos_deg": "degs"}}, "--unit pos_deg=degs: no unit 'degs'; did you mean deg"),
        ({"units": {"x": "deg"}}, "--unit x=deg: no such column; allowed t, cmd_deg, pos_deg, lost_deg; name one"),
        ({"time": "cmd_deg"}, "--time cmd_deg: its numbers do not rise; name the column that holds the time"),
        ({"nominal": {"lag_s": "fast"}}, "--nominal lag_s=fast: is no number; allowed a number"),
        ({"nominal": {"lags": "1"}}, r"--nominal lags: unknown key; did you mean lag_s\?"),
    ],
)
def test_an_answer_that_does_not_fit_is_refused(table, answers, says):
    path = table("run.csv", "t,cmd_deg,pos_deg,lost_deg", T[:240], -U[:240], Y[:240], np.full(240, np.nan))
    with pytest.raises(TrialError, match=says):
        proposal(path, **answers)
