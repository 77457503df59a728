"""Joints at their stops, alone and beside measured points: zeros without an instrument."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Why
from calib.errors import UrdfError
from calib.result.calibrate import calibrate
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot

ZEROS = np.array([0.02, -0.013, 0.005, -0.034, 0.006])


@pytest.fixture(scope="module")
def arm() -> Robot:
    return Robot.load("so101")


def stops(arm: Robot, noise: float = 0.0, seed: int = 0, repeats: int = 1) -> Measurements:
    """Each joint at both of its stops, whose true angles are the limits of the URDF."""
    rng = np.random.default_rng(seed)
    rows, joints = [], []
    for _ in range(repeats):
        for j, name in enumerate(arm.joint_names):
            for stop in column_limits(arm)[j]:
                q = rng.uniform(-1.0, 1.0, len(arm.joint_names))
                q[j] = stop - ZEROS[j] + noise * rng.normal()
                rows.append((name, stop))
                joints.append(q)
    count = len(rows)
    return Measurements(
        joint_names=arm.joint_names,
        joints=np.array(joints),
        points=np.full((count, 3), np.nan),
        kinds=("stop",) * count,
        targets=tuple(name for name, _ in rows),
        readings={"stop": np.array([stop for _, stop in rows])},
        sigma={"rad": np.full(count, max(noise, 1e-4))},
    )


def test_zeros_are_those_of_the_truth_and_what_stays_open_is_named(arm: Robot, tmp_path: Path):
    result = calibrate("so101", stops(arm))
    assert result.model.name == "zeros"
    np.testing.assert_allclose(result.geometry.x, ZEROS, atol=1e-6)
    (alone,) = [r for r in result.verdict.reasons if r.why is Why.STOPS_ALONE]
    assert alone.values["joints"] == ", ".join(arm.joint_names)
    assert alone.values["not_stopped"] == ["gripper"]
    assert result.verdict.use == "use with care"

    # By Pinocchio alone: the written URDF at readings is the nominal one at true angles.
    path = result.write_urdf(tmp_path / "zeros.urdf")
    tips = []
    for data, offset in ((path.read_text(), 0.0), (arm.urdf.data.decode(), ZEROS)):
        model = pin.buildModelFromXML(data)
        q = pin.neutral(model)
        for j, name in enumerate(arm.joint_names):
            q[model.joints[model.getJointId(name)].idx_q] = 0.1 * j + np.broadcast_to(offset, 5)[j]
        frames = model.createData()
        pin.framesForwardKinematics(model, frames, q)
        tips.append(frames.oMf[model.getFrameId(arm.tip)].homogeneous)
    np.testing.assert_allclose(tips[0], tips[1], atol=1e-6)


@pytest.mark.slow
def test_their_uncertainty_is_that_of_the_stops(arm: Robot):
    """Errors over their bound sigma / sqrt(n): 4 stops a joint, 60 draws of five joints."""
    noise = 1e-3
    squares = []
    for seed in range(60):
        table = stops(arm, noise, seed, repeats=2)
        result = calibrate("so101", table, model="zeros", validate=False)
        squares.append((result.geometry.x - ZEROS) ** 2 / (noise**2 / 4.0))
    assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, abs=0.1)


def test_stops_and_points_are_fitted_together(arm: Robot):
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.0, 1.0, (12, 5))
    target = np.array([0.02, 0.01, 0.03])
    T = arm.poses(q + ZEROS)
    points = T[:, :3, 3] + T[:, :3, :3] @ target
    of_stops = stops(arm)
    n = len(of_stops)
    both = Measurements(
        joint_names=arm.joint_names,
        joints=np.vstack([q, of_stops.joints]),
        points=np.vstack([points, np.full((n, 3), np.nan)]),
        kinds=("point",) * 12 + of_stops.kinds,
        targets=("target",) * 12 + of_stops.targets,
        readings={"stop": np.append(np.full(12, np.nan), of_stops.readings["stop"])},
    )
    result = calibrate("so101", both, cell=Cell(model="zeros"), validate=False)
    np.testing.assert_allclose(result.geometry.x[:5], ZEROS, atol=1e-6)
    place = result.setup.targets.index("target")
    np.testing.assert_allclose(result.setup.T_tip_target[place, :3, 3], target, atol=1e-6)


def test_a_stop_of_no_joint_is_refused(arm: Robot):
    wrong = replace(stops(arm), targets=("elbow",) * 10)
    with pytest.raises(UrdfError, match="no joint 'elbow'"):
        calibrate("so101", wrong)
