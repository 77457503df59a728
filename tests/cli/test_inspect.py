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


def test_the_poses_of_a_table_are_judged_against_the_best(examples):
    done = examples.starting("calib inspect robot.urdf data.csv")
    text = " ".join(done.out.split())
    found = re.search(
        r"Forecast for a fit of these 30 poses, with the model 'placement' and a noise of 0\.039 mm a coordinate: "
        r"position error ([\d.]+) mm rms over the joint limits \(90 % of calibrations: ([\d.]+) to ([\d.]+)\), "
        r"([\d.]+) mm where it is worst\. The best 30 poses would give about ([\d.]+) mm rms",
        text,
    )
    assert found, text
    rms, low, high, worst, best = map(float, found.groups())
    assert low < rms < high < worst
    assert best < 0.25 * rms  # the paper's poses stand in a corner of the workspace


def test_no_forecast_where_the_poses_are_not_free(call, shop):
    lines = (shop / "data.csv").read_text(encoding="utf-8").splitlines()
    (shop / "socket.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    done = call(shop, "inspect", "robot.urdf", "socket.csv", "--kind", "fixed")
    assert (done.code, done.err) == (0, "")
    assert "Forecast" not in done.out


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


def test_a_base_that_moves(call, shop):
    done = call(shop, "inspect", "robot.urdf", "--base", "tool0", "--tip", "base")
    assert (done.code, done.err) == (0, "")
    joints = [line.split()[0] for line in done.lines[2:8]]
    assert (joints[0], joints[-1]) == ("wrist_3_joint", "shoulder_pan_joint")
    assert "Joints move the base 'tool0' itself; they are passed from the base" in done.out


def test_a_joint_that_is_held(examples):
    done = examples.starting("calib inspect tiago")
    assert (done.code, done.err) == (0, "")
    assert "\n  'torso_lift_joint' is held at 300 mm.\n" in done.out


def test_a_joint_that_follows_another(call, shop):
    text = (shop / "robot.urdf").read_text(encoding="utf-8")
    start = text.index("</joint>", text.index('name="wrist_3_joint"'))
    mimic = '<mimic joint="wrist_2_joint" multiplier="-2" offset="0.1"/>'
    (shop / "mimic.urdf").write_text(text[:start] + mimic + text[start:], encoding="utf-8")
    done = call(shop, "inspect", "mimic.urdf", "data.csv", "--base", "base", "--tip", "tool0")
    assert (done.code, done.err) == (0, "")
    # Its column is not needed, and nothing is wrong with the chain.
    assert done.lines[0] == "Columns not used: 'wrist_3_joint [deg]'."
    assert "\n  'wrist_3_joint' follows 'wrist_2_joint', times -2, plus 5.72958 deg.\n" in done.out


def test_a_cell_file_and_what_is_frozen(call, shop):
    done = call(shop, "inspect", "robot.urdf", "--cell", "cell.toml")
    assert done.code == 0
    assert "Parameters of the model 'dh' (26" in done.out
    assert " d2" not in done.out.split("Parameters")[1]


def test_errors_are_one_line(call, shop):
    calls = {
        ("robot.urdf", "--base", "foot"): "robot.urdf has no link 'foot'. Its links: ",
        (
            "robot.urdf",
            "--model",
            "best",
        ): "--model: there is no model 'best'. It is 'auto', or one of ",
        (
            "robot.urdf",
            "--hold",
            "elbow=1 deg",
        ): "the joint 'elbow', to be held at 0.0174533, does not",
        ("robot.urdf", "--payload", "5"): 'was given as "5"; it must be a mass in kg or g',
        ("robot.urdf", "data.csv", "--points-unit", "mm"): "name the list with --points.",
        ("cell.toml",): "cell.toml is not XML",
        ("robot.urdf", "cell.toml", "--base", "base"): "cell.toml: no column for the joints ",
    }
    for words, said in calls.items():
        done = call(shop, "inspect", *words)
        assert (done.code, done.out) == (1, "")
        assert done.err.startswith("calib: ")
        assert said in done.err
        assert done.err.count("\n") == 1
