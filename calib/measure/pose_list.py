"""Poses out of a plan or a measured table: the joint values, and which set each pose is of."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.measure.layout import Layout
from calib.measure.table import Table
from calib.measure.values import Values
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]


def read_pose_list(
    path: str | Path, robot: Robot, columns: Mapping[str, str] | None = None
) -> tuple[Array, tuple[str, ...]]:
    """The poses of a table, and the set of each; what was measured there is not read, and may be missing.

    Rows that measure another target at the same joint values are of one pose.

    Args:
        path: CSV with a column for each of ``robot.joint_names``, and a column ``set`` if there is one.
        robot: The robot.
        columns: Names of the table to names of calib, see `Measurements.read`.

    Returns:
        shape (N, m), [rad] or [m], read-only; and N words, ``"estimate"`` or ``"validate"``.

    Raises:
        MeasurementError: The table cannot be read, or lacks a joint.
    """
    # A row of this kind measures nothing but its joint values.
    table = Table.read(path)
    layout = Layout.find(table, robot.joint_names, robot.joint_types, columns, "fixed")
    values = Values.read(table, layout)
    joints = values.joints
    kept: list[int] = []
    seen: set[str] = set()
    for i, target in enumerate(values.targets):
        same = bool(kept) and np.array_equal(joints[i], joints[kept[-1]])
        if same and target not in seen:
            seen.add(target)
            continue
        kept.append(i)
        seen = {target}
    return read_only(joints[kept]), tuple(values.sets[i] for i in kept)
