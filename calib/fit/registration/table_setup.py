"""The measurement setup that a cell states for a table: which frames and targets there are, and which are estimated."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers, read_only
from calib.data.cell import Cell
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.errors import ModelError, choices
from calib.fit.registration.rows import NONE
from calib.fit.registration.setup import Setup
from calib.model.error_model import DIRECTIONS


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    """The frame of one group, as the cell states it or its kinds of rows imply it."""

    #: Directions that are estimated: "x" ... "rz"
    unknown: tuple[str, ...]
    #: (4, 4), pose of the base in the frame, identity where none is given [m]
    T_frame_base: Array
    #: True if the pose was given, or nothing of it is estimated
    given: bool
    #: True if the directions are along the frame's own axes (planes); else they are along the base's
    own_axes: bool


def measurement_setup(
    cell: Cell,
    measurements: Measurements,
    kinds: tuple[Kind, ...],
    kind_of_row: Integers,
) -> Setup:
    """Make the setup of a table: poses as the cell gives them, identity where it gives none.

    Args:
        cell: Frames and targets that are given, and whether they are estimated.
        measurements: Table of N rows; its groups are the stations.
        kinds: The kinds of its rows.
        kind_of_row: shape (N,), index of each row's kind in ``kinds``; `NONE` for the second row of a pair.

    Returns:
        One frame for each group and one target for each name, in the order in which they first occur; not registered.

    Raises:
        ModelError: The cell names a group or target that the table lacks.
    """
    groups = tuple(dict.fromkeys(measurements.groups))
    targets = tuple(dict.fromkeys(measurements.targets))
    _check_names(measurements, "group", cell.frames, groups)
    _check_names(measurements, "target", cell.targets, targets)
    group_of_row = np.array([groups.index(group) for group in measurements.groups])
    frames = []
    for g, group in enumerate(groups):
        of_group = np.unique(kind_of_row[group_of_row == g])
        kinds_of_group = [kinds[k] for k in of_group.tolist() if k != NONE]
        frames.append(_frame(cell, group, kinds_of_group))
    positions = [cell.targets.get(name, cell.target) for name in targets]
    rotation = any(kind.depends_on_orientation for kind in kinds)
    return Setup(
        groups=groups,
        targets=targets,
        T_frame_base=read_only([frame.T_frame_base for frame in frames]),
        T_tip_target=read_only(_target_poses(positions, cell.target_rotation)),
        unknown=tuple(frame.unknown for frame in frames),
        frame_given=np.array([frame.given for frame in frames]),
        target_unknown=np.full(len(targets), cell.estimate_target),
        target_given=np.array([position is not None for position in positions]),
        rotation=rotation,
        own_axes=np.array([frame.own_axes for frame in frames]),
        oriented=cell.target_rotation is not None or rotation,
    )


def _frame(cell: Cell, group: str, kinds: list[Kind]) -> _Frame:
    """The frame of a group: its pose as given, and its directions that are estimated.

    Args:
        cell: Frames that are given, and whether they are estimated.
        group: Name of the group.
        kinds: Kinds of the group's rows.
    """
    locating = [kind for kind in kinds if kind.directions]
    given = cell.frames.get(group, cell.T_frame_base)
    # Frames of sockets, planes and anchors are estimated unless the cell gives this group's.
    part_of_scene = group not in cell.frames and all(kind.own_frame for kind in locating)
    directions = _estimated_directions(cell, locating, part_of_scene)
    return _Frame(
        unknown=directions,
        T_frame_base=np.eye(4) if given is None else given,
        given=given is not None or not directions,
        own_axes=part_of_scene and any(kind.own_axes for kind in locating),
    )


def _check_names(
    measurements: Measurements,
    column: str,
    given: Collection[str],
    present: tuple[str, ...],
) -> None:
    """Raise `ModelError` for names that a cell gives and the table's column lacks.

    Args:
        measurements: The table, for its name in the message.
        column: Name of the column, "group" or "target".
        given: Names in the cell.
        present: Names in the column.
    """
    missing = [name for name in given if name not in present]
    if missing:
        table = measurements.source or "Measurements"
        raise ModelError(
            f"{table}: the cell says where {choices(missing)} is; the table's column '{column}' has "
            f"{choices(present)}."
        )


def _estimated_directions(cell: Cell, locating: list[Kind], part_of_scene: bool) -> tuple[str, ...]:
    """Directions of a group's frame that are estimated, of those that its kinds of rows depend on.

    Args:
        cell: Says whether frames are estimated, and in which directions.
        locating: Kinds of the group's rows that depend on its frame.
        part_of_scene: True for a socket, plane or anchor whose frame the cell does not give: all is estimated.

    Returns:
        Some of "x", "y", "z", "rx", "ry", "rz".
    """
    observable = {direction for kind in locating for direction in kind.directions}
    observed = [direction for direction in DIRECTIONS if direction in observable]
    if part_of_scene:
        return tuple(observed)
    if not cell.estimate_frame:
        return ()
    return tuple(direction for direction in cell.frame_directions if direction in observed)


def _target_poses(positions: list[Array | None], rotation: Array | None) -> Array:
    """Pose of each target in the tip, shape (T, 4, 4) [m]; the tip's own where nothing is given.

    Args:
        positions: Position of each of T targets in the tip, shape (3,) [m]; None where not given.
        rotation: shape (3, 3), orientation of all targets in the tip, R_tip_target; None where not given.
    """
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    for T, position in zip(poses, positions, strict=True):
        if position is not None:
            T[:3, 3] = position
        if rotation is not None:
            T[:3, :3] = rotation
    return poses
