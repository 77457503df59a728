"""Two Pandas before two trackers, true by Pinocchio alone: their measurements, and how everything really stands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from calib.data.cell import Cell, FurtherRobot
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.urdf import read_urdf
from tests.kept import kept

#: Errors of each placement, standard deviations: [m], [rad].
LENGTH, ANGLE = 5e-4, 2e-3

JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
NAMES = (*JOINTS, *(f"right/{name}" for name in JOINTS))

#: Where the target is on the hand of each robot [m].
POINTS = {"a": np.array([0.06, 0.03, 0.05]), "b": np.array([-0.04, 0.05, 0.02])}

CELL = Cell(
    estimate_frame=True,
    robots={"right": FurtherRobot("panda")},
    tips={"a": "panda_link8", "b": "right/panda_link8"},
)


@kept
def fitted(seed: int = 1) -> Calibration:
    """The calibration of a table, without validation: enough for what verbs do with it."""
    table = two_handed(seed).measurements
    return calibrate("panda", table, cell=CELL, model="placement", validate=False, robust=False)


class TwoHanded(NamedTuple):
    """A table, and the truth behind it."""

    measurements: Measurements
    #: Pose of each tracker, by its station, and of the robot ``right`` in the root of the first, (4, 4) [m].
    poses: Mapping[str, np.ndarray]


def two_handed(seed: int, sigma: float = 5e-5, stops: int = 30) -> TwoHanded:
    """Measure points on both hands at so many stops, each tracker at every other one, with noise sigma [m]."""
    rng = np.random.default_rng(seed)
    text = read_urdf("panda").data.decode()
    robots = {}
    for hand in POINTS:
        robot = pin.buildModelFromXML(text)
        for j in range(1, 8):
            error = np.r_[LENGTH * rng.standard_normal(3), ANGLE * rng.standard_normal(3)]
            robot.jointPlacements[j] = robot.jointPlacements[j] * pin.exp6(error)
        robots[hand] = robot
    right = pin.SE3(pin.exp3(np.array([0.05, -0.02, 2.8])), np.array([1.1, 0.2, 0.05]))
    bases = {"a": pin.SE3.Identity(), "b": right}
    trackers = {
        name: pin.SE3(pin.exp3(rng.standard_normal(3)), np.array(place))
        for name, place in (("t1", [1.0, 2.0, 0.3]), ("t2", [-1.0, 0.5, 0.7]))
    }
    lower, upper = robots["a"].lowerPositionLimit[:7], robots["a"].upperPositionLimit[:7]
    joints, points, targets, groups, without = [], [], [], [], []
    for k in range(stops):
        for hand, robot in robots.items():
            q = pin.neutral(robot)
            q[:7] = rng.uniform(lower, upper)
            data = robot.createData()
            pin.framesForwardKinematics(robot, data, q)
            tip = bases[hand] * data.oMf[robot.getFrameId("panda_link8")]
            station = ("t1", "t2")[k % 2]
            seen = (trackers[station].inverse() * tip).act(POINTS[hand])
            own = np.repeat([hand == "a", hand == "b"], 7)
            joints.append(np.where(own, np.tile(q[:7], 2), 0.0))
            without.append(~own)
            points.append(seen + sigma * rng.standard_normal(3))
            targets.append(hand)
            groups.append(station)
    measurements = Measurements(
        NAMES,
        np.array(joints),
        np.array(points),
        targets=tuple(targets),
        groups=tuple(groups),
        without_joint=np.array(without),
    )
    poses = {name: pose.homogeneous for name, pose in {**trackers, "right": right}.items()}
    return TwoHanded(measurements, poses)
