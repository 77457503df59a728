"""The measurement setup that a cell states for a table: which frames and targets there are, and which are estimated."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, Integers, read_only
from calib.data.cell import Cell
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.errors import ModelError, choices
from calib.fit.registration.rows import NONE
from calib.fit.registration.setup import Setup
from calib.instruments.internals import initial_internals
from calib.model.error_model import DIRECTIONS


def measurement_setup(
    cell: Cell,
    measurements: Measurements,
    kinds: tuple[Kind, ...],
    kind_of_row: Integers,
) -> Setup:
    """Make the setup of a table: poses as the cell gives them, identity if it gives none.

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
    T_frame_base = np.tile(np.eye(4), (len(groups), 1, 1))
    unknown = []
    frame_given = []
    own_axes = []
    for g, group in enumerate(groups):
        of_group = np.unique(kind_of_row[group_of_row == g])
        locating = [kinds[k] for k in of_group.tolist() if k != NONE and kinds[k].directions]
        # Frames of sockets, planes and anchors are estimated unless the cell gives this group's.
        part_of_scene = group not in cell.frames and all(kind.own_frame for kind in locating)
        directions = _estimated_directions(cell, locating, part_of_scene)
        given = cell.frames.get(group, cell.T_frame_base)
        if given is not None:
            T_frame_base[g] = given
        unknown.append(directions)
        frame_given.append(given is not None or not directions)
        own_axes.append(part_of_scene and any(kind.own_axes for kind in locating))

    positions = [cell.targets.get(name, cell.target) for name in targets]
    T_tip_target = np.tile(np.eye(4), (len(targets), 1, 1))
    for T, position in zip(T_tip_target, positions, strict=True):
        if position is not None:
            T[:3, 3] = position
        if cell.target_rotation is not None:
            T[:3, :3] = cell.target_rotation

    rotation = any(kind.depends_on_orientation for kind in kinds)
    return Setup(
        groups=groups,
        targets=targets,
        T_frame_base=read_only(T_frame_base),
        T_tip_target=read_only(T_tip_target),
        unknown=tuple(unknown),
        frame_given=np.array(frame_given),
        target_unknown=np.full(len(targets), cell.estimate_target),
        target_given=np.array([position is not None for position in positions]),
        rotation=rotation,
        own_axes=np.array(own_axes),
        oriented=cell.target_rotation is not None or rotation,
    )


def with_internals(
    setup: Setup, measurements: Measurements, cell: Cell, pose: Integers
) -> tuple[Setup, Array | None]:
    """Add the internals of the instruments to the setup of a table.

    Args:
        setup: The table's stations and targets.
        measurements: Table of N rows.
        cell: What is known of the instruments.
        pose: shape (N,), number of the robot's pose at each row.

    Returns:
        The setup, with the internals that are estimated; and the internals of each row before the fit, shape (N, c),
        None if the instruments have none.

    Raises:
        MeasurementError: What is known of an instrument is not enough, or contradicts its rows.
    """
    frames, targets = setup.places
    values, unknowns = initial_internals(
        measurements,
        cell,
        dict(zip(setup.groups, frames, strict=True)),
        dict(zip(setup.targets, targets, strict=True)),
        pose,
    )
    return replace(setup, internals=unknowns), values


def _check_names(
    measurements: Measurements,
    column: str,
    given: Collection[str],
    present: tuple[str, ...],
) -> None:
    """Raise `ModelError` for names that a cell gives and the table's column, "group" or "target", lacks."""
    missing = [name for name in given if name not in present]
    if missing:
        table = measurements.source or "Measurements"
        raise ModelError(
            f"{table}: the cell says where {choices(missing)} is; the table's column '{column}' has "
            f"{choices(present)}."
        )


def _estimated_directions(cell: Cell, locating: list[Kind], part_of_scene: bool) -> tuple[str, ...]:
    """Directions of a group's frame that are estimated, of those that its kinds of rows depend on.

    All of them are, for a socket, plane or anchor whose frame the cell does not give (``part_of_scene``).
    """
    observable = {direction for kind in locating for direction in kind.directions}
    observed = [direction for direction in DIRECTIONS if direction in observable]
    if part_of_scene:
        return tuple(observed)
    if not cell.estimate_frame:
        return ()
    return tuple(direction for direction in cell.frame_directions if direction in observed)
