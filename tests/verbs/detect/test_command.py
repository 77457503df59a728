"""``calib detect``: files, matches, refusals."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.data.measurements import Measurements
from tests.boards.board_views import CHARUCO_BOARD, View, render

BOARD = """name = "wall"
pattern = "charuco"
columns = {columns}
rows = {rows}
square_mm = 30
marker_mm = 22
dictionary = "DICT_5X5_100"
"""

VIEWS = {"p_1.png": View(tilt=(10, 5, 20)), "p_2.png": View(tilt=(-20, 30, 100))}

WORDS = ("--board", "board.toml", "--joints", "joints.csv", "-o", "corners.csv", "--workers", "1")


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Two pictures of a board and one without, the board's description, and joint values."""
    folder = tmp_path / "images"
    folder.mkdir()
    for name, view in VIEWS.items():
        picture = cv2.imencode(".png", render(CHARUCO_BOARD, view))[1]
        (folder / name).write_bytes(picture.tobytes())
    empty = np.full((480, 640), 90, np.uint8)
    (folder / "p_3.png").write_bytes(cv2.imencode(".png", empty)[1].tobytes())
    (tmp_path / "board.toml").write_text(BOARD.format(columns=7, rows=5), encoding="utf-8")
    rows = [
        "part,image,no,j1 [deg],set",
        "a,p_2,2,20.0,estimate",
        "b,p_3,3,30.0,validate",
        "b,p_1,1,10.0,validate",
    ]
    (tmp_path / "joints.csv").write_text("\n".join([*rows, ""]), encoding="utf-8")
    return tmp_path


def corners(folder: Path) -> list[dict[str, str]]:
    with (folder / "corners.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_corners_beside_the_joints_of_their_picture(call, bench: Path):
    done = call(bench, "detect", "images", *WORDS, "--columns", "part=target")
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "48 corners in 2 of 3 pictures."
    assert (
        "- p_3.png: hardly any contrast: no light, a cap on the lens, or nothing but a wall."
        in done.lines
    )
    assert done.lines[-2:] == ["Written: corners.csv", "Written: corners.html"]
    rows = corners(bench)
    names = ("image", "j1 [deg]", "target", "set")
    # In the order of the joints; the pose without a board stays, since the next one is approached from it.
    assert list(dict.fromkeys(tuple(row[name] for name in names) for row in rows)) == [
        ("p_2.png", "20.0", "a", "estimate"),
        ("p_3", "30.0", "", "validate"),
        ("p_1.png", "10.0", "b", "validate"),
    ]
    m = Measurements.read(bench / "corners.csv")
    assert (len(m), m.unmeasured) == (48, (25,))
    np.testing.assert_allclose(m.moves[:24], 0.0)
    np.testing.assert_allclose(m.moves[24:], np.deg2rad(10.0 - 30.0))
    for name, view in VIEWS.items():
        own = [row for row in rows if row["image"] == name]
        assert [int(row["corner"]) for row in own] == list(range(24))
        pixels = np.array([[float(row["u [px]"]), float(row["v [px]"])] for row in own])
        assert np.abs(pixels - view.corners(CHARUCO_BOARD)).max() < 0.15
        places = [[float(row[f"board_{axis} [m]"]) for axis in "xyz"] for row in own]
        np.testing.assert_allclose(places, CHARUCO_BOARD.corners, atol=1e-9)
    assert (bench / "corners.html").read_text(encoding="utf-8").count("<figure id") == 3


def test_by_number_and_without_a_sheet(call, bench: Path):
    done = call(bench, "detect", "images/*.png", *WORDS, "--index", "no", "--no-sheet", "--quiet")
    assert (done.code, done.out, done.err) == (0, "", "")
    # The table's own column 'image' is not the pictures' here, and it does not come twice.
    assert list(corners(bench)[0]).count("image") == 1
    assert (bench / "corners.csv").read_text(encoding="utf-8").splitlines()[0].count("image") == 2
    assert {(row["image"], row["j1 [deg]"]) for row in corners(bench) if row["corner"]} == {
        ("p_1.png", "10.0"),
        ("p_2.png", "20.0"),
    }
    assert not (bench / "corners.html").exists()


def test_a_camera_of_a_folder(call, bench: Path):
    done = call(bench, "detect", "images", *WORDS, "--camera-name", "wide=images")
    assert done.code == 0
    assert {row["group"] for row in corners(bench) if row["corner"]} == {"wide"}


def test_a_wrong_description_writes_the_sheet_and_no_table(call, bench: Path):
    (bench / "board.toml").write_text(BOARD.format(columns=5, rows=7), encoding="utf-8")
    done = call(bench, "detect", "images", *WORDS)
    assert done.code == 1
    assert "columns and rows are swapped: the print has 7 columns and 5 rows" in " ".join(
        done.err.split()
    )
    assert (bench / "corners.html").is_file()
    assert not (bench / "corners.csv").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--sheet", "a.html", "--no-sheet"), "leave one out"),
        (("--sheet", "a.png"), ".html"),
        (("--camera-name", "=images"), "--camera-name was given '=images'"),
        (("--camera-name", "wide=elsewhere"), "camera 'wide'"),
        (("--index", "set"), "'estimate' is not the number of a picture"),
        (("--columns", "kuka"), "name the brand to calib calibrate"),
        (("--board", "board.toml"), "Two boards have the name 'wall'"),
        (("--sheet", "joints.html", "--columns", "image=-"), "no column 'image'"),
    ],
)
def test_refusals_before_any_work(call, bench: Path, words: tuple[str, ...], message: str):
    before = sorted(bench.iterdir())
    done = call(bench, "detect", "images", *WORDS, *words)
    assert done.code == 1
    assert message in done.err
    assert sorted(bench.iterdir()) == before


@pytest.mark.parametrize("option", ["--joints", "--board", "--output"])
def test_what_is_needed_is_said(call, bench: Path, option: str):
    words = list(WORDS)
    k = words.index("-o" if option == "--output" else option)
    done = call(bench, "detect", "images", *words[:k], *words[k + 2 :])
    assert done.code == 2
    assert f"Missing option '{option}'" in done.err or f"'{option}'" in done.err
    assert "MISSING" not in call(bench, "detect", "--help").out


def test_a_file_that_exists_is_kept(call, bench: Path):
    (bench / "corners.html").write_text("mine", encoding="utf-8")
    done = call(bench, "detect", "images", *WORDS)
    assert done.code == 1
    assert "corners.html" in done.err
    assert call(bench, "detect", "images", *WORDS, "--force").code == 0


@pytest.mark.slow
def test_processes_find_the_same(run, bench: Path):
    assert run(bench, "detect", "images", *WORDS).code == 0
    alone = (bench / "corners.csv").read_bytes()
    assert run(bench, "detect", "images", *WORDS[:-1], "2", "--force").code == 0
    assert (bench / "corners.csv").read_bytes() == alone
