"""The robot of a cell or a result of several chains, and links that the cell names wrongly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.cli.loading import load, load_with_data, with_chain_of_result
from calib.data.cell import Cell
from calib.data.cell_chains import (
    check_links_named,
    refuse_several_chains,
    robot_with_chains_of,
)
from calib.errors import CalibError, MeasurementError, ModelError
from calib.robot.urdf import read_urdf
from tests.two_handed import CELL, NAMES, fitted

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


def test_joints_of_a_second_robot_need_its_name(tmp_path):
    path = tmp_path / "data.csv"
    joints = ",".join(f"panda_joint{i} [rad]" for i in range(1, 8))
    path.write_text(f"target,{joints},{joints},x [m],y [m],z [m]\na{17 * ',0'}\n", encoding="utf-8")
    with pytest.raises(MeasurementError, match=r"'panda_joint1'.*robot 'right'.*'right/JOINT'"):
        load_with_data("panda", CELL, path)
