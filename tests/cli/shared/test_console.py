"""Tables of the terminal show every cell whole."""

from softarm.cli.shared.console import print_table


def test_a_narrow_table_folds_long_names_instead_of_cutting_them(capsys):
    name = "shoulder.coulomb_friction.torque"
    print_table(("parameter", "interval"), [(name, "0.0448 N m (0.0426 to 0.0471)")], width=40)
    rows = [line.split("│")[1].strip() for line in capsys.readouterr().out.splitlines() if line.startswith("│")]
    assert "".join(rows) == name


def test_a_column_without_a_value_is_left_out(capsys):
    print_table(("stage", "after", "floor"), [("rail", "-", "2 mm"), ("arm", "-", "-")])
    shown = capsys.readouterr().out
    assert "after" not in shown
    assert "floor" in shown
