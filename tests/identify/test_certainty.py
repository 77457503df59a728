from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.identify.certainty import certainty_of
from calib.identify.result_file import result_table
from calib.model.json_file import plain
from calib.model.parameters import FRAME
from calib.model.readback import random_joint_values
from tests.compensate.arms import stored
from tests.show.calibrations import made


@pytest.mark.parametrize("case", ["paper", "poses", "mixed", "prismatic", "two_joints"])
def test_a_target_is_as_sure_as_the_calibration_says(case):
    found, certainty = made(case), stored(case).certainty
    q = found.measurements.joints_for(found.nominal.joint_names)[:7]
    target = found.setup.targets[0]
    T = found.setup.T_tip_target[0]
    group = found.setup.groups[0]
    std = certainty.pose_std(found.nominal, q, T, target, group)
    assert std[:, 0] == pytest.approx(found.position_std(q, larger=False), rel=1e-3)
    assert (std > 0.0).all()
    # In the base the robot's place counts, which a frame that was estimated takes away.
    if np.any(found.model.family(FRAME)):
        assert (certainty.pose_std(found.nominal, q, T, target)[:, 0] > std[:, 0]).all()


def test_it_is_the_scatter_of_robots_drawn_from_the_covariance():
    found, certainty = made("paper"), stored("paper").certainty
    q = random_joint_values(found.nominal, 3)
    tool = np.eye(4)
    tool[:3, 3] = 0.05, 0.0, 0.1
    own = [k for k, name in enumerate(found.model.names) if not name.startswith("target")]
    rng = np.random.default_rng(0)
    spread = rng.multivariate_normal(np.zeros(len(own)), found.covariance[np.ix_(own, own)], 400)
    model = found.model.without([n for n in found.model.names if n.startswith("target")])
    points = np.array(
        [(model.apply(found.nominal, found.x[own] + d).poses(q) @ tool)[:, :3, 3] for d in spread]
    )
    scatter = np.sqrt(points.var(axis=0).sum(axis=1))
    expected = certainty.pose_std(found.nominal, q, tool)
    assert scatter == pytest.approx(expected[:, 0], rel=0.12)
    # One target says little of how the tip is turned: the angle stays as unsure as its priors left it.
    assert expected[:, 1].min() > 2e-3


def test_what_the_fit_did_not_see():
    certainty = stored("paper").certainty
    validation = made("paper").errors["calibrated"]["validation"]
    assert certainty.unseen.rows == "rows held back"
    assert certainty.unseen.n == 5
    assert certainty.unseen.rms == pytest.approx(validation.rms)
    assert (certainty.use, certainty.turned) == ("use", False)
    assert stored("poses").certainty.turned
    table = plain(result_table(made("paper")))
    table["errors"]["calibrated"]["validation"]["n"] = 0
    left_out = certainty_of(table).unseen
    assert left_out.rows == "left-out rows"
    assert left_out.rms == pytest.approx(made("paper").cross_validation.errors_without_outliers.rms)
    assert certainty_of({**table, "cross_validation": None}).unseen is None


def test_rows_outside_of_the_measured_range_are_named(ur3):
    certainty = stored("paper").certainty
    middle = certainty.ranges.mean(axis=1)
    beyond = middle.copy()
    beyond[2] = certainty.ranges[2, 1] + 0.5
    (row,) = certainty.outside(ur3, np.array([middle, beyond]))
    assert row.index == 1
    assert str(row.beyond[0]) == "'elbow_joint' 28.6 deg"
    nothing_known = replace(certainty, ranges=np.full((6, 2), np.nan))
    assert nothing_known.outside(ur3, np.array([beyond])) == ()


def test_a_result_that_does_not_say_has_none():
    from calib.identify.result_file import stored_result

    table = plain(result_table(made("paper")))
    del table["robot"]["ranges"]
    assert stored_result(table, "old.json").certainty is None
