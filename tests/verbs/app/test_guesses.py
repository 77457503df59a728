"""What calib takes from files by itself, and where it says that it is not sure."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from calib.example import dh_rows, franka_file
from calib.verbs.app.fields import Looked
from calib.verbs.app.guesses import look
from tests.verbs.app.sent import (
    JOINTS,
    ROWS,
    TABLE,
    URDF,
    job_of,
    joints_and_points,
    with_header,
    workbook,
)

MM = ("x [mm]", "y [mm]", "z [mm]")


def doubts(looked: Looked) -> dict[str, str]:
    return {one.name: one.doubt for one in looked.fields.values() if one.doubt}


def columns(looked: Looked) -> dict[str, str]:
    return {
        name.removeprefix("column:"): one.value
        for name, one in looked.fields.items()
        if name.startswith("column:")
    }


def values(looked: Looked, *names: str) -> list[str]:
    return [looked.value(name) for name in names]


def test_a_urdf_and_its_table(tmp_path: Path):
    looked = look(job_of(tmp_path, {"ur3.urdf": URDF, "data.csv": TABLE.encode()}))
    assert looked.is_ready
    assert (looked.rows, looked.joints) == (35, JOINTS)
    # The rows are in 'base', which is turned by half a turn from 'base_link'; the root is 'world'.
    assert values(looked, "base", "tip", "frame", "kind") == ["base", "tool0", "known", ""]
    assert doubts(looked) == {"instrument": "doubt_instrument"}
    assert columns(looked) == {}
    assert [(file.what, file.count) for file in looked.files] == [("robot", 0), ("table", 35)]
    assert looked.preview[0][:3] == ("1", "estimate", "-14.69")


def test_a_tracker_that_stands_anywhere(tmp_path: Path):
    """Points turned and shifted: no link explains them."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rows = [
        [*row[:8], *map(str, turn @ np.array(row[8:], dtype=float) + 1500.0)] for row in ROWS[1:]
    ]
    table = "\n".join(map(",".join, [ROWS[0], *rows])).encode()
    looked = look(job_of(tmp_path, {"ur3.urdf": URDF, "leica.csv": table}))
    assert values(looked, "frame", "base", "instrument") == ["estimate", "base_link", "tracker"]
    assert doubts(looked) == {"instrument": "doubt_instrument_name"}


def test_a_base_that_explains_the_rows_as_well_is_doubtful(tmp_path: Path):
    """Positions alone do not tell a base from a link that is 1 mm away."""
    near = URDF.replace(
        b"</robot>",
        b'<link name="near"/><joint name="n" type="fixed"><parent link="base"/><child link="near"/>'
        b'<origin xyz="0.001 0 0" rpy="0 0 0"/></joint></robot>',
    )
    looked = look(job_of(tmp_path, {"ur3.urdf": near, "data.csv": TABLE.encode()}))
    assert doubts(looked)["base"] == "doubt_base"


@pytest.mark.parametrize(
    ("labels", "brand", "mapped"),
    [
        ([f"J{i} [deg]" for i in range(1, 7)], "fanuc", []),
        ([f"A{i} [deg]" for i in range(1, 7)], "kuka", []),
        ([f"Achse {i} [°]" for i in range(1, 7)], "", [f"Achse {i} [°]" for i in range(1, 7)]),
        ([f"q{i} [deg]" for i in range(6)], "", [f"q{i} [deg]" for i in range(6)]),
        (
            [f"robot.joint_{i} [deg]" for i in range(1, 7)],
            "",
            [f"robot.joint_{i} [deg]" for i in range(1, 7)],
        ),
        ([f"{name} [deg]" for name in "abcdef"], "", [""] * 6),
    ],
)
def test_joints_by_other_names(tmp_path: Path, labels: list[str], brand: str, mapped: list[str]):
    looked = look(job_of(tmp_path, {"ur3.urdf": URDF, "data.csv": with_header(*labels, *MM)}))
    assert looked.value("brand") == brand
    assert columns(looked) == dict(zip(JOINTS, mapped, strict=False))
    expected = "doubt_brand" if brand else "doubt_order" if mapped[0] else "doubt_column"
    assert expected in doubts(looked).values()
    assert looked.is_ready == bool(brand or mapped[0])
    if looked.is_ready:
        assert looked.rows == 35
        assert values(looked, "base", "frame") == ["base", "known"]
    else:
        assert "shoulder_pan_joint" in looked.fault


