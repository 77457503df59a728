"""Poses out of a plan or a table."""

import numpy as np
import pytest

from calib.data import paper_measurements
from calib.errors import MeasurementError
from calib.measure.pose_list import read_pose_list

HEADER = (
    "set,target,shoulder_pan_joint [deg],shoulder_lift_joint [deg],elbow_joint [deg],"
    "wrist_1_joint [deg],wrist_2_joint [deg],wrist_3_joint [deg],x [mm],y [mm],z [mm]"
)


def test_the_paper_s_table(ur3, paper_table):
    q, sets = read_pose_list(paper_measurements(), ur3)
    assert (q == paper_table.joints).all()
    assert sets == paper_table.sets
    assert not q.flags.writeable


def test_a_plan_that_is_not_filled_in_yet(ur3, tmp_path):
    path = tmp_path / "plan.csv"
    path.write_text(f"{HEADER}\nestimate,a,1,2,3,4,5,6,,,\nvalidate,a,2,3,4,5,6,7,,,\n")
    q, sets = read_pose_list(path, ur3)
    assert q == pytest.approx(np.radians([[1, 2, 3, 4, 5, 6], [2, 3, 4, 5, 6, 7]]))
    assert sets == ("estimate", "validate")


def test_targets_of_one_pose_are_one_pose_and_repeats_are_several(ur3, tmp_path):
    path = tmp_path / "table.csv"
    one, other = "1,2,3,4,5,6,9,9,9", "1,2,3,4,5,7,9,9,9"
    lines = [f"estimate,a,{one}", f"estimate,b,{one}", f"estimate,a,{one}", f"validate,b,{other}"]
    path.write_text("\n".join([HEADER, *lines, ""]))
    q, sets = read_pose_list(path, ur3)
    assert len(q) == 3
    assert sets == ("estimate", "estimate", "validate")


def test_a_joint_that_is_missing(ur3, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("elbow_joint [deg],x [mm]\n1,2\n2,3\n")
    with pytest.raises(MeasurementError, match="shoulder_pan_joint"):
        read_pose_list(path, ur3)


def test_a_single_pose_is_enough(ur3, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(f"{HEADER}\nestimate,a,1,2,3,4,5,6,,,\n")
    assert read_pose_list(path, ur3)[0].shape == (1, 6)
