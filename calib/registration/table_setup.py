"""The measurement setup of a table and a cell."""

from __future__ import annotations

import numpy as np

import calib.data.kinds as registry
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import ModelError, choices
from calib.model.error_model import DIRECTIONS
from calib.registration.rows import NONE
from calib.registration.setup import Setup
from calib.robot.robot import read_only
from calib.units import Integers


def setup_of(cell: Cell, measurements: Measurements, kinds: Integers) -> Setup:
    """What a cell says of the frames and targets of a table; `ModelError` for a name that the table lacks."""
    groups = tuple(dict.fromkeys(measurements.groups))
    targets = tuple(dict.fromkeys(measurements.targets))
    for column, named, known in (
        ("group", cell.frames, groups),
        ("target", cell.targets, targets),
    ):
        strange = [name for name in named if name not in known]
        if strange:
            raise ModelError(
                f"{measurements.source}: the cell says where {choices(strange)} is; the table's column '{column}' has "
                f"{choices(known)}."
            )
    unknown, frames, frame_given, own_axes = [], [], [], []
    of_group = np.array([groups.index(g) for g in measurements.groups])
    for g, group in enumerate(groups):
        present = [registry.at(k) for k in np.unique(kinds[of_group == g]).tolist() if k != NONE]
        seen = [kind for kind in present if kind.directions]
        given = cell.frames.get(group, cell.T_frame_base)
        # Sockets, planes and anchors are unknown where the cell does not give their group's frame.
        scene = all(kind.own_frame for kind in seen) and group not in cell.frames
        telling = [d for d in DIRECTIONS if any(d in kind.directions for kind in seen)]
        wanted = telling if scene else cell.frame_directions if cell.estimate_frame else ()
        unknown.append(tuple(d for d in wanted if d in telling))
        frames.append(np.eye(4) if given is None else given)
        frame_given.append(given is not None or not unknown[-1])
        own_axes.append(scene and any(kind.own_axes for kind in seen))
    T_tip_target = np.tile(np.eye(4), (len(targets), 1, 1))
    places = [cell.targets.get(name, cell.target) for name in targets]
    for T, place in zip(T_tip_target, places, strict=True):
        T[:3, 3] = 0.0 if place is None else place
        T[:3, :3] = np.eye(3) if cell.target_rotation is None else cell.target_rotation
    rotation = any(registry.at(k).angles for k in np.unique(kinds).tolist() if k != NONE)
    return Setup(
        groups=groups,
        targets=targets,
        T_frame_base=read_only(frames),
        T_tip_target=read_only(T_tip_target),
        unknown=tuple(unknown),
        frame_given=np.array(frame_given),
        target_unknown=np.full(len(targets), cell.estimate_target),
        target_given=np.array([place is not None for place in places]),
        rotation=rotation,
        own_axes=np.array(own_axes),
        oriented=cell.target_rotation is not None or rotation,
    )
