from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.design.collision import CollisionModel
from calib.robot.robot import Robot

FREE = ("plan", "robot.urdf", "--base", "base", "--tip", "tool0", "--no-collisions")
QUICK = ("--model", "zeros", "--no-validate")
SMALL = (*FREE, "--candidates", "300", "--model", "dh", "--target", "50 70 30 mm")


def fill_in(path: Path, count: int) -> None:
    """Write what the nominal robot would give, and a little noise, into the first rows of a plan."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    rng = np.random.default_rng(0)
    for row in rows[:count]:
        for axis in "xyz":
            expected = float(row[header.index(f"expected {axis} [mm]")])
            row[header.index(f"{axis} [mm]")] = f"{expected + rng.normal(0.0, 0.04):.4f}"
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([header, *rows])


def numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"\d+\.\d+", text)]


def test_the_example_of_the_document(examples):
    done = examples.starting("calib plan robot.urdf --base base --tip tool0")
    assert (done.code, done.err) == (0, "")
    assert done.lines[0].startswith("Plan for 'ur3' (robot.urdf), chain base to tool0: 30 poses to")
    table = json.loads((examples.folder / "plan.json").read_text(encoding="utf-8"))
    planned = next(line for line in done.lines if line.startswith("  these 30 poses"))
    assert numbers(planned)[0] == pytest.approx(1e3 * table["forecast"]["rms_m"], rel=2e-3)
    assert numbers(planned)[-1] == pytest.approx(1e3 * table["forecast"]["max_m"], rel=2e-3)
    assert "  <- this plan" in done.out
    refused = table["candidates"]["refused"]["in collision"]
    assert f"were refused: {refused} in collision." in " ".join(done.out.split())
    assert "not checked for collisions" not in done.out.lower()
    with (examples.folder / "plan.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 35
    # Another check than the one that chose them: the robot's own, from the table.
    robot = Robot.load(examples.folder / "robot.urdf", "base", "tool0")
    q = np.radians([[float(row[f"{name} [deg]"]) for name in robot.joint_names] for row in rows])
    assert CollisionModel.of(robot).free(q).all()
    limits = np.array([[joint.lower, joint.upper] for joint in robot.inputs])
    assert (q >= limits[:, 0] + np.radians(4.999)).all()
    assert (q <= limits[:, 1] - np.radians(4.999)).all()


def test_from_plan_to_fit(call, shop: Path):
    done = call(
        shop, *SMALL, "--count", "15", "--validation", "3", "-o", "plan.csv", "--frame", "known"
    )
    assert (done.code, done.err) == (0, "")
    assert "Written: plan.csv\n" in done.out
    step = next(line for line in done.lines if line.startswith("  3. calib fit"))
    assert step.startswith("  3. calib fit robot.urdf plan.csv --base base --tip tool0")
    fit = ("fit", "robot.urdf", "plan.csv", "--base", "base", "--tip", "tool0", *QUICK)
    done = call(shop, *fit)
    assert (done.code, done.out) == (1, "")
    assert done.err == (
        "calib: plan.csv: nothing is measured yet; 'x [mm]', 'y [mm]', 'z [mm]' are empty in all 18 rows. Fill in "
        "what was measured at each pose, or give the instrument's list of points with --points.\n"
    )
    fill_in(shop / "plan.csv", 14)
    done = call(shop, *fit)
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "4 of 18 rows are not measured, and are left out: rows 15 to 18."
    assert "Columns not used" not in done.out
    fill_in(shop / "plan.csv", 17)
    assert call(shop, *fit).lines[0] == "1 of 18 rows is not measured, and is left out: row 18."
    fill_in(shop / "plan.csv", 18)
    assert "left out" not in call(shop, *fit).out


def test_a_plan_beside_a_tracker_s_list(call, shop: Path):
    assert call(shop, *SMALL, "--count", "12", "--validation", "0", "-o", "plan.csv").code == 0
    with (shop / "plan.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    lines = [" ".join([row["point"], *(row[f"expected {a} [mm]"] for a in "xyz")]) for row in rows]
    (shop / "list.txt").write_text("\n".join(["// Units: mm", *lines[::-1]]), encoding="utf-8")
    fit = ("fit", "robot.urdf", "plan.csv", "--points", "list.txt", "--base", "base", *QUICK)
    done = call(shop, *fit)
    assert (done.code, done.err) == (0, "")
    assert done.lines[0].startswith("calib ")
    (shop / "list.txt").write_text("\n".join(["// Units: mm", *lines[:9]]), encoding="utf-8")
    done = call(shop, *fit)
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "3 of 12 rows are not measured, and are left out: rows 10 to 12."


def test_which_five_next(call, shop: Path):
    five = ("--taken", "data.csv", "--count", "5", "--validation", "0")
    done = call(shop, *SMALL, *five, "-o", "next.csv", "--json", "next.json")
    assert (done.code, done.err) == (0, "")
    text = " ".join(done.out.split())
    assert "5 poses to calibrate with, beside 30 poses measured already" in text
    assert "Note: Of data.csv 5 validation rows do not count as taken" in text
    assert "3. Add the rows to data.csv, column for column." in text
    assert "4. calib fit robot.urdf data.csv --base base" in text
    table = json.loads((shop / "next.json").read_text(encoding="utf-8"))
    assert table["asked"]["taken"] == 30
    assert table["forecast"]["poses"] == 35
    assert table["before"]["poses"] == 30
    assert table["forecast"]["rms_m"] < table["at_random"]["rms_m"] < table["before"]["rms_m"]
    with (shop / "next.csv").open(encoding="utf-8", newline="") as file:
        assert [row["row"] for row in csv.DictReader(file)] == ["36", "37", "38", "39", "40"]


def test_the_same_seed_makes_the_same_plan(call, shop: Path):
    for name in ("one", "two"):
        assert (
            call(shop, *SMALL, "--count", "10", "--ladder", "none", "-o", f"{name}.csv").code == 0
        )
    assert (
        call(
            shop, *SMALL, "--count", "10", "--ladder", "none", "--seed", "1", "-o", "three.csv"
        ).code
        == 0
    )
    one, two, three = ((shop / f"{name}.csv").read_bytes() for name in ("one", "two", "three"))
    assert one == two
    assert one != three


def test_what_stands_around_the_robot(call, shop: Path):
    (shop / "cone.toml").write_text("[reflector]\nnormal = [1, 0, 0]\nacceptance_deg = 60\n")
    done = call(
        shop, "plan", "robot.urdf", "--base", "base", "--tip", "tool0", "--model", "dh", "--target", "30 0 60 mm",
        "--candidates", "60", "--count", "10", "--ladder", "none", "--tracker", "2500 500 600 mm",
        "--reflector", "0 0 1", "--cell", "cone.toml",
        "--box", "table: 0 0 -45 1200 800 50 mm", "--clearance", "2 mm", "--range", "elbow_joint=-120..120 deg",
        "--margin", "10 deg", "--noise", "20 um + 5 um/m", "--start", "shoulder_lift_joint=-90 deg",
        "-o", "plan.csv", "--json", "plan.json",
    )  # fmt: skip
    assert (done.code, done.err) == (0, "")
    assert max(map(len, done.lines)) <= 100
    table = json.loads((shop / "plan.json").read_text(encoding="utf-8"))
    refused = table["candidates"]["refused"]
    assert {reason for reason, count in refused.items() if count} >= {
        "in collision", "with the reflector turned away", "with something in the beam",
    }  # fmt: skip
    for reason, count in refused.items():
        assert (f"{count} {reason}" in " ".join(done.out.split())) == (count > 0)
    # 20 um + 5 um/m at some 2.3 m, and the robot's own 20 um.
    assert 3.2e-5 < table["forecast"]["sigma_m"] < 4.2e-5
    plan = Measurements.read(shop / "plan.csv", kind="fixed")
    elbow = np.degrees(plan.joints_for(["elbow_joint"]))
    assert np.abs(elbow).max() <= 120.0


def test_expected_values_in_a_frame_that_is_not_measured_in(call, shop: Path):
    done = call(shop, *SMALL, "--count", "10", "--ladder", "none", "--frame", "estimate")
    assert "Note: The columns 'expected ...' are in the frame of 'base', for where" in done.out
    assert "expected ..." not in call(shop, *SMALL, "--count", "10", "--ladder", "none").out


def test_a_joint_that_slides_and_one_that_is_held(call, shop: Path):
    done = call(
        shop, "plan", "tiago", "--tip", "arm_7_link", "--no-collisions", "--candidates", "60", "--model", "zeros",
        "--ladder", "none", "-o", "plan.csv",
    )  # fmt: skip
    assert (done.code, done.err) == (0, "")
    assert "deg in all" not in done.out
    header = (shop / "plan.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "torso_lift_joint [mm]" in header
    held = ("--hold", "torso_lift_joint=0.3 m")
    done = call(
        shop, "plan", "tiago", "--tip", "arm_7_link", "--no-collisions", "--candidates", "60", "--model", "zeros",
        "--ladder", "none", *held, "-o", "held.csv",
    )  # fmt: skip
    assert "--hold 'torso_lift_joint=0.3 m'" in done.out
    assert "torso" not in (shop / "held.csv").read_text(encoding="utf-8").splitlines()[0]


BOX = ("--box", "shell: 0 0 200 3000 3000 3000 mm")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--count", "6"), "6 poses give 18 numbers, and the model 'dh' has 21 parameters that can be told apart: at"),
        (("--count", "500"), "500 poses and 5 validation poses were asked for, but only 300 candidates"),
        (("--ladder", "3,30"), "A forecast for 3 poses was asked for; it takes at least 7"),
        (("--ladder", "a"), '--ladder was given as "a"; it must be numbers of poses'),
        (("--margin", "400 deg"), "The margin of 400 deg to the URDF's limits leaves nothing of the range of 'sh"),
        (("--clearance", "0.3 m"), '--clearance was given as "0.3 m"; it must be 100 mm or less'),
        (("--range", "elbow=0..1 deg"), "A range is given for the joint 'elbow', which does not move the chain"),
        (("--start", "elbow=1 deg"), "The chain has no joint 'elbow'"),
        (("--columns", "a=b"), "name it with --taken."),
        (("--taken", "cell.toml"), "cell.toml: no column for the joints"),
        (("--region", "none.json"), "region 'none.json' does not exist"),
        (("--collisions", "--holder", "0 mm"), "The holder's radius is 0.0 m; it must be a number above 0."),
        (("--tracker", "200 0 0 m"), "None of 40960 poses drawn can be measured: 40960 out of the tracker's range."),
        (("-o", "robot.urdf", "--force"), "robot.urdf is also an input of this command"),
        (("--collisions", *BOX), "The box 'shell' swallows the robot"),
        (("--collisions", "--tracker", "2500 0 500 mm", "--box", "stand: 2500 0 250 400 400 600 mm"),
         "The tracker, at (2500, 0, 500) mm of the base, stands inside the box 'stand'"),
    ],
)  # fmt: skip
def test_what_cannot_be_planned(call, shop: Path, words: tuple[str, ...], said: str):
    before = set(shop.iterdir())
    done = call(shop, *SMALL, "-o", "plan.csv", *words)
    assert (done.code, done.out) == (1, "")
    assert done.err.startswith("calib: ")
    assert said in done.err
    assert done.err.count("\n") == 1
    assert set(shop.iterdir()) == before
