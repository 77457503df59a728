"""Programs: what they hold, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.errors import ModelError
from calib.verbs.compensate.robot_program import Program


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Program(("row 1",)), "joint values, of poses, or of both"),
        (lambda: Program.of_joints([[0.0, np.nan]]), "'q' has a number that is NaN"),
        (lambda: Program.of_poses([np.eye(4), 2.0 * np.eye(4)]), "T_wanted of a program"),
        (lambda: replace(Program.of_points(np.ones(3)), match="pose"), "cannot be matched"),
        (lambda: replace(Program.of_joints([0.0]), start={"a": 0.1}), "leave out the start"),
        (lambda: Program.of_poses(np.eye(4), [0.0], start={"a": 0.1}), "leave out the start"),
    ],
)
def test_what_is_no_program_is_refused(make, said):
    with pytest.raises(ModelError, match=said):
        make()


def test_poses_and_points_may_state_where_the_search_starts():
    start = {"a": 0.1, "b": -0.2}
    for program in (
        Program.of_poses(np.eye(4), start=start),
        Program.of_points(np.ones((2, 3)), start=start),
    ):
        assert program.start == start
        assert program.q is None
    assert Program.of_poses(np.eye(4)).start is None
