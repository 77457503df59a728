"""calib plan --camera: from options to tables, and what is wrong with options."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from calib.errors import CalibError
from calib.verbs.plan.image_command import ImageOptions, pose_of

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
    np.testing.assert_array_equal(pose_of("0 0 1 m", "--pointer")[:3, :3], np.eye(3))


def test_options_of_images():
    options = ImageOptions(
        board_at="1 2 3 mm 0 0 0 deg", distance="300 900 mm", tilt="40 deg", share=0.7
    )
    request = options.request()
    assert request.distances == (0.3, 0.9)
    assert request.tilt == pytest.approx(np.radians(40.0))
    assert request.share == 0.7
    np.testing.assert_array_equal(request.T_link_camera, np.eye(4))
    assert ImageOptions(board_at="1 2 3 mm").request().distances is None


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ImageOptions().request(), "--board-at"),
        (lambda: ImageOptions(board_at="here").request(), "--board-at"),
        (lambda: ImageOptions(board_at="0 0 1 mm", distance="3 mm").request(), "--distance"),
        (lambda: ImageOptions(board_at="0 0 1 mm", tilt="40").request(), "--tilt"),
    ],
)
def test_options_that_are_missing_or_wrong(make, words):
    with pytest.raises(CalibError, match=words):
        make()


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
