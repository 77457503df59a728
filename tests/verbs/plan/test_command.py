"""calib plan: from options to files, and what is wrong with options."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError
from calib.instruments.camera import USUAL_LIMITS
from calib.robot.robot import Robot
from calib.verbs.plan.collision import CollisionModel
from calib.verbs.plan.command import ImageOptions, pose_of

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
    assert done.lines[0].startswith("1 of 15 rows not measured: 15.")


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


# Images


#: Written by `calib board`.
BOARD = """\
pattern = "charuco"
columns = 9
rows = 6
square_mm = 30.0
marker_mm = 22.0
dictionary = "DICT_5X5_100"
"""

LINKS = ("--camera-on", "tool0", "--board-on", "base")
PLACES = ("--camera-at", "0 60 30 mm", "--board-at", "300 150 0 mm 180 0 0 deg")
SMALL_IMAGES = ("--count", "12", "--validation", "2", "--candidates", "100", "--model", "dh")


# Words


def test_a_pose_is_a_position_and_a_rotation_vector():
    T = pose_of("10 20 30 mm 0 0 90 deg", "--board-at")
    np.testing.assert_allclose(T[:3, 3], [0.01, 0.02, 0.03])
    np.testing.assert_allclose(T[:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_array_equal(pose_of("0 0 1 m", "--camera-at")[:3, :3], np.eye(3))


def test_options_of_images():
    options = ImageOptions(
        board_at="1 2 3 mm 0 0 90 deg", distance="300 900 mm", tilt="40 deg", share=0.7
    )
    limits = options.limits()
    assert limits.distances == (0.3, 0.9)
    assert limits.tilt == pytest.approx(np.radians(40.0))
    assert limits.share == 0.7
    assert ImageOptions().limits() == USUAL_LIMITS


def test_camera_and_board_are_put_into_the_cell():
    options = ImageOptions(camera_at=["0 60 30 mm 0 0 90 deg"], board_at="1 2 3 mm 0 0 90 deg")
    cell = Cell(cameras={"": Camera(width=640, height=480)})
    placed = options.in_cell(cell)
    np.testing.assert_allclose(np.linalg.inv(placed.T_frame_base)[:3, 3], [0.0, 0.06, 0.03])
    np.testing.assert_allclose(placed.target, [1e-3, 2e-3, 3e-3])
    np.testing.assert_allclose(placed.target_rotation @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    # What was typed counts, and what was not is the file's.
    stated = replace(placed, targets={"big": np.ones(3)})
    moved = ImageOptions(board_at="9 9 9 mm").in_cell(stated)
    assert moved.target == pytest.approx([9e-3] * 3)
    assert not moved.targets
    np.testing.assert_array_equal(moved.T_frame_base, placed.T_frame_base)
    # They are a camera's.
    without = Cell()
    assert options.in_cell(without) is without


def test_each_of_several_cameras_is_put_where_its_name_says():
    cell = Cell(cameras={name: Camera(width=640, height=480) for name in ("wall", "wrist")})
    placed = ImageOptions(camera_at=["0 0 9 mm", "wrist=0 60 30 mm"]).in_cell(cell)
    np.testing.assert_allclose(np.linalg.inv(placed.frames["wrist"])[:3, 3], [0.0, 0.06, 0.03])
    assert list(placed.frames) == ["wrist"]  # that of the other is the one without a name
    np.testing.assert_allclose(np.linalg.inv(placed.T_frame_base)[:3, 3], [0.0, 0.0, 0.009])
    with pytest.raises(CalibError, match=r"--camera-at head=0 0 9 mm.*'wall', 'wrist'"):
        ImageOptions(camera_at=["head=0 0 9 mm"]).in_cell(cell)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda cell: ImageOptions(board_at="here").in_cell(cell), "--board-at"),
        (lambda cell: ImageOptions(camera_at=["here"]).in_cell(cell), "--camera-at"),
        (lambda _: ImageOptions(distance="3 mm").limits(), "--distance"),
        (lambda _: ImageOptions(tilt="40").limits(), "--tilt"),
    ],
)
def test_options_that_are_wrong(make, words):
    with pytest.raises(CalibError, match=words):
        make(Cell(cameras={"": Camera(width=640, height=480)}))


# Calls


@pytest.fixture
def images(shop: Path) -> Path:
    """A folder with a robot and the description of a board."""
    board_file = pytest.importorskip("calib.boards.board_file")
    pytest.importorskip("calib.camera.camera_file")
    path = shop / "board.toml"
    path.write_text(BOARD, encoding="utf-8")
    assert board_file.read_board(path).columns == 9
    return shop


def test_a_plan_of_images(call, images: Path):
    given = ("plan", "robot.urdf", *LINKS, "--camera", "1280x720", "--board", "board.toml", *PLACES)
    done = call(
        images, *given, *SMALL_IMAGES, "--no-collisions", "-o", "plan.csv", "--json", "plan.json"
    )
    assert (done.code, done.err) == (0, "")
    said = " ".join(done.out.split())
    assert "camera on tool0, board on base: 12 images for calibration, 2 for validation" in said
    assert "Written: plan.csv" in said
    with (images / "plan.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["image"] for row in rows] == [f"image_{k:03d}.png" for k in range(1, 15)]
    table = json.loads((images / "plan.json").read_text(encoding="utf-8"))
    assert table["asked"]["kind"] == "pixel"
    assert table["candidates"]["kept"] == 100
    # Two more beside them.
    few = (
        "--count",
        "2",
        "--validation",
        "0",
        "--candidates",
        "100",
        "--model",
        "dh",
        "--seed",
        "3",
    )
    done = call(images, *given, *few, "--no-collisions", "--taken", "plan.csv", "-o", "next.csv")
    assert (done.code, done.err) == (0, "")
    with (images / "next.csv").open(encoding="utf-8", newline="") as file:
        assert [row["image"] for row in csv.DictReader(file)] == ["image_015.png", "image_016.png"]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ((), "--board-at"),
        ((*PLACES, "--region", "cell.toml"), "--region"),
        ((*PLACES, "--distance", "20 30 mm"), "never in the image"),
    ],
)
def test_a_plan_of_images_that_cannot_be_made(call, images: Path, changed, words):
    given = ("plan", "robot.urdf", *LINKS, "--camera", "1280x720", "--board", "board.toml")
    done = call(images, *given, *changed, *SMALL_IMAGES, "--no-collisions")
    assert done.code == 1
    assert words in " ".join(done.err.split())
