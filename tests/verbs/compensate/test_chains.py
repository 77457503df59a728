"""Commands for one chain of a result of several: the calibrated robot then reaches what was programmed."""

from __future__ import annotations

import numpy as np
import pytest

from calib.errors import ModelError, UrdfError
from calib.verbs.compensate.nominal_actual import chain_of_hand, pair_of
from tests.two_handed import JOINTS, fitted


def test_a_hand_is_named_by_its_link_its_target_or_the_tool():
    c = fitted()
    right = ("panda_link0", "right/panda_link8")
    assert chain_of_hand(c, "right/panda_link8", None) == right
    assert chain_of_hand(c, "b", None) == right
    assert chain_of_hand(c, None, "b") == right
    for hand in (None, "c", "panda_link4"):
        with pytest.raises(ModelError, match="several chains, to 'panda_link8', 'right/panda"):
            chain_of_hand(c, hand, None)


def test_the_calibrated_hand_reaches_the_programmed_target():
    c = fitted()
    pair = pair_of(c, tool="b")
    assert pair.nominal.robot.joint_names == tuple(f"right/{name}" for name in JOINTS)
    q = np.array([[0.3, -0.5, 0.2, -1.8, 0.1, 1.5, 0.4]])
    whole = np.concatenate([np.zeros((1, 7)), q], axis=1)
    T_frame_base = c.setup.T_frame_base[0]
    expected = np.linalg.inv(T_frame_base) @ c.predict_poses(whole, target="b")
    np.testing.assert_allclose(pair.actual.poses(q), expected, atol=1e-9)


def test_a_tool_on_the_other_hand_is_refused():
    c = fitted()
    left = c.nominal.rebuilt(None, "panda_link0", "panda_link8")
    with pytest.raises(ModelError, match="'b' is on 'right/panda_link8', but the chain ends at"):
        pair_of(c, left, tool="b")


def test_a_base_is_honoured_if_all_joints_from_it_were_calibrated():
    c = fitted()
    right = chain_of_hand(c, "b", None, "right/panda_link0")
    assert right == ("right/panda_link0", "right/panda_link8")
    nominal = c.nominal.rebuilt(None, *right)
    q = np.array([[0.3, -0.5, 0.2, -1.8, 0.1, 1.5, 0.4]])
    tool = pair_of(c, nominal, tool="b").actual.poses(q)
    # The hand in its own base does not know where that stands.
    whole = np.concatenate([np.zeros((1, 7)), q], axis=1)
    T_frame_base = c.setup.T_frame_base[0]
    T_root_tool = np.linalg.inv(T_frame_base) @ c.predict_poses(whole, target="b")
    T_root_base = c.robot.urdf.joint("right/mount").T_parent_joint
    np.testing.assert_allclose(T_root_base @ tool, T_root_tool, atol=1e-9)
    with pytest.raises(ModelError, match=r"no joint 'panda_finger_joint1'"):
        chain_of_hand(c, "b", None, "panda_leftfinger")
    with pytest.raises(UrdfError, match="'nolink'"):
        chain_of_hand(c, "b", None, "nolink")
