from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import ModelError
from calib.formats.ur_arms import (
    COLUMNS,
    MODELS,
    FullDH,
    at_flange,
    chain_poses,
    fitted_rows,
    kinematics_hash,
    ur_model,
    ur_robot,
)
from calib.formats.ur_mount import recognised
from calib.robot.readback import check_written
from tests.formats.ur_cases import CALIBRATIONS, CASES, WITH_DELTAS, rows

Q = np.random.default_rng(6).uniform(-2 * np.pi, 2 * np.pi, (100, 6))

by_name = pytest.mark.parametrize("case", CALIBRATIONS, ids=lambda case: case["name"])


@by_name
def test_poses_of_factory_calibrations(case):
    poses = rows(case["full_dh"]).poses(case["fk"]["q"])
    np.testing.assert_allclose(poses, case["fk"]["T"], rtol=0, atol=1e-12)


@pytest.mark.parametrize("case", CASES["flange_positions"], ids=lambda case: case["test"][:22])
def test_universal_robots_own_test_points(case):
    pose = rows(case["dh"]).poses(case["q"])[0]
    np.testing.assert_allclose(pose[:3, 3], case["xyz"], rtol=0, atol=1e-12)


@by_name
def test_the_driver_s_hash_of_a_calibration(case):
    assert kinematics_hash(rows(case["full_dh"])) == case["driver_hash"]


@pytest.mark.parametrize("name", CASES["models"]["rows"])
def test_the_driver_s_hash_of_nominal_arms(name):
    # The hashes that Universal Robots publishes with its default kinematics.
    given = CASES["models"]["rows"][name]
    assert kinematics_hash(rows(given)) == given["default_hash"]
    assert ur_model(name).default_hash == given["default_hash"]


@pytest.mark.parametrize("case", WITH_DELTAS, ids=lambda case: case["name"])
def test_nominal_plus_deltas_is_the_full_table(case):
    full = rows(case["nominal"]) + rows(case["delta"])
    for name in COLUMNS:
        np.testing.assert_allclose(getattr(full, name), case["full_dh"][name], rtol=0, atol=1e-13)


@by_name
def test_the_chain_has_the_rows_poses(case):
    full = rows(case["full_dh"])
    np.testing.assert_allclose(chain_poses(full.chain(), Q), full.poses(Q), rtol=0, atol=1e-12)


