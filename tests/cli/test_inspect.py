from __future__ import annotations

import re

LONG = "the_joint_with_quite_a_long_name_of_the_left_arm_of_the_second_robot_of_the_cell_"


def test_chain_dh_rows_and_parameters(examples):
    done = examples.starting("calib inspect robot.urdf data.csv")
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "Robot 'ur3' (robot.urdf), chain base to tool0:"
    assert re.search(r"\n  elbow_joint +revolute +0 1 0 +-180\.0 to 180\.0 deg\n", done.out)
    assert re.search(r"\n  shoulder_lift_joint +-243\.6500 +0\.0000 +0\.0000 +0\.0000 ", done.out)
    assert "Parameters of the model 'dh' (27, * known in combination with others only):" in done.out
    assert "\nIdentifiable from the 30 estimation rows of data.csv: rank 21 of 27, " in done.out
    assert "\n  a6 and target_x together (+1 mm, -1 mm)\n" in done.out
    assert not re.search(r"^ *\*", done.out, re.MULTILINE)  # a star stays with its name


def test_without_a_table_and_by_name(examples):
    done = examples.starting("calib inspect ur3")
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "Robot 'ur3' (ur3_robot.urdf), chain base to tool0:"
    assert "Identifiable from 200 poses spread over the joint limits, target 50, 70, 30" in done.out
    assert "Parameters of the model 'hayati' (" in done.out


def test_long_names_and_sliding_joints(call, shop):
    text = (shop / "robot.urdf").read_text(encoding="utf-8")
    text = text.replace('"elbow_joint"', f'"{LONG}"')
    (shop / "long.urdf").write_text(text, encoding="utf-8")
    for words in (("long.urdf", "--model", "placement", "--frame", "estimate"), ("panda",)):
        done = call(shop, "inspect", *words)
        assert (done.code, done.err) == (0, "")
        assert max(map(len, done.lines)) <= 100
    assert re.search(r"\n  panda_finger_joint1 +prismatic +0 1 0 +0\.0 to 40\.0 mm\n", done.out)


def test_a_cell_file_and_what_is_frozen(call, shop):
    done = call(shop, "inspect", "robot.urdf", "--cell", "cell.toml")
    assert done.code == 0
    assert "Parameters of the model 'dh' (26" in done.out
    assert " d2" not in done.out.split("Parameters")[1]


def test_errors_are_one_line(call, shop):
    calls = {
        ("robot.urdf", "--base", "foot"): "robot.urdf has no link 'foot'. Its links: ",
        ("robot.urdf", "--base", "tool0", "--tip", "base"): "on the base's side",
        ("cell.toml",): "cell.toml is not XML",
        ("robot.urdf", "cell.toml", "--base", "base"): "cell.toml: no column for the joints ",
    }
    for words, said in calls.items():
        done = call(shop, "inspect", *words)
        assert (done.code, done.out) == (1, "")
        assert done.err.startswith("calib: ")
        assert said in done.err
        assert done.err.count("\n") == 1
