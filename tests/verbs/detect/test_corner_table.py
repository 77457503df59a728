"""The table of corners: what a reader of its own finds in it."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import pytest

from calib.boards.detection.detect import Detection
from calib.boards.detection.picture import ImageFile
from calib.errors import MeasurementError
from calib.verbs.detect.corner_table import corner_table, with_cameras, with_rows_only
from calib.verbs.detect.matching import JointTable, Matches, match, read_joint_table
from tests.boards.board_views import CHARUCO_BOARD, TAG_BOARD
from tests.boards.detections import detection, picture, view

BOARD = CHARUCO_BOARD


def joints_of(folder: Path, text: str, **columns: str) -> JointTable:
    path = folder / "joints.csv"
    path.write_text(text, encoding="utf-8")
    return read_joint_table(path, columns)


def table(found: Detection, joints: JointTable) -> list[dict[str, str]]:
    matches = match(joints, [entry.file for entry in found.pictures])
    text = corner_table(with_rows_only(found, matches), joints, matches).decode()
    return list(csv.DictReader(io.StringIO(text)))


def test_a_row_a_corner_with_the_joints_as_written(tmp_path: Path):
    joints = joints_of(tmp_path, "set,image,J1,mass [kg]\nestimate,1.png,010.50,3\n", J1="j1 [deg]")
    rows = table(detection(picture("1.png", view())), joints)
    assert list(rows[0].items()) == [
        ("set", "estimate"),
        ("j1 [deg]", "010.50"),
        ("mass [kg]", "3"),
        ("image", "1.png"),
        ("corner", "3"),
        ("board_x [m]", "0.12"),
        ("board_y [m]", "0.03"),
        ("board_z [m]", "0.0"),
        ("u [px]", "10.25"),
        ("v [px]", "20.5"),
        ("sigma_image [px]", "0.02"),
        ("kind", "pixel"),
    ]
    assert (rows[1]["u [px]"], rows[1]["v [px]"]) == ("300.1235", "-0.25")
    assert len(rows) == 2


def test_poses_whose_picture_is_not_used_have_a_row_without_a_corner(tmp_path: Path):
    joints = joints_of(tmp_path, "image,j1 [deg]\n2.png,2\n1.png,1\n,3\n")
    found = detection(
        picture("1.png", view()), picture("2.png", view(reason="cut")), picture("3.png", view())
    )
    rows = table(found, joints)
    assert [row["image"] for row in rows] == ["2.png", "1.png", "1.png", ""]
    assert [row["j1 [deg]"] for row in rows] == ["2", "1", "1", "3"]
    for row in (rows[0], rows[3]):
        assert row["kind"] == "pixel"
        assert not any(row[name] for name in ("corner", "u [px]", "v [px]", "sigma_image [px]"))
    matches = Matches((0, 1, None), ("", "", ""), ())
    assert [entry.reason for entry in with_rows_only(found, matches).pictures] == ["", "", "no_row"]


def test_targets_are_boards_places_or_both(tmp_path: Path):
    joints = joints_of(tmp_path, "part,image,j1 [deg]\na,1.png,1\n", part="target")
    rows = table(detection(picture("1.png", view())), joints)
    assert {row["target"] for row in rows} == {"a"}
    both = picture("1.png", view(), view("tags"))
    boards = [BOARD, replace(TAG_BOARD, name="tags")]
    rows = table(detection(both, boards=boards), joints)
    assert [row["target"] for row in rows] == ["board/a", "board/a", "tags/a", "tags/a"]
    plain = joints_of(tmp_path, "image,j1 [deg]\n1.png,1\n")
    rows = table(detection(both, boards=boards), plain)
    assert [row["target"] for row in rows] == ["board", "board", "tags", "tags"]


def test_cameras_are_groups(tmp_path: Path):
    joints = joints_of(tmp_path, "camera,image,j1 [deg]\nwide,1.png,1\n,2.png,1\n")
    files = [ImageFile(Path(name), name) for name in ("1.png", "2.png")]
    named = with_cameras(files, match(joints, files))
    assert [file.camera for file in named] == ["wide", ""]
    found = detection(picture("1.png", view(), camera="wide"), picture("2.png", view(reason="cut")))
    assert [row["group"] for row in table(found, joints)] == ["wide", "wide", ""]
    found = detection(picture("1.png", view(), camera="wide"), picture("2.png", view()))
    with pytest.raises(MeasurementError, match=r"camera of the picture .2\.png."):
        table(found, joints)
