"""Chains of a cell by what occurs in its table, rows without joints that their chain lacks, and links named wrongly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.basics.tables import Table
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.cli.loading import load, load_with_data
from calib.data.cell import Cell, FurtherRobot
from calib.data.cell_chains import (
    cell_of_sight,
    chain_numbers,
    check_links_named,
    links_of,
    named_stations,
    named_targets,
    refuse_several_chains,
    robot_of_cell,
    robot_with_chains_of,
    sights_of,
)
from calib.data.inputs import inputs_of
from calib.data.measurements import Measurements
from calib.errors import CalibError, MeasurementError, ModelError, UrdfError
from calib.fit.registration.table_rows import rows_and_setup
from calib.result.chain_of_result import with_chain_of_result
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from tests.two_handed import CELL, NAMES, fitted

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


SIGHTS = (("t1", "a"), ("t2", "b"))


def test_links_of_what_the_table_lacks_are_refused():
    check_links_named(CELL, SIGHTS, "data.csv")
    wrong = replace(CELL, tips={**CELL.tips, "c": "panda_link7"})
    with pytest.raises(
        ModelError, match=r"data.csv: --tip c=panda_link7 names 'c', but the column"
    ):
        check_links_named(wrong, SIGHTS, "data.csv")
    with pytest.raises(ModelError, match=r"--base t1=panda_link0.*the table has no column 'group'"):
        check_links_named(Cell(bases={"t1": "panda_link0"}), (("", "a"),), "data.csv")


#: Cameras on the wrist and on the wall, boards on the table and on the flange.
WRIST_AND_WALL = Cell(
    bases={"wrist": "panda_link8", "wall": "panda_link0"},
    tips={"table": "panda_link0", "flange": "panda_link8"},
    cameras={"wall": Camera(width=640, height=480), "door": Camera(width=1280, height=720)},
    boards={"": Board(pattern="chessboard", columns=5, rows=4, square=0.04)},
    frames={"wall": np.eye(4)},
    targets={"table": [0.1, 0.2, 0.3]},
)


def test_stations_and_targets_are_those_that_the_cell_names():
    assert named_stations(Cell()) == ("",)
    assert named_targets(Cell()) == ("target",)
    assert named_stations(WRIST_AND_WALL) == ("wall", "wrist")
    assert named_stations(WRIST_AND_WALL, images=True) == ("wall", "wrist", "door")
    assert named_targets(WRIST_AND_WALL, images=True) == ("table", "flange")
    robot = robot_of_cell(read_urdf("panda"), replace(WRIST_AND_WALL, cameras={}))
    links = links_of(WRIST_AND_WALL, robot, ("wall", "door", "wrist"), ("flange", "table"))
    assert links == (
        ("panda_link0", "panda_link0", "panda_link8"),
        ("panda_link8", "panda_link0"),
    )
    plain = robot_of_cell(read_urdf("panda"), Cell(base="panda_link1", tip="panda_link7"))
    assert links_of(Cell(), plain, ("",), ("t",)) == (("panda_link1",), ("panda_link7",))


def test_a_target_that_nothing_moves_against_its_station_has_no_chain():
    robot = robot_of_cell(read_urdf("panda"), replace(WRIST_AND_WALL, cameras={}))
    assert [(chain.base, chain.tip) for chain in robot.chains] == [
        ("panda_link0", "panda_link8"),
        ("panda_link8", "panda_link0"),
    ]
    links = links_of(WRIST_AND_WALL, robot, ("wall", "wrist"), ("table", "flange"))
    assert chain_numbers(robot, *links) == {(0, 1): 0, (1, 0): 1}
    # With all joints between two links held, too.
    held = {f"panda_joint{k}": 0.1 for k in (6, 7)}
    cell = Cell(
        bases={"a": "panda_link8", "b": "panda_link0"}, tips={"t": "panda_link5"}, held=held
    )
    assert robot_of_cell(read_urdf("panda"), cell).chains[0].base == "panda_link0"


def test_a_cell_of_one_sight_says_what_it_says_of_these_two_alone():
    one = cell_of_sight(WRIST_AND_WALL, "wall", "table")
    assert (one.bases, one.tips, one.frames, one.targets) == ({}, {}, {}, {})
    np.testing.assert_array_equal(one.T_frame_base, np.eye(4))
    np.testing.assert_array_equal(one.target, [0.1, 0.2, 0.3])
    assert one.cameras[""].width == 640
    assert one.boards[""].columns == 5
    other = cell_of_sight(WRIST_AND_WALL, "wrist", "flange")
    assert (other.T_frame_base, other.target, other.cameras) == (None, None, {})


def test_one_chain_at_a_time_where_several_are_not_taken():
    refuse_several_chains(Cell(tip="panda_link8"), "this works")
    with pytest.raises(ModelError, match=r"this works for one chain at a time.*'a', 'b', 'right'"):
        refuse_several_chains(CELL, "this works")


@pytest.mark.parametrize("whole", [False, True])
def test_a_robot_gets_the_chains_of_a_result(whole):
    c = fitted()
    urdf = c.nominal.urdf if whole else read_urdf("panda")
    robot = robot_with_chains_of(c.robot, urdf, {})
    assert robot.joint_names == NAMES
    # The further robot stands where that of the result does if it is joined; else where the URDF has it.
    source = c.nominal if whole else c.robot
    T = robot.urdf.joint("right/mount").T_parent_joint
    expected = source.urdf.joint("right/mount").T_parent_joint
    np.testing.assert_allclose(T, expected, rtol=0.0, atol=1e-12)
    q = np.full((2, 14), 0.2)
    chain = np.array([0, 1])
    np.testing.assert_allclose(
        c.corrected(robot).poses(q, chain), c.robot.poses(q, chain), atol=1e-12
    )


def test_a_result_gives_the_links_and_refuses_others():
    c = fitted()
    cell = with_chain_of_result(Cell(), c, "result.json")
    assert dict(cell.tips) == dict(CELL.tips)
    assert load("panda", cell, result=c).joint_names == NAMES
    with pytest.raises(CalibError, match=r"result for --tip 'a=panda_link8', but 'a=panda_link7'"):
        with_chain_of_result(Cell(tips={"a": "panda_link7"}), c, "result.json")
    # A new target is on a link that the result has.
    added = with_chain_of_result(Cell(tips={"c": "panda_link8"}), c, "result.json")
    assert dict(added.tips) == {**CELL.tips, "c": "panda_link8"}
    with pytest.raises(CalibError, match="'c=panda_link7' was given"):
        with_chain_of_result(Cell(tips={"c": "panda_link7"}), c, "result.json")


def test_joints_of_a_second_robot_need_its_name(tmp_path):
    path = tmp_path / "data.csv"
    joints = ",".join(f"panda_joint{i} [rad]" for i in range(1, 8))
    path.write_text(f"target,{joints},{joints},x [m],y [m],z [m]\na{17 * ',0'}\n", encoding="utf-8")
    with pytest.raises(MeasurementError, match=r"'panda_joint1'.*robot 'right'.*'right/JOINT'"):
        load_with_data("panda", CELL, path)


def test_joints_that_no_row_needs_need_no_column(tmp_path: Path):
    kept = [f"arm_left_{k}_joint" for k in (3, 2, 1, 4, 5, 6, 7)]
    header = ["target", *(f"{name} [rad]" for name in kept), "torso_lift_joint [m]"]
    path = tmp_path / "left.csv"
    numbers = ["0.3", "0.2", "0.1", "0.4", "0.5", "0.6", "0.7", "0.05"]
    lines = [",".join([*header, "x [m],y [m],z [m]"]), ",".join(["left", *numbers, "1,2,3"])]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    cell = Cell(tips=TIPS, estimate_frame=True)
    robot = robot_of_cell(read_urdf("tiago_dual"), cell)
    table = Measurements.read(path, robot.joint_names, robot.joint_types, needs_all_joints=False)
    assert table.joint_names == robot.joint_names
    values = dict(zip(table.joint_names, table.joints[0].tolist(), strict=True))
    assert [values[f"arm_left_{k}_joint"] for k in range(1, 8)] == pytest.approx(
        [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
    )
    assert values["torso_lift_joint"] == 0.05
    assert values["arm_right_1_joint"] == 0.0
    assert table.without_joint is not None
    lacks = [name.startswith("arm_right") for name in table.joint_names]
    assert table.without_joint[0].tolist() == lacks
    assert "torso_lift_joint" in table.prismatic
    rows, _ = rows_and_setup(robot, table, cell)
    assert len(rows) == 1
    # A robot of one chain needs them all.
    with pytest.raises(MeasurementError, match="arm_right_1_joint"):
        Measurements.read(path, robot.joint_names, robot.joint_types)


def test_a_missing_column_that_a_row_needs_is_named_with_the_row(tmp_path: Path):
    path = table_in(tmp_path, [row("left", "0.1", ""), row("right", "0.1", "0.2")])
    misspelt = path.read_text(encoding="utf-8").replace("arm_right_6_joint", "arm_right_6_jnt")
    path.write_text(misspelt, encoding="utf-8")
    cell = Cell(tips=TIPS, estimate_frame=True)
    robot, table, _ = inputs_of("tiago_dual", path, cell)
    expected = r"row 2, column 'arm_right_6_joint'.*did you mean 'arm_right_6_jnt'.*--columns"
    with pytest.raises(MeasurementError, match=expected):
        rows_and_setup(robot, table, cell)


def test_joints_beside_the_chain_of_a_row_are_written_as_empty_cells(tmp_path: Path):
    path = table_in(tmp_path, [row("left", "0.1", ""), row("right", "", "0.2")])
    robot, table, _ = inputs_of("tiago_dual", path, Cell(tips=TIPS))
    table.write(tmp_path / "again.csv")
    again = Measurements.read(
        tmp_path / "again.csv", robot.joint_names, robot.joint_types, needs_all_joints=False
    )
    assert table.without_joint is not None
    assert again.without_joint is not None
    assert np.array_equal(again.without_joint, table.without_joint)


def test_a_link_that_does_not_exist_is_named_with_its_rows():
    urdf = read_urdf("tiago_dual")
    wrong = Cell(tips={"left": "arm_left_7_lnk"})
    with pytest.raises(
        UrdfError, match=r"--tip left=arm_left_7_lnk.*'left' in the column 'target'"
    ):
        robot_of_cell(urdf, wrong)
    of_other = Cell(bases={"grip": "right/panda_link8"}, tips={"ball": "panda_link8"})
    with pytest.raises(UrdfError, match=r"--base grip=.*column 'group'.*--other-robot right=URDF"):
        robot_of_cell(read_urdf("panda"), of_other)


def test_a_further_robot_that_no_row_reaches_is_refused():
    unreached = replace(CELL, tips={"a": "panda_link8", "b": "panda_link7"})
    with pytest.raises(ModelError, match=r"--other-robot right: no row reaches"):
        robot_of_cell(read_urdf("panda"), unreached)


def test_two_arms_without_links_ask_for_those_of_the_targets_that_the_table_names():
    measured = [f"arm_{hand}_{k}_joint" for hand in ("left", "right") for k in range(1, 8)]
    urdf = read_urdf("tiago_dual")
    sights = [("", "a"), ("t2", "a"), ("", "b")]
    with pytest.raises(UrdfError, match=r"2 arms.*'a', 'b'.* --tip a=LINK --tip b=LINK\."):
        robot_of_cell(urdf, Cell(), measured, sights)
    for few in (None, sights[:2]):
        with pytest.raises(UrdfError, match="--tip NAME=wrist_left_ft_tool_link"):
            robot_of_cell(urdf, Cell(), measured, few)


def test_robots_with_columns_in_another_order_are_not_equal():
    """Limits are remembered by robot: those of a limb in a cell's columns are not those of the arm by itself."""
    cell = Cell(
        bases={"wrist": "panda_link8", "wall": "panda_link0"},
        tips={"table": "panda_link0", "flange": "panda_link8"},
    )
    sights = [("wrist", "table"), ("wall", "flange")]
    robot = robot_of_cell(read_urdf("panda"), cell, sights=sights)
    alone = Robot.load("panda", "panda_link0", "panda_link8")
    for chain in robot.chains:
        by_name = dict(zip(chain.joint_names, column_limits(chain).tolist(), strict=True))
        for name, limits in zip(alone.joint_names, column_limits(alone).tolist(), strict=True):
            assert by_name[name] == limits
        if (chain.base, chain.tip) == ("panda_link0", "panda_link8"):
            assert chain.joint_names == alone.joint_names[::-1]
            assert chain != alone
