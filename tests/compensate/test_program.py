from __future__ import annotations

import numpy as np
import pytest

from calib.compensate.program import Program
from calib.errors import ModelError
from tests.compensate.arms import turned


def test_of_joint_values():
    program = Program.of_joints([[0.1, 0.2], [0.3, 0.4]])
    assert len(program) == 2
    assert program.labels == ("row 1", "row 2")
    assert program.T_wanted is None
    assert Program.of_joints([0.1, 0.2]).q.shape == (1, 2)


def test_of_poses_and_points():
    poses = Program.of_poses(turned(1), [0.1, 0.2])
    assert poses.T_wanted.shape == (1, 4, 4)
    assert poses.q.tolist() == [[0.1, 0.2]]
    assert poses.oriented
    points = Program.of_points([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    assert points.T_wanted[1, :3, 3].tolist() == [4.0, 5.0, 6.0]
    assert not points.oriented


def test_its_arrays_are_its_own():
    q = np.zeros((2, 3))
    program = Program.of_joints(q)
    q[:] = 1.0
    assert program.q.max() == 0.0
    with pytest.raises(ValueError, match="read-only"):
        program.q[0, 0] = 1.0


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Program(("row 1",)), "neither joint values nor poses"),
        (lambda: Program((), q=np.zeros((0, 2))), "no rows"),
        (
            lambda: Program(("row 1",), q=np.zeros((2, 2))),
            r"joint values .* shape \(2, 2\); \(N, m\) .* N = 1",
        ),
        (lambda: Program(("row 1",), T_wanted=np.eye(4)), r"poses .* shape \(4, 4\); \(N, 4, 4\)"),
        (lambda: Program.of_joints([[0.0, np.nan]]), "joint values of row 1 .* not all finite"),
        (
            lambda: Program.of_points([[0, 0, 0], [0, np.inf, 0]]),
            "poses of row 2 .* not all finite",
        ),
        (lambda: Program.of_poses(2.0 * np.eye(4)), "The pose of row 1 of a program is none"),
        (lambda: Program.of_poses(np.diag([1.0, 1.0, -1.0, 1.0])), "The pose of row 1"),
        (lambda: Program.of_poses([np.eye(4), np.zeros((4, 4))]), "The pose of row 2"),
    ],
)
def test_what_is_no_program_is_refused(make, said):
    with pytest.raises(ModelError, match=said):
        make()
