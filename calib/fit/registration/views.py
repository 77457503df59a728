"""Views as poses: where a registration begins if no row alone says much.

What an instrument sees of a target at one pose of the robot, such as the corners of a board in an image, determines the
target's pose in the instrument (`calib.model.internals.Internals.view_poses`). Frames and targets are registered to
these poses first, in closed form, and from there to the rows themselves. So no guess of either is needed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Integers
from calib.errors import MeasurementError
from calib.fit.registration.rows import Rows


def views_as_poses(rows: Rows) -> tuple[Rows, Integers]:
    """Replace the rows of each view by the pose of the target that they show.

    Args:
        rows: N rows, of which some belong to views.

    Returns:
        One pose row for each view and the rows of other kinds, n in all, in the order of ``rows``; and for each the
        index, from 0, of the one of the N rows that it stands for, shape (n,): of a view its first row. A view that
        does not determine a pose, such as that of corners on a line, is left out.

    Raises:
        MeasurementError: No view determines a pose.
    """
    labels = np.column_stack([rows.blocks, rows.samples.frame, rows.samples.target])
    _, view = np.unique(labels, axis=0, return_inverse=True)
    view = view.reshape(-1)
    internals = rows.samples.internals
    assert internals is not None
    first: list[int] = []
    poses = []
    for kind in rows.present:
        if kind.internals is None:
            continue
        of_kind = rows.where(kind.__eq__)
        views = [np.flatnonzero(of_kind & (view == number)) for number in np.unique(view[of_kind])]
        seen = [(rows.measured[of_view, : kind.size], internals[of_view]) for of_view in views]
        for T_frame_target, of_view in zip(kind.internals.view_poses(seen), views, strict=True):
            if T_frame_target is not None:
                first.append(int(of_view[0]))
                poses.append(
                    np.concatenate([T_frame_target[:3, 3], T_frame_target[:3, :3].ravel()])
                )
    if not first:
        raise MeasurementError(
            "No image shows enough of a board to tell its pose: four corners that are not on a line."
        )

    pose = registry.get("pose")
    measured = np.zeros((len(rows), max(rows.measured.shape[1], pose.size)))
    measured[:, : rows.measured.shape[1]] = rows.measured
    measured[first] = 0.0
    measured[first, : pose.size] = poses
    kind_of_row = rows.kind.copy()
    kind_of_row[first] = len(rows.kinds)
    with_poses = replace(rows, kinds=(*rows.kinds, pose), kind=kind_of_row, measured=measured)
    mask = ~rows.has_views
    mask[first] = True
    return with_poses.select(mask), np.flatnonzero(mask)
