"""Lost motion that the model lacks: found by the sides from which joints arrived, and not where there is none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.numerics.moves import last_moves
from calib.robot.robot import Robot
from calib.verbs.measure.lost_motion import find_lost_motion
from calib.verbs.measure.running_fit import RunningFit
from calib.verbs.simulate.operator import Operator
from calib.verbs.simulate.scenario import Scenario, VirtualCell
from tests.verbs.measure.sessions import ANGLE, LENGTH, fit_of, points_cell, virtual_cell


def fitted(virtual: VirtualCell, count: int, seed: int, lost: tuple[int, float]) -> RunningFit:
    """A fit to poses at random, where one joint stops short of its reading by an angle, whichever way it came."""
    q = virtual.poses(count, seed)
    moves = last_moves(q)
    joint, angle = lost
    stands = q.copy()
    stands[:, joint] -= angle * np.sign(moves[:, joint])
    operator = Operator.of(virtual, seed)
    tables = []
    for noted, stood, move in zip(q, stands, moves, strict=True):
        table = operator.measure(stood).readings
        k = len(table)
        tables.append(replace(table, joints=np.tile(noted, (k, 1)), moves=np.tile(move, (k, 1))))
    return fit_of(virtual, tables)


def cell_of(kind: str) -> Cell:
    cell = points_cell("zeros", kind=kind)
    return cell if kind == "point" else replace(cell, sigma={"m": LENGTH, "rad": ANGLE})


@pytest.mark.parametrize("kind", ["point", "pose"])
@pytest.mark.parametrize(("joint", "angle"), [(0, 5e-4), (2, -4e-4), (1, 3e-4)])
def test_it_is_found_with_its_joint_and_size(ur3, kind: str, joint: int, angle: float):
    virtual = virtual_cell(ur3, cell_of(kind))
    found = find_lost_motion(fitted(virtual, 30, 4, (joint, angle)), 1.0)
    assert found is not None
    assert found[0] == ur3.joint_names[joint]
    assert found[1] == pytest.approx(angle, rel=0.25)


@pytest.mark.slow
def test_pictures_tell_it_too():
    arm = Robot.load("ur5", base="tool0", tip="base_link")
    virtual = virtual_cell(arm, Cell(kind="pixel", model="zeros", sigma={"px": 0.3}), 7)
    found = find_lost_motion(fitted(virtual, 20, 4, (1, 2e-3)), 1.0)
    assert found is not None
    assert found[0] == arm.joint_names[1]
    assert found[1] == pytest.approx(2e-3, rel=0.3)


def test_a_model_that_has_it_needs_no_advice(ur3):
    virtual = virtual_cell(ur3, points_cell("zeros+lost_motion"))
    assert find_lost_motion(fitted(virtual, 30, 4, (0, 0.0)), 1.0) is None


def test_after_few_stops_it_cannot_be_told(ur3):
    virtual = virtual_cell(ur3, points_cell())
    assert find_lost_motion(fitted(virtual, 6, 4, (0, 1e-2)), 1.0) is None


def test_in_a_noisier_session_it_has_to_be_larger(ur3):
    fit = fitted(virtual_cell(ur3, points_cell()), 30, 4, (0, 3e-4))
    assert find_lost_motion(fit, 1.0) is not None
    assert find_lost_motion(fit, 100.0) is None


@pytest.mark.slow
@pytest.mark.parametrize("model", ["zeros", "placement"])
def test_where_there_is_none_none_is_found(ur3, model: str):
    found: list[Any] = []
    for seed in range(150):
        virtual = Scenario(ur3, points_cell(model), model).draw(seed)
        found.append(find_lost_motion(fitted(virtual, 30, seed, (0, 0.0)), 1.0))
    assert len([each for each in found if each is not None]) <= 2
