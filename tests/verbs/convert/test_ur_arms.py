"""The arms of Universal Robots: their rows, poses, hashes and bare URDFs against published ones."""

from __future__ import annotations

import numpy as np
import pytest

from calib.robot.generated.universal_robots import MODELS, chain_of_rows, ur_model
from calib.verbs.convert.ur_arms import at_flange, chain_poses, kinematics_hash, ur_robot
from calib.verbs.convert.ur_mount import the_mount
from tests.verbs.convert.ur_cases import CALIBRATIONS, CASES, rows

Q = np.random.default_rng(6).uniform(-2 * np.pi, 2 * np.pi, (100, 6))


by_name = pytest.mark.parametrize("case", CALIBRATIONS, ids=lambda case: case["name"])


@by_name
def test_poses_and_hash_of_factory_calibrations(case):
    full = rows(case["full_dh"])
    poses = chain_poses(chain_of_rows(full), case["fk"]["q"])
    np.testing.assert_allclose(poses, case["fk"]["T"], rtol=0, atol=1e-12)
    assert kinematics_hash(full) == case["driver_hash"]


@pytest.mark.parametrize("case", CASES["flange_positions"], ids=lambda case: case["test"][:22])
def test_universal_robots_own_test_points(case):
    pose = chain_poses(chain_of_rows(rows(case["dh"])), case["q"])[0]
    np.testing.assert_allclose(pose[:3, 3], case["xyz"], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", CASES["models"]["rows"])
def test_the_driver_s_hash_of_nominal_arms(name):
    # The hashes that Universal Robots publishes with its default kinematics.
    given = CASES["models"]["rows"][name]
    assert kinematics_hash(rows(given)) == given["default_hash"]
    assert kinematics_hash(ur_model(name).rows) == given["default_hash"]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_the_bare_urdf_has_the_rows_poses(model):
    robot = ur_robot(model)
    wanted = chain_poses(chain_of_rows(model.rows), Q)
    np.testing.assert_allclose(robot.poses(Q), wanted, rtol=0, atol=1e-12)
    mounted = the_mount(robot, model)
    assert mounted.nominal
    np.testing.assert_allclose(mounted.T_base_arm, np.eye(4), rtol=0, atol=1e-12)


@by_name
def test_the_frame_of_joint_six_is_brought_to_the_flange(case):
    chain = chain_of_rows(rows(case["full_dh"]))
    result = at_flange(chain)
    np.testing.assert_allclose(chain_poses(result, Q), chain_poses(chain, Q), rtol=0, atol=1e-9)
    assert result[6, 2, 3] == pytest.approx(0.0, abs=1e-12)
    assert result[6, 1, 0] == pytest.approx(result[6, 0, 1], abs=1e-9)
