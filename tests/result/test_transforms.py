"""Transforms between frames, targets, links and robots: against the truth, and their covariance by Monte Carlo."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.basics.arrays import rigid_inverse
from calib.errors import ModelError
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.result.transforms import body_of, known_transforms, transform
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from calib.verbs.calibrate.tables import transforms
from tests.two_handed import CELL, fitted, two_handed


@pytest.fixture(scope="module")
def truth():
    return two_handed(1)


@pytest.fixture(scope="module")
def result():
    return fitted(1)


def error(T: np.ndarray, T_true: np.ndarray) -> np.ndarray:
    """The displacement and rotation, along the axes of ``from``, that take a true pose to another one."""
    turn = pin.log3(T[:3, :3] @ T_true[:3, :3].T)
    return np.concatenate([T[:3, 3] - T_true[:3, 3], turn])


def drawn(c: Calibration, start: str, end: str, x: np.ndarray) -> np.ndarray:
    """T_start_end at other parameters x, by poses that the model and the corrected URDF have."""
    model, kinematics = c.model, c.geometry.kinematics
    displacements, _ = model.displacements(x)
    by_place = dict(zip(model.places, displacements, strict=True))
    poses = {}
    for f, name in enumerate(c.setup.groups):
        T_frame_base = kinematics.T_frame_base[f] @ by_place["(frame)" + name]
        poses[name] = rigid_inverse(T_frame_base)
    T_right = c.nominal.urdf.joint("right/mount").T_parent_joint
    poses["right"] = T_right @ by_place["right/mount"]
    for t, name in enumerate(c.setup.targets):
        poses[name] = kinematics.T_tip_target[t] @ by_place["(target)" + name]
    for name in ("panda_link0", "panda_link8"):
        poses[name] = np.eye(4)
    return rigid_inverse(poses[start]) @ poses[end]


@pytest.mark.parametrize(
    ("start", "end"),
    [
        ("t1", "t2"),
        ("t2", "right"),
        ("right", "t1"),
        ("panda_link0", "t1"),
        ("t1", "panda_link0"),
        ("a", "panda_link8"),
    ],
)
def test_pose_and_covariance_are_those_of_drawn_parameters(result, start, end):
    found = transform(result, start, end)
    np.testing.assert_allclose(
        found.pose, drawn(result, start, end, result.geometry.x), rtol=0.0, atol=1e-12
    )
    rng = np.random.default_rng(2)
    # Small enough to be linear, whatever the covariance.
    small = 1e-3
    change = small * rng.multivariate_normal(
        np.zeros(len(result.geometry.x)), result.covariance, size=300, method="cholesky"
    )
    errors = np.array(
        [error(drawn(result, start, end, result.geometry.x + dx), found.pose) for dx in change]
    )
    if start == "a":
        # A point has the orientation of its link.
        assert not found.covariance[3:].any()
        errors, expected = errors[:, :3], found.covariance[:3, :3]
    else:
        expected = found.covariance
    by_scale = transform_by_scale(result, start, end)
    expected = expected - np.outer(by_scale, by_scale)[: len(expected), : len(expected)]
    # Whitened errors have the identity as covariance, within what 300 draws scatter.
    white = np.linalg.solve(np.linalg.cholesky(expected), errors.T / small)
    np.testing.assert_allclose(white @ white.T / len(change), np.eye(len(expected)), atol=0.3)


def transform_by_scale(c: Calibration, start: str, end: str) -> np.ndarray:
    """Displacement and rotation by the scale error of the instrument, by a finite difference."""
    step = 1e-3
    ends = [
        drawn(c, start, end, c.geometry.x + sign * step * c.geometry.change_by_scale)
        for sign in (-1.0, 1.0)
    ]
    return error(ends[1], ends[0]) / (2.0 * step)


@pytest.mark.slow
def test_covariances_hold_the_truth_of_other_arms():
    """The priors are those that the arms are drawn from: errors squared over their covariance are 6 on average."""
    squared = []
    for seed in range(100, 112):
        sample = two_handed(seed)
        result = calibrate(
            "panda", sample.measurements, cell=CELL, model="placement", validate=False, robust=False
        )
        for start, end in (("t1", "t2"), ("t2", "right")):
            found = transform(result, start, end)
            T_true = rigid_inverse(sample.poses[start]) @ sample.poses[end]
            e = error(found.pose, T_true)
            squared.append(e @ np.linalg.solve(found.covariance, e))
    # Of 12 draws of chi-squared with 6 degrees of freedom the mean scatters by 1.0; the scale error of the instrument
    # is an allowance, which this truth does not use.
    first, second = np.array(squared).reshape(-1, 2).mean(axis=0)
    assert 3.0 < first < 9.0
    assert 2.0 < second < 9.0


def test_the_truth_is_found(result, truth):
    found = result.transform("t1", "t2")
    T_true = rigid_inverse(truth.poses["t1"]) @ truth.poses["t2"]
    e = error(found.pose, T_true)
    assert (
        e @ np.linalg.solve(found.covariance, e) < 22.5
    )  # 99.9 % of chi-squared, 6 degrees of freedom
    assert np.linalg.norm(e[:3]) < 4e-4


def test_there_and_back_is_the_identity_with_the_same_uncertainty(result):
    there, back = result.transform("t2", "right"), result.transform("right", "t2")
    np.testing.assert_allclose(there.pose @ back.pose, np.eye(4), atol=1e-12)
    assert there.orientation_std == pytest.approx(back.orientation_std)


def test_known_transforms_are_of_robots_frames_and_pairs(result):
    pairs = [(one.from_name, one.to_name) for one in known_transforms(result)]
    assert pairs == [
        ("link:panda_link0", "robot:right"),
        ("link:panda_link0", "station:t1"),
        ("link:panda_link0", "station:t2"),
        ("station:t1", "station:t2"),
    ]


def test_of_one_frame_on_one_robot_there_are_none(default_result):
    assert list(known_transforms(default_result)) == []
    assert default_result.transform("base", "frame").pose == pytest.approx(
        rigid_inverse(default_result.T_frame_base)
    )


def test_names_and_bodies_that_do_not_fit_are_refused(result):
    assert body_of(result, "right/panda_link0") == "panda_link0"
    assert body_of(result, "right/panda_link8") == "right/panda_link7"
    with pytest.raises(ModelError, match="no station, target, robot or link 't3'"):
        result.transform("t3", "t1")
    with pytest.raises(ModelError, match=r"'panda_joint1'.*move between them"):
        result.transform("t1", "a")


def test_a_socket_has_no_pose(calibrated):
    _, c = calibrated("sockets")
    with pytest.raises(ModelError, match="do not determine the pose"):
        c.transform(c.setup.groups[0] or "frame", c.robot.base)


def test_the_links_of_two_robots_stand_in_their_own_urdfs_too(result, tmp_path):
    path = result.write_urdf(tmp_path / "cell.urdf", target_link=True, frame_link=True)
    q = np.full((1, 14), 0.2)
    right = Robot.load(tmp_path / "cell_right.urdf", "panda_link0", "calib_target_b")
    T_target = result.predict_poses(q, target="b", group="t1")[0]
    found = result.transform("t1", "right").pose @ right.poses(q[:, 7:])[0]
    np.testing.assert_allclose(found, T_target, atol=1e-9)
    whole = Robot.load(path, "calib_frame_t1", "calib_target_b")
    np.testing.assert_allclose(whole.poses(q[:, 7:])[0], T_target, atol=1e-9)
    first = read_urdf(str(tmp_path / "cell_first.urdf"))
    assert {"calib_target_a", "calib_frame_t1", "calib_frame_t2"} <= set(first.links)
    assert "calib_target_b" not in first.links


def test_the_table_lists_them_in_mm_and_deg(result):
    table = transforms(result)
    assert [row[0] for row in table.rows][-1] == "t1 to t2"
    found = result.transform("t1", "t2")
    np.testing.assert_allclose(table.rows[-1][1:4], found.pose[:3, 3])
    assert table.rows[-1][4] == pytest.approx(2.0 * found.position_std, rel=0.05)
