"""Rows belong to pictures by name or number, whatever the order, or the mistake is named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from calib.boards.detection.picture import ImageFile
from calib.errors import MeasurementError
from calib.verbs.detect.matching import JointTable, match, read_joint_table


def images(*names: str, camera: str = "") -> list[ImageFile]:
    return [ImageFile(Path(name), Path(name).name, camera) for name in names]


def table(
    folder: Path, header: str, rows: Sequence[str], index: str | None = None, **columns: str
) -> JointTable:
    path = folder / "joints.csv"
    path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    return read_joint_table(path, columns, index)


def test_by_name_in_any_order(tmp_path: Path):
    joints = table(tmp_path, "image,j1 [deg]", ["c.png,3", "A,1", "run/b.jpg,2", "z.png,9"])
    matches = match(joints, images("a.png", "run/b.png", "c.png", "d.png"))
    assert matches.rows == (1, 2, 0, None)
    assert matches.unmatched == (3,)


@pytest.mark.parametrize("index", [None, "image"])
def test_rows_without_a_name_are_poses_to_drive_by(tmp_path: Path, index: str | None):
    joints = table(tmp_path, "image,j1 [deg]", [",5", "2,1", ",7", "3,9"], index)
    matches = match(joints, images("2.png"))
    assert matches.rows == (1,)
    assert matches.unmatched == (3,)  # a name whose picture is missing


def test_a_folder_in_the_table_counts(tmp_path: Path):
    joints = table(tmp_path, "image,j1 [deg]", ["left/1.png,1", "right\\1.png,2"])
    assert match(joints, images("x/right/1.png", "x/left/1.png")).rows == (1, 0)
    assert match(joints, images("x/right/1.png", "x/middle/1.png")).rows == (1, None)


def test_a_dot_in_a_name_is_no_ending(tmp_path: Path):
    joints = table(tmp_path, "image,j1 [deg]", ["run.test,1", "run.two.JPEG,2"])
    assert match(joints, images("run.two.png", "run.test.png")).rows == (1, 0)


def test_of_two_endings_the_written(tmp_path: Path):
    joints = table(tmp_path, "image,j1 [deg]", ["1.png,1", "1.jpg,2"])
    assert match(joints, images("1.jpg", "1.png")).rows == (1, 0)


def test_by_number(tmp_path: Path):
    joints = table(tmp_path, "number,j1 [deg]", ["10,1", "002,2"], index="number")
    assert match(joints, images("cam0_2.png", "pose_0010.png", "x.png")).rows == (1, 0, None)
    assert [column.name for column in joints.kept] == ["number", "j1"]


def test_a_number_that_is_none(tmp_path: Path):
    with pytest.raises(MeasurementError, match=r"line 3 .*'2.5'"):
        table(tmp_path, "number,j1 [deg]", ["1,1", "2.5,2"], index="number")
    with pytest.raises(MeasurementError, match=r"no column 'nummer'.*'number'"):
        table(tmp_path, "number,j1 [deg]", ["1,1"], index="nummer")


def test_one_row_for_the_pictures_of_two_cameras(tmp_path: Path):
    joints = table(tmp_path, "image,j1 [deg]", ["1.png,1"])
    both = [*images("l/1.png", camera="left"), *images("r/1.png", camera="right")]
    matches = match(joints, both)
    assert matches.rows == (0, 0)
    assert matches.cameras == ("left", "right")
    with pytest.raises(MeasurementError, match="line 2: the row belongs to two pictures"):
        match(joints, images("l/1.png", "r/1.png"))


def test_the_row_names_the_camera(tmp_path: Path):
    joints = table(tmp_path, "camera,image,j1 [deg]", ["left,1.png,1", "right,1.png,2"])
    both = [*images("r/1.png", camera="right"), *images("l/1.png", camera="left")]
    assert match(joints, both).rows == (1, 0)
    joints = table(tmp_path, "camera,image,j1 [deg]", ["left,1.png,1", "right,2.png,2"])
    assert match(joints, images("2.png", "1.png")).cameras == ("right", "left")
    assert [column.name for column in joints.kept] == ["j1"]


def test_two_rows_for_a_picture(tmp_path: Path):
    joints = table(tmp_path, "image,j1 [deg]", ["1.png,1", "2.png,5", "1.png,2"])
    with pytest.raises(MeasurementError, match=r"lines 2 and 4 both belong to the picture '1.png'"):
        match(joints, images("1.png"))


def test_no_row_for_any(tmp_path: Path):
    joints = table(tmp_path, "image,j1 [deg]", ["1.png,1"])
    with pytest.raises(MeasurementError, match=r"no row belongs to any .*'1.png'.*'7.png'"):
        match(joints, images("7.png"))


def test_columns_are_renamed_and_left_out(tmp_path: Path):
    joints = table(
        tmp_path,
        "part,file,J1,kind",
        ["a,1.png,1,x"],
        part="target",
        file="image",
        J1="j1 [deg]",
        kind="-",
    )
    assert joints.cell(0, joints.target) == "a"
    assert [(column.name, column.symbol) for column in joints.kept] == [("j1", "deg")]


def test_a_table_without_pictures(tmp_path: Path):
    with pytest.raises(MeasurementError, match=r"no column 'image'.*--index"):
        table(tmp_path, "picture,j1 [deg]", ["1.png,1"])


def test_a_column_that_is_written(tmp_path: Path):
    with pytest.raises(MeasurementError, match="column 'u' is reserved"):
        table(tmp_path, "image,u [px]", ["1.png,1"])
