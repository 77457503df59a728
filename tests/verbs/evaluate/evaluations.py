"""Evaluations of six poses with a record, and their reports read back."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.record import Record
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.show.page import page_bytes
from calib.verbs.evaluate.acceptance import Assessment, assess
from calib.verbs.evaluate.report import Origins, report
from tests.show.pages import Page

RECORD = Record(customer="A & B <c>", robot_serial="4711", temperature_C=(20.5,))

LIMITS = {"tolerance": {"m": 1e-3, "rad": 2e-3}, "uncertainty": {"m": 1e-4, "rad": 2e-4}}


def measured(robot: Robot, worst: float) -> Measurements:
    """Six poses, five times each in turn, off by up to ``worst`` [m] along x; positions and orientations."""
    random = np.random.default_rng(7)
    q = np.tile(random_joint_values(robot, 6, 3), (5, 1))
    T = robot.poses(q)
    points = T[:, :3, 3] + random.normal(scale=2e-5, size=(30, 3))
    points[:, 0] += np.tile(np.linspace(0.1, 1.0, 6) * worst, 5)
    turns = Rotation.from_rotvec(random.normal(scale=2e-4, size=(30, 3)))
    approaches = tuple("xyxyx"[k // 6] for k in range(30))
    return Measurements(
        robot.joint_names,
        q,
        points,
        rotations=T[:, :3, :3] @ turns.as_matrix(),
        kinds=("pose",) * 30,
        approaches=approaches,
        source="fresh.csv",
    )


def made(robot: Robot, worst: float = 8e-4, record: Record = RECORD, **given) -> Assessment:
    cell = Cell(target=(0, 0, 0), target_rotation=np.eye(3), estimate_target=False, record=record)
    return assess(robot, measured(robot, worst), cell, limits=given.get("limits", LIMITS))


def page_of(e: Assessment) -> Page:
    return Page(page_bytes(report(e, Origins(command="calib evaluate"))).decode())