@pytest.mark.parametrize(
    ("labels", "unit", "doubt"),
    [
        (("X", "Y", "Z"), "mm", "doubt_unit_size"),
        (("x_mm", "y_mm", "z_mm"), "mm", "doubt_unit_name"),
        (("pos_x", "pos_y", "pos_z"), "mm", "doubt_unit_size"),
    ],
)
def test_positions_without_units(tmp_path: Path, labels: tuple[str, ...], unit: str, doubt: str):
    header = [f"{name} [deg]" for name in JOINTS]
    looked = look(job_of(tmp_path, {"ur3.urdf": URDF, "data.csv": with_header(*header, *labels)}))
    assert looked.fault == ""
    assert looked.fields["position_unit"].doubt == doubt
    assert (looked.value("position_unit"), looked.rows) == (unit, 35)


def test_positions_in_metres_and_joints_in_radians(tmp_path: Path):
    rows = [
        [
            *row[:2],
            *(str(np.deg2rad(float(v))) for v in row[2:8]),
            *(str(float(v) / 1e3) for v in row[8:]),
        ]
        for row in ROWS[1:]
        if max(abs(float(value)) for value in row[2:8]) < 360.0
    ]
    table = "\n".join(map(",".join, [["row", "set", *JOINTS, "x", "y", "z"], *rows])).encode()
    looked = look(job_of(tmp_path, {"ur3.urdf": URDF, "data.csv": table}))
    assert values(looked, "position_unit", "joint_unit", "frame") == ["m", "rad", "known"]
    assert doubts(looked)["joint_unit"] == "doubt_unit_size"


@pytest.mark.parametrize("heading", ["", "Units: mm"])
def test_a_list_of_points(tmp_path: Path, heading: str):
    table, points = joints_and_points(heading)
    job = job_of(tmp_path, {"ur3.urdf": URDF, "joints.csv": table, "points.txt": points})
    looked = look(job)
    assert values(looked, "points", "instrument") == ["points.txt", "tracker"]
    assert looked.rows == 35
    assert (looked.value("points_unit"), "points_unit" in doubts(looked)) == (
        ("", False) if heading else ("mm", True)
    )


def test_a_sheet_of_excel(tmp_path: Path):
    files = {"ur3.urdf": URDF, "measured.xlsx": workbook("Notes", "Day 1")}
    looked = look(job_of(tmp_path, files))
    assert (looked.value("table"), looked.rows) == ("measured.xlsx#Day 1", 35)
    alone = look(job_of(tmp_path, {"ur3.urdf": URDF, "measured.xlsx": workbook("Day 1")}))
    assert (alone.value("table"), alone.rows) == ("measured.xlsx", 35)


def test_dh_rows_are_a_robot(tmp_path: Path):
    files = {"kr6.csv": dh_rows("kuka_kr6_r900").read_bytes()}
    looked = look(job_of(tmp_path, files))
    assert (looked.value("robot"), looked.missing) == ("kr6.csv", "missing_table")


def test_what_is_missing(tmp_path: Path):
    table = {"data.csv": TABLE.encode()}
    assert look(job_of(tmp_path, table)).missing == "missing_robot"
    assert look(job_of(tmp_path, {})).missing == "missing_robot"
    looked = look(job_of(tmp_path, table, robot_name="ur3"))
    assert (looked.missing, looked.rows, looked.value("base")) == ("", 35, "base")


def test_files_that_cannot_be_read_say_why(tmp_path: Path):
    looked = look(
        job_of(
            tmp_path,
            {
                "ur3.urdf": URDF[:2000],
                "data.csv": b"\x00\xff" * 500,
                "book.xlsx": b"PK\x03\x04 nothing",
                "notes.txt": b"Measured on Monday.",
                "cell.toml": b"base = ",
            },
        )
    )
    faults = {file.name: (file.what, bool(file.fault)) for file in looked.files}
    assert faults == {
        "ur3.urdf": ("faulty", True),
        "data.csv": ("faulty", True),
        "book.xlsx": ("faulty", True),
        "notes.txt": ("", False),
        "cell.toml": ("faulty", True),
    }
    assert all(str(tmp_path) not in file.fault for file in looked.files)
    assert looked.missing == "missing_robot"


