from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.robot.robot import Robot
from calib.verbs.plan.collision import CollisionModel

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
    assert done.lines[0].startswith(
        "Plan for 'ur3' (robot.urdf), chain base to tool0: 30 poses for"
    )
    table = json.loads((examples.folder / "plan.json").read_text(encoding="utf-8"))
    planned = next(line for line in done.lines if line.startswith("  these 30 poses"))
    assert numbers(planned)[0] == pytest.approx(1e3 * table["forecast"]["rms_m"], rel=2e-3)
    assert numbers(planned)[-1] == pytest.approx(1e3 * table["forecast"]["max_m"], rel=2e-3)
    assert "  60 poses  " in done.out
    refused = table["candidates"]["refused"]["collision"]
    assert f"{refused} in collision" in " ".join(done.out.split())
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
    request = ("--count", "12", "--validation", "3", "--seed", "1", "-o", "plan.csv")
    done = call(shop, *SMALL, *request)
    assert (done.code, done.err) == (0, "")
    assert "Written: plan.csv\n" in done.out
    fill_in(shop / "plan.csv", 14)
    fit = ("fit", "robot.urdf", "plan.csv", "--base", "base", "--tip", "tool0", *QUICK)
    done = call(shop, *fit)
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "1 of 15 rows not measured, and left out: 15."


def test_which_five_next(call, shop: Path):
    five = ("--taken", "data.csv", "--count", "5", "--validation", "0")
    done = call(shop, *SMALL, *five, "-o", "next.csv", "--json", "next.json")
    assert (done.code, done.err) == (0, "")
    table = json.loads((shop / "next.json").read_text(encoding="utf-8"))
    assert table["asked"]["taken"] == 30
    assert table["forecast"]["poses"] == 35
    assert table["before"]["poses"] == 30
    assert table["forecast"]["rms_m"] < table["at_random"]["rms_m"] < table["before"]["rms_m"]
    with (shop / "next.csv").open(encoding="utf-8", newline="") as file:
        assert [row["row"] for row in csv.DictReader(file)] == ["36", "37", "38", "39", "40"]


def test_what_stands_around_the_robot(call, shop: Path):
    (shop / "around.toml").write_text(
        "[reflector]\nnormal = [0, 0, 1]\nacceptance_deg = 60\n[tracker]\nxyz_mm = [0, 0, 9]\n"
        'noise = "20 um + 5 um/m"\n[ranges]\nelbow_joint = ["-120 deg", "120 deg"]\n'
        '[[boxes]]\nname = "table"\nsize_mm = [1200, 800, 50]\nxyz_mm = [0, 0, -45]\n'
    )
    done = call(
        shop, "plan", "robot.urdf", "--base", "base", "--tip", "tool0", "--model", "dh", "--target", "30 0 60 mm",
        "--candidates", "60", "--count", "10", "--tracker", "2500 500 600 mm", "--cell", "around.toml",
        "--clearance", "2 mm", "--margin", "10 deg", "--start", "shoulder_lift_joint=-90 deg",
        "-o", "plan.csv", "--json", "plan.json",
    )  # fmt: skip
    assert (done.code, done.err) == (0, "")
    table = json.loads((shop / "plan.json").read_text(encoding="utf-8"))
    refused = table["candidates"]["refused"]
    assert {reason for reason, n in refused.items() if n} >= {"collision", "reflector_cone", "beam"}
    # 20 um + 5 um/m at some 2.3 m, and the robot's own 20 um.
    assert 3.2e-5 < table["forecast"]["sigma"]["m"] < 4.2e-5
    plan = Measurements.read(shop / "plan.csv", kind="fixed")
    assert np.abs(np.degrees(plan.joints_for(["elbow_joint"]))).max() <= 120.0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--count", "6"), "6 poses give 18 numbers, and the model 'dh' has 21 identifiable"),
        (("--count", "500"), "500 poses and 5 validation poses were asked for"),
        (("--margin", "400 deg"), "leaves nothing of the range of 'sh"),
        (("--start", "elbow=1 deg"), "The chain has no joint 'elbow'"),
        (("--region", "none.json"), "region 'none.json' does not exist"),
        (("-o", "robot.urdf", "--force"), "robot.urdf is also an input of this command"),
    ],
)
def test_what_cannot_be_planned(call, shop: Path, words: tuple[str, ...], said: str):
    before = set(shop.iterdir())
    output = () if "-o" in words else ("-o", "plan.csv")
    done = call(shop, *SMALL, *output, *words)
    assert (done.code, done.out) == (1, "")
    assert said in done.err
    assert done.err.count("\n") == 1
    assert set(shop.iterdir()) == before
