"""Tags of a body: those that agree on its pose, by an unknown camera, and those that were misread."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.boards.bodies import tag_at
from calib.boards.corners.body_views import agreeing_tags
from calib.boards.corners.markers import Markers

SIZE = (1280, 960)

#: A cube of 80 mm with tags of 60 mm, seen on its corner: three faces.
LAYOUT = np.array(
    [
        tag_at(k, np.array(middle), np.array(rpy), 0.06)[1]
        for k, (middle, rpy) in enumerate(
            [
                ((0.0, 0.0, -0.04), (0.0, 0.0, 0.0)),
                ((0.04, 0.0, 0.0), (0.0, -np.pi / 2, 0.0)),
                ((0.0, -0.04, 0.0), (-np.pi / 2, 0.0, 0.0)),
                ((0.0, 0.0, 0.04), (np.pi, 0.0, 0.0)),
            ]
        )
    ]
)


def seen(focal: float, k1: float = 0.0) -> Array:
    """The pixels of all corners, shape (tags, 4, 2)."""
    R = Rotation.from_euler("xyz", [0.6, 0.7, 0.2]).as_matrix()
    points = LAYOUT @ R.T + np.array([0.02, -0.01, 0.4 * focal / 1100.0])
    xy = points[..., :2] / points[..., 2:]
    xy = xy * (1.0 + k1 * np.sum(xy**2, axis=-1, keepdims=True))
    return focal * xy + np.array([655.0, 470.0])


@pytest.mark.parametrize("focal", [500.0, 1100.0, 2500.0, 5000.0])
@pytest.mark.parametrize("k1", [0.0, -0.3])
def test_tags_agree_whatever_the_camera(focal: float, k1: float):
    markers = Markers(np.arange(3), seen(focal, k1)[:3])
    agrees = agreeing_tags(markers, LAYOUT, SIZE)
    assert agrees is not None
    assert agrees.all()


@pytest.mark.parametrize("misread", ["other face", "turned", "hidden face"])
def test_a_tag_that_was_misread_does_not(misread: str):
    corners = seen(1100.0)[:3].copy()
    ids = np.array([0, 1, 2])
    if misread == "other face":
        ids = np.array([0, 1, 3])
    elif misread == "turned":
        corners[2] = np.roll(corners[2], 1, axis=0)
    else:
        ids, corners = np.array([0, 1, 3]), seen(1100.0)[[0, 1, 3]]
    agrees = agreeing_tags(Markers(ids, corners), LAYOUT, SIZE)
    assert agrees is not None
    assert agrees.tolist() == [True, True, False]


def test_two_tags_that_disagree_are_no_body():
    corners = seen(1100.0)[:2].copy()
    corners[1] = np.roll(corners[1], 2, axis=0)
    assert agreeing_tags(Markers(np.arange(2), corners), LAYOUT, SIZE) is None


def test_one_tag_is_enough():
    agrees = agreeing_tags(Markers(np.array([1]), seen(1100.0)[1:2]), LAYOUT, SIZE)
    assert agrees is not None
    assert agrees.tolist() == [True]
