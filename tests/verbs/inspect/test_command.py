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
        r"Forecast for a fit of these 30 poses with a noise of 0\.039 mm per coordinate: "
        r"position error ([\d.]+) mm rms over the joint limits \(90 % of calibrations: ([\d.]+) to ([\d.]+)\), "
        r"([\d.]+) mm at the worst place\. The best 30 poses would give about ([\d.]+) mm rms",
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
