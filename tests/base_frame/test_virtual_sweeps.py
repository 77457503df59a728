"""Sweeps of a virtual robot, and sweeps as a file."""

import numpy as np
import pytest

from calib.base_frame.sweeps import read_sweeps
from calib.errors import FileError
from tests.base_frame.virtual_sweeps import virtual_sweeps, write_sweeps

ARCS = np.radians([270.0, 180.0, 90.0])


def test_targets_keep_their_distance_from_the_axis(ur3):
    sweeps = virtual_sweeps(ur3, np.eye(4), 0.0, arcs=ARCS, count=11, radius=0.2)
    plane, first, second, third = sweeps.sweeps
    assert np.abs(plane.points[:, 2]).max() == 0.0
    assert np.linalg.norm(plane.points, axis=1).max() <= 0.25
    assert np.linalg.norm(first.points[:, :2], axis=1) == pytest.approx(np.full(11, 0.2))
    assert first.points[:, 2] == pytest.approx(np.full(11, 0.1519))
    assert np.ptp(second.points[:, 1]) < 1e-9
    assert third.joints is not None
    assert np.ptp(third.joints, axis=0) == pytest.approx([0, 0, np.pi / 2, 0, 0, 0])


def test_the_same_seed_gives_the_same_points(ur3):
    def points(seed: int) -> np.ndarray:
        made = virtual_sweeps(ur3, np.eye(4), 1e-4, arcs=ARCS, seed=seed).sweeps
        return np.concatenate([s.points for s in made])

    assert np.array_equal(points(1), points(1))
    assert not np.array_equal(points(1), points(2))
    noise = (
        points(1)[20:]
        - np.concatenate(
            [s.points for s in virtual_sweeps(ur3, np.eye(4), 0.0, arcs=ARCS, seed=1).sweeps]
        )[20:]
    )
    assert noise.std() == pytest.approx(1e-4, rel=0.1)


@pytest.mark.parametrize("values", [True, False])
def test_a_file_keeps_every_digit(ur3, tmp_path, values: bool):
    made = virtual_sweeps(ur3, np.eye(4), 1e-4, arcs=ARCS, values=values, home=np.full(6, 0.1))
    path = write_sweeps(made, tmp_path / "s.csv")
    names = ur3.joint_names
    for was, now in zip(made.sweeps, read_sweeps(path, names).sweeps, strict=True):
        assert now.points == pytest.approx(was.points, abs=1e-15)
        assert (now.joint, now.rows) == (was.joint, was.rows)
        assert (now.joints is None) == (was.joints is None)
        if was.joints is not None:
            assert now.joints == pytest.approx(was.joints, abs=1e-15)
    with pytest.raises(FileError, match="exists already"):
        write_sweeps(made, path)
