"""The causes of a result of two stations and two targets: what moves together is the sum of what moves alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.verbs.check.causes import causes_of, moving_causes
from calib.verbs.check.check import fresh_stops
from calib.verbs.check.innovations import LEVER, StoredResult, stacked
from tests.verbs.check.shop import JOINTS, paper_result, points


def table_of_two(q: np.ndarray, targets: np.ndarray | None = None) -> Measurements:
    """Two targets seen from two stations, in turn."""
    arm = paper_result().robot
    places = np.array([[0.05, 0.02, 0.03], [-0.04, 0.05, 0.02]]) if targets is None else targets
    frames = [np.eye(4), pin.exp6(np.array([1.0, -2.0, 0.3, 0.1, 0.2, 2.0])).homogeneous]
    T = arm.poses(q)
    groups = [("left", "right")[i % 2] for i in range(len(q))]
    names = [("a", "b")[(i // 2) % 2] for i in range(len(q))]
    xyz = [(frames[i % 2] @ T[i] @ np.append(places[(i // 2) % 2], 1.0))[:3] for i in range(len(q))]
    return Measurements(
        joint_names=JOINTS,
        joints=q,
        points=np.array(xyz),
        groups=tuple(groups),
        targets=tuple(names),
    )


@cache
def of_two() -> Calibration:
    q = random_joint_values(paper_result().robot, 24, 3)
    table = table_of_two(q)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(table.points.shape)
    table = replace(table, points=table.points + noise)
    return calibrate(
        paper_result().robot, table, cell=Cell(estimate_frame=True), model="zeros", validate=False
    )


def test_of_one_frame_and_one_target():
    causes = moving_causes(StoredResult.of(paper_result()))
    assert [(cause.code, cause.name) for cause in causes] == [
        ("frame", ""),
        ("target", ""),
        *(("joint", name) for name in JOINTS),
    ]
    np.testing.assert_allclose(causes[0].scale, [1.0] * 3 + [1.0 / LEVER] * 3)


def test_rows_alone_and_all_are_causes_too():
    stored = StoredResult.of(paper_result())
    stack = stacked(fresh_stops(stored, points(), Cell()))
    causes, directions = causes_of(moving_causes(stored), stack)
    assert [cause.code for cause in causes[-4:]] == ["row", "row", "row", "other"]
    assert [cause.rows for cause in causes[-4:-1]] == [(1,), (2,), (3,)]
    assert [one.prior for one in directions[-4:]] == [1 / 3, 1 / 3, 1 / 3, 0.1]
    assert len(directions[-1].singular) == 9


def test_the_base_and_the_hand_are_one_motion_of_all():
    """Displacements of both stations, and of both targets, against rows that were moved so."""
    stored = StoredResult.of(of_two())
    causes = {(cause.code, cause.name): cause for cause in moving_causes(stored)}
    assert {("frame", "left"), ("frame", "right"), ("target", "a"), ("target", "b")} < set(causes)
    q = random_joint_values(paper_result().robot, 8, 9)
    before = fresh_stops(stored, table_of_two(q), Cell())
    D = np.concatenate([stop.by_displacements for stop in before])
    y = np.concatenate([stop.y for stop in before])
    step = 1e-5
    places = np.array([[0.05, 0.02, 0.03], [-0.04, 0.05, 0.02]])
    for k in range(6):
        twist = np.eye(6)[k] * (1.0 if k < 3 else 1.0 / LEVER)
        moved = pin.exp6(step * twist).homogeneous
        shifted = places @ moved[:3, :3].T + moved[:3, 3]
        after = fresh_stops(stored, table_of_two(q, targets=shifted), Cell())
        change = (np.concatenate([stop.y for stop in after]) - y) / step
        predicted = D @ causes["hand", ""].mixing[:, k]
        np.testing.assert_allclose(predicted, change, atol=0.02 * np.abs(D).max())
    together = causes["base", ""].mixing
    alone = causes["frame", "left"].mixing + causes["frame", "right"].mixing
    np.testing.assert_allclose(together, alone)
