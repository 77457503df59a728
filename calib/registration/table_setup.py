"""The measurement setup that a cell states for a table: which frames and targets there are, and which are estimated."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

import calib.data.kinds as registry
from calib.data.cell import Cell
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.errors import ModelError, choices
from calib.model.error_model import DIRECTIONS
from calib.registration.rows import NONE
from calib.registration.setup import Setup
from calib.robot.robot import read_only
from calib.units import Array, Integers


def measurement_setup(cell: Cell, measurements: Measurements, kinds: Integers) -> Setup:
    """Make the setup of a table: poses as the cell gives them, identity where it gives none.

    Args:
        cell: Frames and targets that are given, and whether they are estimated.
        measurements: Table of N rows; its groups are the stations.
        kinds: shape (N,), number of each row's kind in `calib.data.kinds`; `NONE` for the second row of a pair.

    Raises:
        ModelError: The cell names a group or target that the table lacks.
    """
    groups = tuple(dict.fromkeys(measurements.groups))
    targets = tuple(dict.fromkeys(measurements.targets))
    _check_names(measurements, "group", cell.frames, groups)
    _check_names(measurements, "target", cell.targets, targets)
    of_group = np.array([groups.index(group) for group in measurements.groups])
    unknown, frames, frame_given, own_axes = [], [], [], []
    for g, group in enumerate(groups):
        locating = [kind for kind in _kinds_in(kinds[of_group == g]) if kind.directions]
        given = cell.frames.get(group, cell.T_frame_base)
        # Frames of sockets, planes and anchors are estimated unless the cell gives this group's.
        part_of_scene = group not in cell.frames and all(kind.own_frame for kind in locating)
        directions = _estimated_directions(cell, locating, part_of_scene)
        unknown.append(directions)
        frames.append(np.eye(4) if given is None else given)
        frame_given.append(given is not None or not directions)
        own_axes.append(part_of_scene and any(kind.own_axes for kind in locating))
    places = [cell.targets.get(name, cell.target) for name in targets]
    rotation = any(kind.angles for kind in _kinds_in(kinds))
    return Setup(
        groups=groups,
        targets=targets,
        T_frame_base=read_only(frames),
        T_tip_target=read_only(_target_poses(places, cell.target_rotation)),
        unknown=tuple(unknown),
        frame_given=np.array(frame_given),
        target_unknown=np.full(len(targets), cell.estimate_target),
        target_given=np.array([place is not None for place in places]),
        rotation=rotation,
        own_axes=np.array(own_axes),
        oriented=cell.target_rotation is not None or rotation,
    )


def _check_names(
    measurements: Measurements, column: str, given: Collection[str], present: tuple[str, ...]
) -> None:
    """Raise `ModelError` for names that a cell gives and the table's column lacks."""
    missing = [name for name in given if name not in present]
    if missing:
        raise ModelError(
            f"{measurements.source}: the cell says where {choices(missing)} is; the table's column '{column}' has "
            f"{choices(present)}."
        )


def _kinds_in(numbers: Integers) -> list[Kind]:
    """Kinds that occur among their numbers, in the order of these."""
    return [registry.at(k) for k in np.unique(numbers).tolist() if k != NONE]


def _estimated_directions(cell: Cell, locating: list[Kind], part_of_scene: bool) -> tuple[str, ...]:
    """Directions of a group's frame that are estimated, of those that its kinds of rows depend on."""
    observed = [
        direction
        for direction in DIRECTIONS
        if any(direction in kind.directions for kind in locating)
    ]
    if part_of_scene:
        return tuple(observed)
    if not cell.estimate_frame:
        return ()
    return tuple(direction for direction in cell.frame_directions if direction in observed)


def _target_poses(places: list[Array | None], rotation: Array | None) -> Array:
    """Pose of each target in the tip, shape (T, 4, 4) [m]; the tip's own where nothing is given.

    Args:
        places: Position of each target in the tip, shape (3,) [m], or None.
        rotation: shape (3, 3), orientation of all targets in the tip, or None.
    """
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    for T, place in zip(poses, places, strict=True):
        if place is not None:
            T[:3, 3] = place
        if rotation is not None:
            T[:3, :3] = rotation
    return poses
