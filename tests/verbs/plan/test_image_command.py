"""calib plan --camera: from options to tables, and what is wrong with options."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.errors import CalibError
from calib.instruments.camera import USUAL_LIMITS
from calib.verbs.plan.command import ImageOptions, pose_of

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
SMALL = ("--count", "12", "--validation", "2", "--candidates", "100", "--model", "dh")


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
    options = ImageOptions(camera_at="0 60 30 mm 0 0 90 deg", board_at="1 2 3 mm 0 0 90 deg")
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


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda cell: ImageOptions(board_at="here").in_cell(cell), "--board-at"),
        (lambda cell: ImageOptions(camera_at="here").in_cell(cell), "--camera-at"),
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
    done = call(images, *given, *SMALL, "--no-collisions", "-o", "plan.csv", "--json", "plan.json")
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
    done = call(images, *given, *changed, *SMALL, "--no-collisions")
    assert done.code == 1
    assert words in " ".join(done.err.split())
