from __future__ import annotations

import numpy as np
import pytest

from calib.compensate.commands import _poses_to_send, commands
from calib.compensate.inverse import Matching, Solved, solve
from calib.compensate.nominal_actual import Arm, pair_of
from calib.compensate.program import Program
from tests.compensate.arms import off

#: Well inside the Panda's workspace [rad].
GOOD = np.array([0.3, -0.4, 0.2, -1.9, 0.4, 1.7, 0.5])

POSE = Matching("pose", 0.01)


@pytest.mark.parametrize("match", ["pose", "axis", "position"])
def test_a_redundant_arm_arrives_with_the_elbow_where_the_controller_puts_it(panda, match):
    true, matching = off(panda), Matching(match, 0.01)
    pair = pair_of(true, panda)
    wanted = panda.poses(GOOD)
    starts = Solved(GOOD[None], *pair.nominal.motion(GOOD[None]))
    solved = solve(pair.actual, wanted, starts.q, matching)
    T_send, left = _poses_to_send(pair, wanted, starts, solved, matching)
    assert left[0, 0] < 1e-12
    # Its own choice of the elbow would have cost this much.
    naive = solve(pair.nominal, pair.nominal.poses(solved.q), starts.q, POSE)
    assert matching.misses(pair.actual.poses(naive.q), wanted)[0, 0] > 1e-10
    controlled = solve(pair.nominal, T_send, starts.q, POSE)
    assert matching.misses(true.poses(controlled.q), wanted)[0, 0] < 1e-12


def test_a_controller_in_another_branch_is_noticed(ur3):
    # Where the nominal wrist is straight and the true one is not, either side is as near.
    q = np.radians([[-20.0, -80.0, 60.0, -70.0, v, 10.0] for v in np.linspace(-1.5, 1.5, 200)])
    found = commands(off(ur3), Program.of_joints(q), nominal=ur3)
    said = np.array([any("sent as a pose it may end" in w for w in one) for one in found.warnings])
    sent = solve(Arm.of(ur3, np.eye(4)), found.T_send[found.reached], q[found.reached], POSE).q
    off_by = POSE.misses(off(ur3).poses(sent), ur3.poses(q)[found.reached])
    # Next to a singularity controllers differ; what is told is the worst of two.
    assert (said[found.reached] >= (off_by.max(axis=1) > 1e-8)).all()
    assert (found.left_by_pose[found.reached][:, 0] >= off_by[:, 0] - 1e-9).all()
    assert 0 < said.sum() < 60
