"""Covariances of poses in tables: read, refused, written, and computed as docs/data-format.md shows."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.camera.board_pose import board_pose
from calib.camera.lenses import LENSES
from calib.data.columns import COVARIANCE
from calib.data.kinds import get, names
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from tests.covariances import random_covariances
from tests.data.tables import assert_same, refused, write_lines
from tests.test_docs_site import python


def poses(count=4, **more):
    rng = np.random.default_rng(1)
    return Measurements(
        joint_names=("a", "b"),
        joints=rng.uniform(-1, 1, (count, 2)),
        points=rng.uniform(0.1, 1, (count, 3)),
        rotations=Rotation.random(count, random_state=1).as_matrix(),
        kinds=("pose",) * count,
        **more,
    )


def lines_of(covariances, names=COVARIANCE, more="", cells=""):
    """A table of poses in m and quaternions, with columns of covariances and others."""
    header = f"a [deg],b [deg],x [m],y [m],z [m],qx,qy,qz,qw{more}," + ",".join(names)
    rows = [header]
    for k, C in enumerate(covariances):
        numbers = ",".join(f"{value:.9e}" for value in np.ravel(C)[: len(names)])
        rows.append(f"{10 + k},20,0.{3 + k},0.4,0.5,0,0,0,1{cells},{numbers}")
    return rows


def test_only_whole_poses_have_one():
    assert [name for name in names() if get(name).may_have_covariance] == ["pose"]


def test_a_table_of_covariances_is_read(tmp_path):
    C = random_covariances(np.random.default_rng(2), 3)
    m = Measurements.read(write_lines(tmp_path, *lines_of(C)))
    np.testing.assert_allclose(m.covariances, C, rtol=1e-9)
    assert m.kinds == ("pose",) * 3
    assert m.ignored == ()
    assert m.sigma == {}
    np.testing.assert_allclose(
        m.stated_sigma["m"] ** 2, np.trace(C[:, :3, :3], axis1=1, axis2=2) / 3.0, rtol=1e-9
    )
    np.testing.assert_allclose(
        m.stated_sigma["rad"] ** 2, np.trace(C[:, 3:, 3:], axis1=1, axis2=2) / 3.0, rtol=1e-9
    )


def test_what_is_written_is_read(tmp_path):
    C = random_covariances(np.random.default_rng(3), 4)
    C[2] = np.nan
    m = poses(covariances=C)
    m.select([True, True, False, True]).write(tmp_path / "some.csv")
    again = Measurements.read(tmp_path / "some.csv")
    np.testing.assert_array_equal(again.covariances, C[[0, 1, 3]])
    assert_same(again, replace(m.select([True, True, False, True]), source="some.csv"), 1e-14)
    np.testing.assert_array_equal(np.isnan(m.covariances[:, 0, 0]), [False, False, True, False])


def test_selected_rows_keep_theirs():
    C = random_covariances(np.random.default_rng(4), 4)
    m = poses(covariances=C)
    np.testing.assert_array_equal(m.select([False, True, False, True]).covariances, C[[1, 3]])


def test_rows_that_are_no_poses_have_none():
    C = random_covariances(np.random.default_rng(5), 4)
    m = replace(poses(), kinds=("pose", "point", "pose", "pose"), covariances=C)
    np.testing.assert_array_equal(np.isnan(m.covariances[:, 0, 0]), [False, True, False, False])
    sigma = {"m": np.full(4, 2e-4), "rad": np.full(4, 2e-3)}
    stated = replace(m, sigma=sigma).stated_sigma
    assert stated["m"][1] == 2e-4
    assert stated["m"][0] == pytest.approx(np.sqrt(np.trace(C[0, :3, :3]) / 3.0))
    assert replace(m, kinds=("point",) * 4, rotations=None).covariances is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda C: C * 0.0, "zero"),
        (lambda C: C * np.nan_to_num(np.tri(6), nan=0.0), "symmetric"),
        (lambda C: C - 2.0 * np.diag(np.diag(C)), "standard deviation"),
        (
            lambda C: (
                np.outer(np.sqrt(np.diag(C)), np.sqrt(np.diag(C))) * 1.0001
                - 1e-4 * np.diag(np.diag(C))
            ),
            "positive",
        ),
    ],
)
def test_what_is_no_covariance_is_refused(tmp_path, change, says):
    C = random_covariances(np.random.default_rng(6), 3)
    C[1] = change(C[1])
    refused(write_lines(tmp_path, *lines_of(C)), ["row 2", says])
    with pytest.raises(MeasurementError, match="row 2"):
        poses(3, covariances=C)


def test_a_few_digits_are_enough(tmp_path):
    C = random_covariances(np.random.default_rng(7), 2)
    rounded = [[float(f"{value:.6g}") for value in np.ravel(one)] for one in C]
    m = Measurements.read(write_lines(tmp_path, *lines_of(rounded)))
    np.testing.assert_allclose(m.covariances, C, rtol=1e-5)


def test_columns_that_are_missing_are_named(tmp_path):
    C = random_covariances(np.random.default_rng(8), 2)
    without_last = [one.ravel() for one in C]
    refused(
        write_lines(tmp_path, *lines_of(without_last, COVARIANCE[:-1])),
        ["covariance_0", "covariance_35"],
    )


def test_a_unit_is_refused(tmp_path):
    C = random_covariances(np.random.default_rng(9), 2)
    names = ("covariance_0 [mm]", *COVARIANCE[1:])
    refused(write_lines(tmp_path, *lines_of(C, names)), ["covariance_0 [mm]", "no unit"])


def test_covariances_of_millimetres_are_refused(tmp_path):
    C = random_covariances(np.random.default_rng(15), 3)
    in_mm = np.repeat([1e3, 1.0], 3)
    refused(write_lines(tmp_path, *lines_of(C * np.outer(in_mm, in_mm))), ["m^2", "1000"])


def test_an_empty_cell_is_refused(tmp_path):
    C = random_covariances(np.random.default_rng(10), 2)
    lines = lines_of(C)
    lines[2] = lines[2].rsplit(",", 1)[0] + ","
    refused(write_lines(tmp_path, *lines), ["row 2", "covariance_35"])


def test_standard_deviations_beside_covariances_are_not_used(tmp_path):
    C = random_covariances(np.random.default_rng(11), 2)
    lines = lines_of(C, more=",sigma [mm]", cells=",5")
    m = Measurements.read(write_lines(tmp_path, *lines))
    assert m.ignored == ("sigma [mm]",)
    assert m.stated_sigma["m"][0] < 1e-3


def test_tables_of_other_kinds_do_not_use_them(tmp_path):
    C = random_covariances(np.random.default_rng(12), 2)
    m = Measurements.read(write_lines(tmp_path, *lines_of(C)), kind="point")
    assert m.covariances is None
    assert set(COVARIANCE) <= set(m.ignored)


@pytest.mark.parametrize("shape", [(3, 3, 3), (6, 6), (4, 6, 6), (3, 36), ()])
def test_another_shape_is_refused(shape):
    for value in (1e-8, np.nan):
        with pytest.raises(MeasurementError, match="shape"):
            poses(3, covariances=np.full(shape, value))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_matrix_that_lacks_a_number_is_refused(value):
    C = random_covariances(np.random.default_rng(16), 3)
    C[1, 2, 3] = value
    with pytest.raises(MeasurementError, match="row 2"):
        poses(3, covariances=C)


def test_digits_that_differ_between_both_halves_are_averaged():
    C = random_covariances(np.random.default_rng(17), 2)
    other = C.copy()
    other[0, 4, 1] *= 1.0 + 1e-6
    kept = poses(2, covariances=other).covariances
    np.testing.assert_array_equal(kept, kept.transpose(0, 2, 1))
    assert kept[0, 1, 4] == pytest.approx((1.0 + 5e-7) * C[0, 1, 4], rel=1e-9)


def test_the_covariance_that_data_format_md_computes_is_that_of_the_pose():
    """Against calib's own, of a board that a camera with distortion sees tilted; from the scatter of poses too."""
    names: dict[str, object] = {}
    exec(compile(python("data-format.md"), "data-format.md", "exec"), names)
    grid = np.stack(np.meshgrid(np.arange(7), np.arange(5)), axis=2).reshape(-1, 2)
    board = np.column_stack([0.03 * grid, np.zeros(len(grid))])
    values = np.array([900.0, 905.0, 640.0, 360.0, -0.1, 0.05, 0.001, -0.0005, 0.01])
    K = np.array([[values[0], 0.0, values[2]], [0.0, values[1], values[3]], [0.0, 0.0, 1.0]])
    rvec, tvec = np.array([0.5, -0.3, 0.8]), np.array([-0.05, 0.02, 0.45])
    exact = cv2.projectPoints(board, rvec, tvec, K, values[4:])[0][:, 0]
    C = names["pose_covariance"](board, rvec, tvec, K, values[4:])
    own = board_pose(board, exact, LENSES["pinhole"], values)
    np.testing.assert_allclose(C, own.covariance, rtol=1e-4, atol=1e-6 * np.max(own.covariance))
    rng = np.random.default_rng(13)
    R = cv2.Rodrigues(rvec)[0]
    apart = []
    for _ in range(400):
        noisy = exact + 0.1 * rng.normal(size=exact.shape)
        _, r, t = cv2.solvePnP(board, noisy, K, values[4:], rvec.copy(), tvec.copy(), True)
        turn = Rotation.from_matrix(cv2.Rodrigues(r)[0] @ R.T).as_rotvec()
        apart.append([*(t.ravel() - tvec), *turn])
    e = np.array(apart)
    squares = np.einsum("ni,ij,nj->n", e, np.linalg.inv(0.01 * C), e)
    # Of 400 values with 6 degrees of freedom.
    assert np.mean(squares) == pytest.approx(6.0, abs=0.6)
