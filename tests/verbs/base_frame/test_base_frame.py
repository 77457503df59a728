"""Circle-point analysis of a whole robot, and everything that a sweep may not be."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from calib.basics.arrays import rigid_inverse
from calib.basics.json_files import json_bytes
from calib.errors import MeasurementError
from calib.robot.robot import Robot
from calib.verbs.base_frame.axes import between, nominal_axes
from calib.verbs.base_frame.base_frame import base_frame
from calib.verbs.base_frame.sweeps import Sweep, Sweeps
from tests.verbs.base_frame.virtual_sweeps import virtual_sweeps

T_TRUE = pin.exp6(np.array([2.0, 1.0, -0.5, 0.3, -0.8, 1.2])).homogeneous
ARCS = np.radians([270.0, 180.0, 200.0])
HOME = np.array([0.3, -0.5, 0.7, -0.2, 0.4, 0.1])
SIGMA = 33e-6


@pytest.fixture(scope="module")
def with_values(ur3) -> Sweeps:
    return virtual_sweeps(ur3, T_TRUE, SIGMA, arcs=ARCS)


@pytest.fixture(scope="module")
def without(ur3) -> Sweeps:
    return virtual_sweeps(ur3, T_TRUE, SIGMA, arcs=ARCS, values=False)


def other(sweeps: Sweeps, at: int, **changes: object) -> Sweeps:
    """The sweeps with one changed."""
    changed = list(sweeps.sweeps)
    changed[at] = replace(changed[at], **changes)
    return replace(sweeps, sweeps=tuple(changed))


def only(sweeps: Sweeps, *chosen: Sweep) -> Sweeps:
    return replace(sweeps, sweeps=chosen)


def error(T: np.ndarray, wanted: np.ndarray = T_TRUE) -> np.ndarray:
    return np.asarray(pin.log6(rigid_inverse(T) @ wanted).vector)


@pytest.mark.parametrize(("base", "home"), [("base", None), ("base_link", HOME)])
def test_the_frame_is_the_urdf_s_base_wherever_the_joints_stand(base: str, home):
    robot = Robot.load("ur3", base=base, tip="tool0")
    sweeps = virtual_sweeps(robot, T_TRUE, 0.0, arcs=np.full(6, 2.0), home=home)
    found = base_frame(sweeps, robot)
    assert np.abs(error(found.T_tracker_base)).max() < 1e-8
    for pair in found.pairs:
        assert pair.angle == pytest.approx(pair.angle_nominal, abs=1e-7)
        assert pair.distance == pytest.approx(pair.distance_nominal, abs=1e-8)
    assert len(found.pairs) == 5


def test_without_a_robot_it_is_the_paper_s_frame(ur3, without):
    exact = virtual_sweeps(ur3, T_TRUE, 0.0, arcs=ARCS, values=False)
    found = base_frame(exact).T_tracker_base
    # Axis 2 of a UR points along -y of its `base`.
    assert np.abs(error(found, T_TRUE @ np.diag([-1.0, -1.0, 1.0, 1.0]))).max() < 1e-8
    assert np.isnan(base_frame(without).pairs[0].angle_nominal)


def test_axes_are_where_they_are_in_both_frames(ur3, with_values):
    found = base_frame(with_values, ur3)
    for joint, line in zip(found.joints, nominal_axes(ur3), strict=False):
        assert np.linalg.norm(joint.direction - line.direction) < 5e-4
        off = joint.point - line.point
        assert np.linalg.norm(off - line.direction * (off @ line.direction)) < 3e-4
        T = found.T_base_tracker
        seen = T[:3, :3] @ joint.circle.point + T[:3, 3]
        assert seen == pytest.approx(joint.point, abs=1e-12)
    assert found.findings == ()


@pytest.mark.slow
def test_standard_deviations_are_the_scatter_of_many_surveys(ur3):
    arcs = np.radians([270.0, 180.0, 180.0])
    runs = [
        base_frame(virtual_sweeps(ur3, T_TRUE, SIGMA, arcs=arcs, home=HOME, seed=seed), ur3)
        for seed in range(120)
    ]
    for name in ("angle", "distance"):
        stated = np.mean(
            [[getattr(pair, f"{name}_std") for pair in run.pairs] for run in runs], axis=0
        )
        found = np.std([[getattr(pair, name) for pair in run.pairs] for run in runs], axis=0)
        assert found == pytest.approx(stated, rel=0.35)
    for k in range(3):
        points = np.array([np.r_[run.joints[k].point, run.joints[k].direction] for run in runs])
        std = np.sqrt(np.diag(np.mean([run.joints[k].covariance for run in runs], axis=0)))
        # What the base's own definition fixes has no scatter, but for rounding.
        assert points.std(axis=0)[std > 1e-8] == pytest.approx(std[std > 1e-8], rel=0.3)


def test_true_offsets_are_found(ur3):
    placements = ur3.placements.copy()
    placements[2] = placements[2] @ pin.exp6(np.array([1e-3, 0, 2e-3, 0, 3e-3, 0])).homogeneous
    true = ur3.with_placements(placements)
    pairs = base_frame(virtual_sweeps(true, T_TRUE, 1e-6, arcs=np.full(6, 3.0)), ur3).pairs
    for pair, two in zip(pairs, pairwise(nominal_axes(true)), strict=True):
        assert (pair.angle, pair.distance) == pytest.approx(between(*two), abs=5e-5)
    assert abs(pairs[1].distance - pairs[1].distance_nominal) > 5e-4


def test_the_table_has_everything(ur3, with_values):
    found = base_frame(with_values, ur3)
    table = json.loads(json_bytes(found.table()))
    assert table["schema"] == "base-frame 2"
    assert np.array_equal(table["frame"]["T_tracker_base"], found.T_tracker_base)
    joint = table["joints"][1]
    assert joint["name"] == ur3.joint_names[1]
    assert joint["base"]["point_m"] == found.joints[1].point.tolist()
    assert np.shape(joint["circle"]["residuals_m"]) == (40, 2)
    assert table["pairs"][0]["angle_nominal"] == pytest.approx(np.pi / 2)
    assert table["findings"] == []


def test_the_offset_lowers_the_origin(ur3, with_values):
    frame = base_frame(with_values, ur3).T_tracker_base
    lowered = base_frame(with_values, ur3, plane_offset=0.01905).T_tracker_base
    assert error(lowered, frame) == pytest.approx([0, 0, 0.01905, 0, 0, 0], abs=1e-4)


def elbow_for_lift(sweeps: Sweeps) -> Sweeps:
    plane, first, _, third = sweeps.sweeps
    return only(sweeps, plane, first, replace(third, joint=1, name="joint 2"))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            elbow_for_lift,
            "'shoulder_lift_joint' 0 deg, 'elbow_joint' 200 deg",
        ),
        (
            lambda s: other(s, 3, joints=-s.sweeps[3].joints),
            "'shoulder_lift_joint', 'elbow_joint' are 180.0 deg .* turns the other way round",
        ),
        (
            lambda s: other(s, 2, points=np.roll(s.sweeps[2].points, 7, axis=0)),
            "the points turn otherwise than the joint's column says, by",
        ),
    ],
)
def test_what_is_refused_with_joint_values(ur3, with_values, change, said: str):
    with pytest.raises(MeasurementError, match=said):
        base_frame(change(with_values), ur3)


def test_a_z_that_points_down_is_refused_where_only_the_order_tells(ur3, without):
    down = other(without, 1, points=without.sweeps[1].points[::-1])
    for robot in (None, ur3):
        with pytest.raises(MeasurementError, match="joint 1 turns the other way round"):
            base_frame(down, robot)