@by_name
def test_rows_come_back_out_of_a_chain(case):
    full = rows(case["full_dh"])
    fitted = fitted_rows(full.chain(), ur_model(case["robot"] or "UR10e").nominal, like=full)
    np.testing.assert_allclose(fitted.rows.poses(Q), full.poses(Q), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(fitted.T_base, np.eye(4))
    np.testing.assert_array_equal(fitted.T_tool, np.eye(4))
    if case["name"] != "doc_artificial":  # exactly parallel axes may share d otherwise
        for name in COLUMNS:
            np.testing.assert_allclose(
                getattr(fitted.rows, name), getattr(full, name), rtol=0, atol=1e-12
            )


def test_without_rows_to_be_like_the_nominal_ones_choose():
    case = next(case for case in CALIBRATIONS if case["name"] == "ur10e")
    full = rows(case["full_dh"])
    nominal = ur_model("UR10e").nominal
    fitted = fitted_rows(full.chain(), nominal)
    np.testing.assert_allclose(fitted.rows.poses(Q), full.poses(Q), rtol=0, atol=1e-12)
    assert np.abs(fitted.rows.theta - nominal.theta).max() <= np.pi
    exact = fitted_rows(nominal.chain(), nominal)
    for name in COLUMNS:
        assert (getattr(exact.deltas, name) == 0.0).all()


@pytest.mark.parametrize("size", [1e-3, 1e-6])
def test_what_rows_cannot_hold_stands_beside_them(size):
    nominal = ur_model("UR5e").nominal
    twists = np.random.default_rng(4).normal(size=(7, 6)) * size
    chain = np.array(
        [P @ pin.exp6(t).homogeneous for P, t in zip(nominal.chain(), twists, strict=True)]
    )
    fitted = fitted_rows(chain, nominal)
    assert np.abs(fitted.T_base - np.eye(4)).max() > size / 10
    assert np.abs(fitted.T_tool - np.eye(4)).max() > size / 10
    # A displacement across the axis only: along and about it d and theta hold it.
    assert abs(fitted.T_base[:3, 3] @ fitted.T_base[:3, 2]) < 1e-15
    assert abs(fitted.T_tool[2, 3]) < 1e-15
    assert fitted.T_tool[1, 0] == pytest.approx(fitted.T_tool[0, 1], abs=1e-15)
    made = fitted.T_base @ fitted.rows.poses(Q) @ fitted.T_tool
    # Doubles hold d to a part in 1e16, and d is the arm's length over the angle between the axes.
    np.testing.assert_allclose(made, chain_poses(chain, Q), rtol=0, atol=1e-15 / size + 1e-13)


def test_axes_that_are_parallel_to_rounding_keep_the_nominal_d():
    nominal = ur_model("UR5e").nominal
    chain = np.array(nominal.chain())
    chain[2] = chain[2] @ pin.exp6(np.array([1e-3, 2e-3, 0, 1e-10, 0, 0])).homogeneous
    fitted = fitted_rows(chain, nominal)
    assert fitted.deltas.d[1] == 0.0
    assert np.abs(fitted.rows.d).max() < 1.0
    np.testing.assert_allclose(
        fitted.rows.poses(Q) @ fitted.T_tool, chain_poses(chain, Q), rtol=0, atol=1e-9
    )


def test_the_last_row_holds_a_and_alpha_where_they_are_all_there_is():
    nominal = ur_model("UR5e").nominal
    full = nominal + FullDH(np.full(6, 1e-3), np.full(6, 2e-3), np.full(6, 3e-3), np.full(6, 4e-3))
    fitted = fitted_rows(full.chain(), nominal)
    assert fitted.rows.a[5] == pytest.approx(2e-3, abs=1e-12)
    assert fitted.rows.alpha[5] == pytest.approx(4e-3, abs=1e-12)
    np.testing.assert_array_equal(fitted.T_tool, np.eye(4))


def test_the_sixth_frame_goes_to_the_flange():
    chain = np.array(ur_model("UR5e").nominal.chain())
    chain[6] = pin.exp6(np.array([1e-3, -2e-3, 5e-3, 0.0, 0.0, 0.3])).homogeneous
    moved = at_flange(chain)
    np.testing.assert_allclose(chain_poses(moved, Q), chain_poses(chain, Q), rtol=0, atol=1e-14)
    np.testing.assert_allclose(moved[6, :3, :3], np.eye(3), atol=1e-15)
    assert abs(moved[6, 2, 3]) < 1e-15
    assert np.abs(moved[6, :2, 3]).max() > 1e-4


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_rows_of_many_arms_are_near_the_nominal_ones(model):
    rng = np.random.default_rng(len(model.name))
    for size in 10 ** rng.uniform(-4.5, -2.7, 15):
        twists = rng.normal(size=(7, 6)) * size
        chain = np.array(
            [
                P @ pin.exp6(t).homogeneous
                for P, t in zip(model.nominal.chain(), twists, strict=True)
            ]
        )
        fitted = fitted_rows(chain, model.nominal)
        longest = np.abs(fitted.rows.d).max()
        made = fitted.T_base @ fitted.rows.poses(Q[:10]) @ fitted.T_tool
        np.testing.assert_allclose(
            made, chain_poses(chain, Q[:10]), rtol=0, atol=1e-13 + 3e-15 * longest
        )
        # Where theta wanders between near-parallel axes, the row behind them keeps its sense.
        assert np.abs(fitted.deltas.alpha).max() < 0.05
        assert np.abs(fitted.deltas.a[[0, 3, 4, 5]]).max() < 0.05
        assert np.abs(fitted.deltas.d[[0, 4, 5]]).max() < 0.05


Q = np.random.default_rng(8).uniform(-np.pi, np.pi, (20, 6))


@pytest.mark.parametrize("name", CASES["models"]["rows"])
def test_the_nominal_rows(name):
    given = CASES["models"]["rows"][name]
    for column in ("theta", "a", "d", "alpha"):
        assert getattr(ur_model(name).nominal, column).tolist() == given[column]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_the_bare_urdf_of_each_arm(model):
    robot = ur_robot(model)
    expected = model.nominal.poses(Q)
    np.testing.assert_allclose(robot.poses(Q), expected, rtol=0, atol=1e-14)
    assert model in recognised(robot)
    # Nominal numbers are the data sheet's, digit for digit.
    assert f'xyz="{model.nominal.a[1]} 0.0 0.0" rpy="0.0 0.0 0.0"'.encode() in robot.urdf.data
    limits = {joint.name: joint.upper for joint in robot.joints}
    assert limits["elbow_joint"] == np.pi
    assert limits["wrist_3_joint"] == 2 * np.pi


def test_two_readers_agree_on_the_bare_urdf():
    robot = ur_robot("UR5e")
    check_written(robot, ur_model("UR5e").nominal.poses(Q), Q)


@pytest.mark.parametrize("text", ["ur5e", "UR5E", " Ur_5-e"])
def test_a_name_in_any_spelling(text):
    assert ur_model(text).name == "UR5e"


def test_an_unknown_name_is_told_the_names():
    with pytest.raises(ModelError, match=r"'UR6' is not an arm .* 'UR3', .* 'UR30'\. .* urcontrol"):
        ur_model("UR6")
