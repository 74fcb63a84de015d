"""Diagnoses of rigs in the units of their tables."""

import numpy as np
import pytest

from softarm.diagnosis.data.trials import TableStage, TableUnit
from softarm.diagnosis.diagnose import diagnose_files
from softarm.diagnosis.rigs.owner_units import owners
from tests.diagnosis.rigs.recordings import SERVO

T = np.arange(0, 8, 0.02)


def rig(folder):
    """Write the tables of a servo with an offset of 0.05 rad and an encoder, in degrees and milliseconds."""
    draw = np.random.default_rng(4)
    shapes = {"steps": np.sign(np.sin(0.9 * T)), "sine": np.sin(2 * T), "slow": np.sin(0.5 * T)}
    for i, (name, shape) in enumerate(shapes.items()):
        command = 0.4 * shape + 0.1 * i
        position = np.concatenate(([command[0]], command[:-1])) + 0.05
        position = np.round((position + 3e-4 * draw.normal(size=len(T))) / 1e-3) * 1e-3
        rows = zip(1e3 * T, np.degrees(command), np.degrees(position), strict=True)
        (folder / f"{name}.csv").write_text("t,u,y\n" + "\n".join(",".join(f"{x:.9g}" for x in r) for r in rows) + "\n")
    (folder / "servo.yaml").write_text(SERVO.replace("unit: s", "unit: ms"))
    return folder / "servo.yaml"


@pytest.mark.prove
def test_a_servo_in_degrees_is_diagnosed_in_degrees(tmp_path):
    deg = diagnose_files([rig(tmp_path)])
    assert deg.verdict.verdict == "named"
    (effect,) = deg.verdict.effects
    assert {effect.name, *effect.equivalents} == {"servo.sensor_bias", "servo.gain"}  # only the sum shows
    offset = effect.parameters["bias"]
    assert offset.unit == "deg"
    truth = np.degrees(0.05)
    assert offset.low <= truth <= offset.high
    assert offset.value == pytest.approx(truth, rel=0.01)
    gap = deg.verdict.gap
    assert {q["servo"].unit for q in (gap.before, gap.after, gap.floor, gap.ceiling)} == {"deg"}
    assert gap.before["servo"].value == pytest.approx(truth, rel=0.3)  # and the resolution
    assert {o.unit for o in deg.overlays} == {r.unit for r in deg.regimes} == {"deg"}
    assert np.nanmax(deg.overlays[0].measured) > 20
    assert deg.units["servo.rate_limit.rate"] == "deg/s"
    assert deg.units["servo.lag.rise"] == "s"
    assert "servo.gain" in {rival.name for rival in deg.rivals}


def stage(kind, **columns):
    return TableStage("x", kind, {}, columns)


def test_rates_are_converted_too():
    volt, mbar = TableUnit("V", 1, "V"), TableUnit("mbar", 0.1, "kPa")
    known = owners(stage("tracking", command={"command": volt}, measured={"pressure": mbar}))
    assert known["kPa"] == ("mbar", 10)
    assert known["kPa/s^2"] == ("mbar/s^2", 10)
    assert known["V/s"] == ("V/s", 1)
    assert "m" not in known


def test_the_compared_column_determines_the_unit():
    rad, deg = TableUnit("rad", 1, "rad"), TableUnit("deg", 0.0175, "rad")
    two = stage("tracking", command={"command": rad}, measured={"position": deg})
    assert owners(two)["rad"][0] == "deg"
    velocity = stage("tracking", measured={"velocity": TableUnit("mm/s", 1e-3, "m/s")})
    assert [owners(velocity)[unit][0] for unit in ("m/s", "m/s^2", "m/s^3")] == ["mm/s", "mm/s^2", "mm/s^3"]
    turning = stage("driven_mass", measured={"velocity": TableUnit("rpm", 0.1047, "rad/s")})
    assert [owners(turning)[unit][0] for unit in ("rad/s", "rad/s^2")] == ["rpm", "rpm/s"]
    assert "rad" not in owners(turning)


def test_a_share_keeps_its_unit():
    percent, mm = TableUnit("%", 0.01, "-"), TableUnit("mm", 1e-3, "m")
    known = owners(stage("tracking", command={"command": percent}, measured={"position": mm}))
    assert known.keys() == {"m", "m/s", "m/s^2", "m/s^3"}
