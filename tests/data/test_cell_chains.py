"""Chains of a cell by what occurs in its table, and rows without values of joints that their chain lacks."""

from pathlib import Path

import numpy as np
import pytest

from calib.basics.tables import Table
from calib.data.cell import Cell, FurtherRobot
from calib.data.cell_chains import robot_of_cell, sights_of
from calib.data.inputs import inputs_of
from calib.errors import CalibError, MeasurementError, ModelError, UrdfError
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.urdf import read_urdf

TIPS = {"left": "arm_left_7_link", "right": "arm_right_7_link"}

SIDES = [f"arm_{side}_{k}_joint" for side in ("left", "right") for k in range(1, 8)]

HEADER = ",".join(
    [
        "target",
        "torso_lift_joint [m]",
        *(f"{name} [rad]" for name in SIDES),
        "x [m]",
        "y [m]",
        "z [m]",
    ]
)


def table_in(folder: Path, rows: list[str]) -> Path:
    path = folder / "hands.csv"
    path.write_text("\n".join([HEADER, *rows]) + "\n", encoding="utf-8")
    return path


def row(target: str, left: str, right: str) -> str:
    return ",".join([target, "0.1", *[left] * 7, *[right] * 7, "1", "2", "3"])


def test_the_chains_are_those_that_the_table_sees(tmp_path: Path):
    path = table_in(
        tmp_path, [row("left", "0.1", ""), row("right", "", "0.2"), row("left", "0.3", "")]
    )
    assert sights_of(Table.read(path)) == (("", "left"), ("", "right"))
    cell = Cell(tips=TIPS, estimate_frame=True)
    robot, table, _ = inputs_of("tiago_dual", path, cell)
    assert [(chain.base, chain.tip) for chain in robot.chains] == [
        ("base_footprint", "arm_left_7_link"),
        ("base_footprint", "arm_right_7_link"),
    ]
    assert set(robot.joint_names) == {"torso_lift_joint", *SIDES}
    rows, setup = rows_and_setup(robot, table, cell)
    assert rows.samples.chain is not None
    assert rows.samples.chain.tolist() == [0, 1, 0]
    assert setup.target_links == ("arm_left_7_link", "arm_right_7_link")
    # An arm whose cells are empty stands where it stood.
    column = table.joint_names.index("arm_left_1_joint")
    assert table.joints[:, column].tolist() == [0.1, 0.1, 0.3]
    assert table.without_joint is not None
    assert table.without_joint[:, column].tolist() == [False, True, False]


def test_one_tip_by_name_is_a_plain_robot():
    one = robot_of_cell(
        read_urdf("panda"), Cell(tips={"ball": "panda_link8"}), sights=[("", "ball")]
    )
    assert one == robot_of_cell(read_urdf("panda"), Cell(tip="panda_link8"))


def test_a_row_needs_the_joints_of_its_own_chain(tmp_path: Path):
    path = table_in(tmp_path, [row("left", "0.1", ""), row("right", "0.1", "")])
    cell = Cell(tips=TIPS, estimate_frame=True)
    robot, table, _ = inputs_of("tiago_dual", path, cell)
    with pytest.raises(MeasurementError, match=r"row 2.*'arm_right_1_joint'.*'right'"):
        rows_and_setup(robot, table, cell)


def test_without_other_chains_an_empty_cell_is_refused(tmp_path: Path):
    path = table_in(tmp_path, [row("left", "", "0.1")])
    with pytest.raises(MeasurementError, match="arm_left_1_joint"):
        inputs_of("tiago_dual", path, Cell(tip="arm_left_7_link"))


def test_every_target_needs_a_link_and_every_link_exists():
    urdf = read_urdf("tiago_dual")
    with pytest.raises(ModelError, match="'right'"):
        robot_of_cell(urdf, Cell(tips={"left": TIPS["left"]}), sights=[("", "left"), ("", "right")])
    with pytest.raises(UrdfError, match="arm_left_7_link"):
        robot_of_cell(urdf, Cell(tips={"left": "arm_left_7"}), sights=[("", "left")])


def test_a_further_robot_has_its_name_before_its_links():
    cell = Cell(
        robots={"right": FurtherRobot("panda", T_root_base=np.eye(4), estimated=False)},
        tips={"a": "panda_link8", "b": "right/panda_link8"},
    )
    robot = robot_of_cell(read_urdf("panda"), cell, sights=[("", "a"), ("", "b")])
    assert robot.joint_names[:1] == ("panda_joint1",)
    assert robot.joint_names[7] == "right/panda_joint1"
    assert robot.mounts == ()  # it is known where it stands
    with pytest.raises(CalibError, match="known"):
        FurtherRobot("panda", estimated=False)
