"""Frames and targets of a setup: the directions of their parameters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.model.error_model import frame_and_target_model
from calib.model.kinematics import Kinematics
from calib.model.parameters import ErrorModel
from calib.registration.table_rows import rows_and_setup
from tests.registration.tables import as_kind


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_planes_directions_move_it_wherever_it_faces(scene, ur3, axis):
    """Height and two tilts, of one metre and one radian a unit: no direction of a wall is lost."""
    quarter = {"x": ("y", -90), "y": ("x", 90), "z": ("z", 0)}[axis]
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler(*quarter, degrees=True).as_matrix()
    _, setup = rows_and_setup(ur3, as_kind(scene.points(4), "plane"), Cell())
    setup = setup.placed(T[None], setup.T_tip_target)
    plain = frame_and_target_model(setup.frame_unknowns, (), setup.target_names, rotation=False)
    model = setup.aligned(plain)
    assert model.names == plain.names == ("frame_z", "frame_rx", "frame_ry")
    names = tuple(joint.name for joint in scene.robot.joints)
    places = (model.places[0], *names, *model.places[1:])
    whole = ErrorModel("frames", places, model.parameters)
    kinematics = Kinematics(scene.robot, whole, T, np.eye(4))
    poses, twists = kinematics.twists(np.zeros(3), scene.samples(5))
    x, y, z = poses[:, :3, 3].T
    np.testing.assert_allclose(twists[:, 2, 0], 1.0, atol=1e-12)
    np.testing.assert_allclose(twists[:, 2, 1], y, atol=1e-12)
    np.testing.assert_allclose(twists[:, 2, 2], -x, atol=1e-12)
    assert np.ptp(z) > 0.01
