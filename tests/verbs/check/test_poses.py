"""Poses to check at: reachable, better than random ones, and further ones that decide."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.errors import ArgumentError, CalibError, ModelError
from calib.verbs.check.check import check
from calib.verbs.check.poses import check_poses, further_poses
from calib.verbs.plan.plan_file import read_poses
from tests.verbs.check.shop import JOINTS, paper_result, points

pytestmark = pytest.mark.slow


def test_poses_are_inside_the_fitted_ranges_and_are_written_as_a_plan(tmp_path: Path):
    result = paper_result()
    poses = check_poses(result, 3)
    low, high = result.rows.ranges.T
    assert poses.joints.shape == (3, 6)
    assert np.all(poses.joints >= low - 1e-9)
    assert np.all(poses.joints <= high + 1e-9)
    assert 0.3 < poses.probabilities[0] <= 1.0
    np.testing.assert_array_equal(poses.joints, check_poses(result, 3).joints)
    path = poses.write(tmp_path / "poses.csv", first_row=5)
    read = read_poses(path, result.robot)
    np.testing.assert_allclose(read.joints, poses.joints, atol=1e-12)
    assert read.last_row == 7
    more = check_poses(result, 5)
    assert more.probabilities[0] > poses.probabilities[0]


def test_a_joint_that_shows_is_named_at_the_poses():
    q = check_poses(paper_result(), 3).joints
    for k in (1, 2):
        zeros = tuple(8e-3 * np.eye(6)[k])
        c = check(paper_result(), points(q, zeros=zeros, noise=1.2e-4, seed=k))
        assert ("joint", JOINTS[k]) in [(f.code, f.name) for f in c.named]


def test_further_poses_decide():
    zeros = tuple(1.75e-3 * np.eye(6)[2])
    q = np.deg2rad(
        [
            [-23.88, -89.52, 56.38, -155.11, -39.03, 60.22],
            [-58.59, -61.89, 36.52, -162.08, 21.63, 114.22],
            [-28.69, -86.58, 77.64, -131.96, 47.38, 334.83],
        ]
    )
    first = check(paper_result(), points(q, zeros=zeros, noise=3e-5, seed=1))
    assert first.outcome == "undecided"
    assert len(first.named) > 1
    assert ("joint", "elbow_joint") in [(f.code, f.name) for f in first.named]
    more = further_poses(first)
    assert 1 <= len(more.joints) <= 3
    assert len(more.probabilities) == len(more.joints)
    assert more.needed in (None, len(more.joints))
    together = np.concatenate([q, more.joints])
    second = check(paper_result(), points(together, zeros=zeros, noise=3e-5, seed=1))
    true = [f.probability for f in second.findings if f.name == "elbow_joint"]
    before = [f.probability for f in first.findings if f.name == "elbow_joint"]
    assert true[0] > before[0]


def test_a_check_that_has_decided_needs_no_more():
    c = check(paper_result(), points())
    assert c.outcome == "nothing"
    with pytest.raises(ModelError):
        further_poses(c)


def test_wrong_numbers_are_refused():
    with pytest.raises(CalibError):
        check_poses(paper_result(), 0)
    with pytest.raises(ModelError):
        check_poses(paper_result(), 201)
    with pytest.raises(ArgumentError):
        check_poses(3.0)  # type: ignore[arg-type]
