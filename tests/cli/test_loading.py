"""Cell, robot and table of a call: options over the cell file, the chain of a result, the URDF's target."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.cli.loading import load, load_with_data, with_target_link
from calib.cli.options import FitOptions, TableOptions
from calib.data.cell import Cell
from calib.errors import CalibError
from calib.example import paper_urdf
from calib.model.parameter_sets import DIRECTIONS
from calib.robot.robot import Robot

CELL = """
base = "base"
model = "zeros+gain"
kind = "point"
frame = ["x"]
[payload]
mass_kg = 2
com_mm = [0, 0, 50]
[held]
lift = "0.1 m"
pan = "10 deg"
"""


def test_the_line_wins_over_the_file(tmp_path: Path):
    path = tmp_path / "cell.toml"
    path.write_text(CELL, encoding="utf-8")
    plain = FitOptions(path).cell()
    assert repr(plain) == repr(Cell.read(path))
    given = {
        "tip": "tool0", "frame": "estimate", "model": "dh", "kind": "pose", "hold": ["lift=0.3 m"],
        "payload": "5 kg", "target": "1 2 3 mm",
    }  # fmt: skip
    cell = FitOptions(path, given).cell()
    assert (cell.base, cell.tip, cell.model, cell.kind) == ("base", "tool0", "dh", "pose")
    assert cell.estimate_frame
    assert cell.frame_directions == DIRECTIONS
    assert cell.held == {"lift": 0.3, "pan": plain.held["pan"]}
    assert cell.payload is not None
    assert cell.payload.mass == 5.0
    assert cell.payload.com[2] == 0.05
    assert cell.target is not None
    assert not FitOptions(path, {"frame": "known"}).cell().estimate_frame


def test_the_kind_of_the_cell_is_that_of_the_table(shop: Path):
    cell = Cell(base="base", kind="fixed")
    text = (shop / "joints.csv").read_text(encoding="utf-8").splitlines()
    grouped = [text[0] + ",group", *(line + ",socket" for line in text[1:])]
    (shop / "grouped.csv").write_text("\n".join(grouped), encoding="utf-8")
    _, table = load_with_data(str(shop / "robot.urdf"), cell, shop / "grouped.csv")
    assert set(table.kinds) == {"fixed"}


def test_data_in_the_place_of_the_robot_are_refused(shop: Path):
    with pytest.raises(CalibError, match="ROBOT comes first"):
        load_with_data(str(shop / "joints.csv"), Cell(), shop / "robot.urdf")
    with pytest.raises(CalibError, match="--points-unit"):
        load_with_data("robot.urdf", Cell(), shop / "data.csv", TableOptions(points_unit="mm"))


def test_the_robot_has_the_coupled_readings_of_the_cell():
    coupling = {"elbow_joint": {"shoulder_lift_joint": 1.0}}
    cell = Cell(base="base", tip="tool0", coupling=coupling)
    assert load("ur3", cell).reading_coupling == coupling


def test_the_target_of_a_urdf_is_at_its_link(tmp_path: Path):
    """A link at p in the tip gives the target p; without a link the cell stays as it is."""
    place = (0.01, -0.02, 0.03)
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    assert with_target_link(robot, Cell()).target is None
    text = Path(paper_urdf()).read_text(encoding="utf-8")
    joint = (
        '<link name="calib_target"/><joint name="calib_target_joint" type="fixed">'
        '<parent link="tool0"/><child link="calib_target"/>'
        f'<origin xyz="{place[0]} {place[1]} {place[2]}" rpy="0 0 0"/></joint></robot>'
    )
    path = tmp_path / "with_link.urdf"
    path.write_text(text.replace("</robot>", joint), encoding="utf-8")
    target = with_target_link(Robot.load(path, base="base", tip="tool0"), Cell()).target
    assert target is not None
    np.testing.assert_allclose(target, place, rtol=0, atol=1e-12)


def test_a_brand_s_columns_are_those_of_the_chain(shop: Path):
    lines = (shop / "data.csv").read_text(encoding="utf-8").splitlines()
    names = [f"J{k}" for k in range(1, 7)]
    header = lines[0].split(",")
    at = next(k for k, name in enumerate(header) if name.startswith("shoulder_pan_joint"))
    header[at : at + 6] = names
    (shop / "brand.csv").write_text("\n".join([",".join(header), *lines[1:]]), encoding="utf-8")
    robot, cell = str(shop / "robot.urdf"), Cell(base="base")
    _, plain = load_with_data(robot, cell, shop / "data.csv")
    pairs = [f"{n}={j}" for n, j in zip(names, plain.joint_names, strict=True)]
    for options in (TableOptions(["fanuc"]), TableOptions(pairs, joint_unit="deg")):
        arm, table = load_with_data(robot, cell, shop / "brand.csv", options)
        assert table.joint_names == arm.joint_names
        np.testing.assert_array_equal(table.joints, plain.joints)
    with pytest.raises(CalibError, match="--columns fanuc"):
        load_with_data(robot, cell, shop / "brand.csv")


def test_links_by_name_and_without():
    given = {
        "tip": ["left=l7", "right=r7"],
        "board_on": ["third=r6"],
        "base": ["root"],
        "frame": ["estimate", "head=head_2"],
        "camera_on": ["wrist=l7"],
    }
    cell = FitOptions(None, given).cell()
    assert cell.tip is None
    assert cell.tips == {"left": "l7", "right": "r7", "third": "r6"}
    assert cell.base == "root"
    assert cell.bases == {"wrist": "l7", "head": "head_2"}
    assert cell.estimate_frame
    assert not FitOptions(None, {"frame": ["head=head_2"]}).cell().estimate_frame
    assert FitOptions(None, {"frame": ["x", "rz"]}).cell().frame_directions == ("x", "rz")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"tip": ["a", "b"]}, "--tip is given twice"),
        ({"tip": ["a=b", "a=c"]}, "names 'a' twice"),
        ({"base": ["=b"]}, "--base '=b' lacks"),
        ({"tip": ["a"], "board_on": ["b"]}, "mean the same"),
        ({"other_robot": ["right="]}, "--other-robot 'right=' lacks"),
        ({"other_robot": ["panda"]}, "write NAME=panda"),
    ],
)
def test_links_that_are_refused(given: dict[str, list[str]], said: str):
    with pytest.raises(CalibError, match=said):
        FitOptions(None, given).cell()
