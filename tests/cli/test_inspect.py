from __future__ import annotations

import re


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
        r"Forecast for a fit of these 30 poses with a noise of 0\.039 mm a coordinate: "
        r"position error ([\d.]+) mm rms over the joint limits \(90 % of calibrations: ([\d.]+) to ([\d.]+)\), "
        r"([\d.]+) mm where it is worst\. The best 30 poses would give about ([\d.]+) mm rms",
        text,
    )
    assert found, text
    rms, low, high, worst, best = map(float, found.groups())
    assert low < rms < high < worst
    assert best < 0.25 * rms  # the paper's poses stand in a corner of the workspace


def test_without_a_table_and_by_name(examples):
    done = examples.starting("calib inspect ur3")
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "Robot 'ur3' (ur3_robot.urdf), chain base to tool0:"
    assert "Identifiable from 200 poses spread over the joint limits, target 50, 70, 30" in done.out
    assert "Parameters of the model 'hayati' (" in done.out


def test_a_base_that_moves(call, shop):
    done = call(shop, "inspect", "robot.urdf", "--base", "tool0", "--tip", "base")
    assert (done.code, done.err) == (0, "")
    joints = [line.split()[0] for line in done.lines[2:8]]
    assert (joints[0], joints[-1]) == ("wrist_3_joint", "shoulder_pan_joint")
    assert "Joints move the base 'tool0' itself; they are passed from the base" in done.out


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
