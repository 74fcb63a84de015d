"""Headers of columns: unit, role and quantity."""

import pytest

from softarm.diagnosis.describe import headers


@pytest.mark.parametrize(
    ("text", "unit", "role", "quantity"),
    [
        ("angle [deg]", "deg", "", "rad"),
        ("torque_Nm", "Nm", "", "N m"),
        ("t/ms", "ms", "time", "s"),
        ("Druck (mbar)", "mbar", "", "kPa"),
        ("v/(m/s)", "m/s", "", "m/s"),
        ("Winkel in Grad", "deg", "", "rad"),
        ("pos_meas1", None, "measured", "m"),
        ("Sollwinkel [\N{DEGREE SIGN}]", "deg", "command", "rad"),
        ("Istdruck", None, "measured", "kPa"),
        ("rate_rad_s", "rad/s", "", "rad/s"),
        ("vel_m_s", "m/s", "", "m/s"),
        ("duty [%]", "%", "command", "-"),
        ("share [1]", "1", "", "-"),
        ("/commands/data[1]", None, "command", ""),  # an element of a list
        ("qvel.hip", None, "", "rad/s"),
        ("angleDeg", "deg", "", "rad"),
        ("timestamp", None, "time", ""),
        ("u", None, "command", ""),
        ("/joint_states/pan/position", None, "", "rad"),
        ("/joint_states/pan/effort", None, "", "N m"),
        ("joint_velocity", None, "", "rad/s"),
        ("joint1", None, "", "rad"),
        ("p_in", None, "", ""),  # an inlet, not inches
        ("temp_C", None, "", ""),
        ("kg_total", None, "", ""),
        ("", None, "", ""),
    ],
)
def test_a_header_suggests_unit_role_and_quantity(text, unit, role, quantity):
    found = headers.read(text)
    assert (found.unit, found.role, found.quantity) == (unit, role, quantity)