def test_a_choice_goes_before_a_guess_if_it_is_allowed(tmp_path: Path):
    files = {"ur3.urdf": URDF, "data.csv": TABLE.encode()}
    looked = look(job_of(tmp_path, files, base="base_link", frame="estimate", instrument=""))
    assert values(looked, "base", "frame", "instrument") == ["base_link", "estimate", ""]
    assert doubts(looked) == {}
    # A link of a robot that was there before.
    looked = look(job_of(tmp_path, files, tip="tool0", base="panda_link0", robot="old.urdf"))
    assert looked.fault or looked.value("base") != "panda_link0"
    assert looked.value("robot") == "ur3.urdf"


def test_a_cell_file_states_what_is_not_chosen(tmp_path: Path):
    cell = b'base = "base_link"\ntip = "wrist_3_link"\nframe = "estimate"\ninstrument = "stereo"\nmodel = "dh"\n'
    files = {"ur3.urdf": URDF, "data.csv": TABLE.encode(), "own.toml": cell}
    looked = look(job_of(tmp_path, files))
    stated = ["base_link", "wrist_3_link", "estimate", "stereo", "dh"]
    assert values(looked, "base", "tip", "frame", "instrument", "model") == stated
    assert doubts(looked) == {}
    assert "serial" not in looked.fields
    without = look(job_of(tmp_path, files, cell=""))
    assert without.value("base") == "base"


def test_corners_of_a_board(tmp_path: Path):
    files = {
        name: franka_file(name).read_bytes()
        for name in ("corners.csv", "camera.toml", "board.toml")
    }
    looked = look(job_of(tmp_path, files, robot_name="panda"))
    assert looked.images
    assert looked.pictures == 0
    assert values(looked, "board", "camera", "tip") == ["board.toml", "camera.toml", "panda_link0"]
    assert {"base", "tip"} <= doubts(looked).keys()
    assert "instrument" not in looked.fields
    del files["board.toml"]
    (tmp_path / "board.toml").unlink()
    assert look(job_of(tmp_path, files, robot_name="panda")).missing == "missing_board"


def test_pictures_with_their_joint_values(tmp_path: Path):
    header = ",".join(["image", *(f"{name} [deg]" for name in JOINTS)])
    files = {
        "joints.csv": f"{header}\n1.png,1,2,3,4,5,6\n2.png,2,3,4,5,6,7\n".encode(),
        "board.toml": franka_file("board.toml").read_bytes(),
        "pictures/1.png": b"no picture",
        "pictures/2.png": b"",
    }
    job = job_of(tmp_path, files, robot_name="ur3")
    looked = look(job)
    assert (looked.images, looked.pictures) == (True, 2)
    assert looked.fields["camera"].doubt == "doubt_camera_size"
    Image.fromarray(np.zeros((48, 64), dtype=np.uint8)).save(tmp_path / "pictures" / "2.png")
    assert look(job).value("camera") == "64x48"


@pytest.mark.slow
def test_a_robot_on_a_rail(tmp_path: Path):
    """A prismatic joint in metres beside angles in degrees, as the program simulates it."""
    command = [
        sys.executable,
        "-m",
        "calib",
        "simulate",
        "tiago",
        "--tip",
        "arm_tool_link",
        "--count",
        "30",
    ]
    subprocess.run([*command, "-o", "data.csv"], cwd=tmp_path, check=True, capture_output=True)
    text = (tmp_path / "data.csv").read_text()
    header, _, rest = text.partition("\n")
    plain = ",".join(label.partition(" [")[0] for label in header.split(","))
    looked = look(
        job_of(
            tmp_path,
            {"data.csv": f"{plain}\n{rest}".encode()},
            robot_name="tiago",
            tip="arm_tool_link",
        )
    )
    assert looked.value("joint_unit").split() == ["deg", "mm"]
