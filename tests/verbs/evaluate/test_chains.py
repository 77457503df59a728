"""A robot of several chains is evaluated row by row through each one's own chain, as the fit had it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell, FurtherRobot
from calib.data.measurements import Measurements
from calib.errors import ModelError
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.evaluate.acceptance import assess
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.evaluate.report import summary
from tests.two_handed import CELL, JOINTS, fitted


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """The result as read from its file, with the table and the cell of the fit."""
    c = fitted()
    path = c.write_json(tmp_path_factory.mktemp("result") / "result.json")
    return Calibration.read_json(path), c


def test_errors_are_those_of_the_fit_by_chain(read):
    result, c = read
    m = c.fit.measurements
    cell = result.setup.in_cell(c.fit.cell)
    assessment = assess(c.nominal, m, cell, result, which=("frame", "target"))
    found = assessment.evaluations["calibration"]
    np.testing.assert_allclose(found.residual, c.rows.residual_calibrated, atol=1e-9)
    by_chain = found.errors_by_chain
    assert list(by_chain) == ["panda_link0 to panda_link8", "panda_link0 to right/panda_link8"]
    for hand, errors in zip("ab", by_chain.values(), strict=True):
        norms = np.linalg.norm(c.rows.residual_calibrated[np.array(m.targets) == hand], axis=1)
        assert errors["m"].rms == pytest.approx(np.sqrt(np.mean(norms**2)))
    assert len(assessment.accuracies["calibration"].poses) == len(m)
    text = summary(assessment)
    assert "panda_link0 to right/panda_link8" in text
    assert "mm in right/panda_link8" in text


def test_one_chain_has_no_errors_by_chain(paper_table, ur3):
    assert evaluate(ur3, paper_table).errors_by_chain == {}


def test_a_robot_whose_place_is_not_known_is_not_evaluated():
    c = fitted()
    table = c.fit.measurements
    with pytest.raises(ModelError, match=r"'right' stands is not stated.*\[robots.right\]"):
        evaluate("panda", table, CELL)
    placed = FurtherRobot("panda", T_root_base=c.robot.urdf.joint("right/mount").T_parent_joint)
    found = evaluate("panda", table, replace(CELL, robots={"right": placed}))
    assert np.linalg.norm(found.residual, axis=1).max() < 0.02


def test_a_clasp_is_evaluated_without_a_result():
    """Nothing is registered of its target, and none has to be stated."""
    q = np.tile([[0.3, -0.5, 0.2, -1.8, 0.1, 1.5, 0.4]], (3, 1)) + 0.01 * np.eye(7)[:3]
    table = Measurements(JOINTS, q, np.full((3, 3), np.nan), kinds=("clasp",) * 3)
    robot = Robot.load("panda", tip="panda_link8")
    assessment = assess(robot, table, Cell())
    found = assessment.evaluations["urdf"]
    assert found.registered == ("frame",)
    p = robot.poses(q)[:, :3, 3]
    away = np.linalg.norm(p - p.mean(axis=0), axis=1)
    np.testing.assert_allclose(np.linalg.norm(found.residual[:, :3], axis=1), away, atol=1e-6)


def test_a_target_that_a_result_of_several_hands_lacks_is_refused():
    """It would be registered anew, on whichever hand is the first."""
    c = fitted()
    m, cell = c.fit.measurements, c.setup.in_cell(c.fit.cell)
    every = np.nan_to_num(
        m.joints
    )  # the hands' joints in all rows, as a robot of two arms reports them
    names = tuple("right" if t == "b" else t for t in m.targets)
    mistyped = replace(m, joints=every, without_joint=None, targets=names)
    row = m.rows[m.targets.index("b")]
    with pytest.raises(ModelError, match=rf"row {row}: the target 'right' .* has 'a', 'b'"):
        evaluate(c.robot, mistyped, cell, known=c.setup)
    # On a link that is named it is a new one, and is registered.
    named = replace(cell, tips={**cell.tips, "right": "right/panda_link8"})
    found = evaluate(c.robot, mistyped, named, known=c.setup)
    assert found.registered == ("target",)
    assert np.linalg.norm(found.residual, axis=1).max() < 1e-3
