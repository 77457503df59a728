"""Figures of what images cover: corners over the image, tilts and distances, joints between their limits."""

from __future__ import annotations

import numpy as np
import pytest

from calib.show.plotting import styled
from calib.verbs.calibrate.figure_coverage import corner_density, image_coverage, joint_coverage
from calib.verbs.calibrate.seen_corners import seen_corners
from tests.verbs.calibrate.seen import by_images, corners


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def test_corners_are_counted_in_cells_row_by_row():
    """Cells of 100 px: two corners in the second column of the first row, one at the foot on the right."""
    counts, along_u, along_v = corner_density(
        corners(np.zeros((3, 2)), measured=[[120, 30], [180, 90], [1199, 899]])
    )
    assert counts.shape == (9, 12)
    assert (counts[0, 1], counts[8, 11], counts.sum()) == (2, 1, 3)
    assert (along_u[0], along_u[-1], along_v[0], along_v[-1]) == (-0.5, 1199.5, -0.5, 899.5)


def test_tilts_and_distances_are_those_of_the_boards():
    c = by_images()
    (seen,) = seen_corners(c)
    tilt, facing, distance = seen.board_views()
    density, _, tilts, distances = image_coverage(c).axes
    np.testing.assert_allclose(tilts.lines[0].get_xdata(), facing)
    np.testing.assert_allclose(tilts.lines[0].get_ydata(), np.degrees(tilt))
    assert sum(bar.get_height() for bar in distances.patches) == len(distance) == 10
    counts, _, _ = corner_density(seen)
    assert len(density.lines[0].get_xdata()) == np.count_nonzero(counts == 0)


def test_spans_of_joints_are_between_their_limits():
    """From the hand to the base the chain has joint 7 first; the figure has joint 1 first."""
    c = by_images()
    (ax,) = joint_coverage(c).axes
    assert [label.get_text() for label in ax.get_yticklabels()] == [
        f"panda_joint{k}" for k in range(1, 8)
    ]
    q = c.fit.measurements.joints_for(("panda_joint1",))[:, 0]
    joint = next(joint for joint in c.nominal.inputs if joint.name == "panda_joint1")
    _, span = ax.patches[:2]
    range_of_joint = joint.upper - joint.lower
    assert span.get_x() == pytest.approx(100 * (q.min() - joint.lower) / range_of_joint)
    assert span.get_width() == pytest.approx(100 * np.ptp(q) / range_of_joint)
    low, high = np.degrees([q.min(), q.max()])
    assert ax.texts[0].get_text() == f"{low:.0f} to {high:.0f}°"
