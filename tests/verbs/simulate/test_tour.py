"""Tours: the target, the group, the pose and the partner of each row."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.errors import CalibError
from calib.verbs.simulate.tour import Tour
from calib.verbs.simulate.truth import draw_truth

SETS = ("estimate",) * 4


@pytest.fixture
def truth(ur3):
    """A truth of two targets in two stations."""
    pose = np.eye(4)
    targets = {"A": np.array([0.0, 0.0, 0.1]), "B": np.array([0.0, 0.1, 0.1])}
    return draw_truth(ur3, cell=Cell(targets=targets, frames={"1": pose, "2": pose}))


def test_all_targets_are_measured_at_each_stop_and_poses_dealt_out_among_the_groups(truth):
    tour = Tour.of(truth, SETS, visits=2)
    assert len(tour) == 16
    assert tour.route.tolist() == [0, 1, 2, 3] * 2
    assert tour.stop.tolist() == np.repeat(np.arange(8), 2).tolist()
    assert tour.target.tolist() == [0, 1] * 8
    assert tour.group.tolist() == [0, 0, 1, 1] * 4
    assert tour.sets == ("estimate",) * 16
    assert set(tour.pairs) == {""}


def test_pairs_are_of_consecutive_poses_of_one_target(truth):
    tour = Tour.of(truth, SETS, paired=True)
    assert tour.partner.tolist() == [2, 3, 0, 1, 6, 7, 4, 5]
    assert tour.pairs[0] == tour.pairs[2] != tour.pairs[1]
    T = np.arange(8.0)[:, None, None] * np.ones((8, 4, 4))
    assert tour.with_partners(T)[:, :, 0, 0].tolist()[:2] == [[0.0, 2.0], [1.0, 3.0]]
    with pytest.raises(CalibError):
        Tour.of(truth, SETS[:3], paired=True)
