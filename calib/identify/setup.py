"""Setup: the measurement frames and targets of a fit, and what of them is unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import calib.kinds as registry
from calib.errors import ModelError, choices
from calib.identify.rows import NONE
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.error_model import DIRECTIONS
from calib.model.parameters import ErrorModel, Parameter, frame_place, target_place
from calib.model.robot import read_only

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Frames and targets, by the number that rows refer to them with.

    Attributes:
        groups: Names of the set-ups; one frame each.
        targets: Names of the targets.
        T_frame_base: shape (F, 4, 4), pose of the base in each frame [m].
        T_tip_target: shape (T, 4, 4), pose of each target in the tip [m].
        unknown: For each frame the directions that are estimated.
        frame_given: Whether the poses of the frames are the ones that were given; else they are to be found.
        target_unknown: shape (T,), whether a target is estimated.
        target_given: shape (T,), whether a target's place was given.
        rotation: Whether targets are frames, because orientations were measured, or points.
        own_axes: shape (F,), whether a frame's directions are its own axes; else they are the base's. A plane is known
            along and about its own axes only.
        oriented: Whether the targets' orientations are known, measured or given.
    """

    groups: tuple[str, ...]
    targets: tuple[str, ...]
    T_frame_base: Array
    T_tip_target: Array
    unknown: tuple[tuple[str, ...], ...]
    frame_given: NDArray[np.bool_]
    target_unknown: NDArray[np.bool_]
    target_given: NDArray[np.bool_]
    rotation: bool
    own_axes: NDArray[np.bool_]
    oriented: bool = False

    @property
    def frame_unknowns(self) -> Mapping[str, tuple[str, ...]]:
        """The estimated directions of each frame by its set-up's name; "" stands for the only one."""
        if len(self.groups) == 1:
            return {"": self.unknown[0]}
        return dict(zip(self.groups, self.unknown, strict=True))

    @property
    def target_names(self) -> tuple[str, ...]:
        """The targets' names for their parameters; "" for the only one."""
        return self.targets if len(self.targets) > 1 else ("",)

    @property
    def estimate_target(self) -> bool:
        """Whether any target is estimated."""
        return bool(np.any(self.target_unknown))

    @property
    def unknown_targets(self) -> tuple[str, ...]:
        """The names of the targets that are estimated, as `target_names` has them."""
        pairs = zip(self.target_names, self.target_unknown, strict=True)
        return tuple(name for name, unknown in pairs if unknown)

    @property
    def count(self) -> int:
        """Number of unknowns."""
        of_targets = (6 if self.rotation else 3) * int(np.sum(self.target_unknown))
        return of_targets + sum(len(directions) for directions in self.unknown)

    def placed(self, T_frame_base: Array, T_tip_target: Array) -> Setup:
        """The same with frames and targets elsewhere."""
        return replace(
            self, T_frame_base=read_only(T_frame_base), T_tip_target=read_only(T_tip_target)
        )

    def as_known(self, frames: NDArray[np.bool_], targets: NDArray[np.bool_]) -> Setup:
        """The same, with some frames and targets taken for known.

        Args:
            frames: shape (F,), whether a frame is known where it stands.
            targets: shape (T,), likewise.
        """
        unknown = tuple(
            () if known else directions
            for known, directions in zip(frames, self.unknown, strict=True)
        )
        return replace(self, unknown=unknown, target_unknown=self.target_unknown & ~targets)


def setup_of(cell: Cell, measurements: Measurements, kinds: NDArray[np.int_]) -> Setup:
    """What a cell says of the frames and targets of a table.

    Sockets, planes and anchors are always unknown where the cell does not give their group's frame.

    Args:
        cell: The set-up.
        measurements: The table.
        kinds: shape (N,), of its rows.

    Raises:
        ModelError: The cell names a set-up or a target that the table lacks, or all of a frame stay unknown to it.
    """
    groups = tuple(dict.fromkeys(measurements.groups))
    targets = tuple(dict.fromkeys(measurements.targets))
    _check_names(cell, groups, targets, measurements.source)
    unknown, frames, frame_given, own_axes = [], [], [], []
    of_group = np.array([groups.index(g) for g in measurements.groups])
    for g, group in enumerate(groups):
        present = [registry.at(k) for k in np.unique(kinds[of_group == g]).tolist() if k != NONE]
        seen = [kind for kind in present if kind.directions]
        given = cell.frames.get(group, cell.T_frame_base)
        scene = all(kind.own_frame for kind in seen) and group not in cell.frames
        telling = [d for d in DIRECTIONS if any(d in kind.directions for kind in seen)]
        wanted = telling if scene else cell.frame_directions if cell.estimate_frame else ()
        unknown.append(tuple(d for d in wanted if d in telling))
        frames.append(np.eye(4) if given is None else given)
        frame_given.append(given is not None or not unknown[-1])
        own_axes.append(scene and any(kind.own_axes for kind in seen))
    T_tip_target = np.tile(np.eye(4), (len(targets), 1, 1))
    target_given = []
    for t, name in enumerate(targets):
        place = cell.targets.get(name, cell.target)
        target_given.append(place is not None)
        if place is not None:
            T_tip_target[t, :3, 3] = place
        if cell.target_rotation is not None:
            T_tip_target[t, :3, :3] = cell.target_rotation
    rotation = any(registry.at(k).angles for k in np.unique(kinds).tolist() if k != NONE)
    return Setup(
        groups=groups,
        targets=targets,
        T_frame_base=read_only(frames),
        T_tip_target=read_only(T_tip_target),
        unknown=tuple(unknown),
        frame_given=np.array(frame_given),
        target_unknown=np.full(len(targets), cell.estimate_target),
        target_given=np.array(target_given),
        rotation=rotation,
        own_axes=np.array(own_axes),
        oriented=cell.target_rotation is not None or rotation,
    )


def along_own_axes(model: ErrorModel, setup: Setup) -> ErrorModel:
    """The model with the directions of planes' frames along the planes' own axes, wherever these point in the base.

    A frame is displaced in the base, T_frame_base D: with the rotation R of T_frame_base the twist of a unit along one
    of its own axes e is R^T e.

    Args:
        model: With the set-up's frames.
        setup: Frames where they start.
    """
    turned = {}
    for f, name in enumerate(setup.frame_unknowns):
        if setup.own_axes[f]:
            turned[frame_place(name)] = setup.T_frame_base[f, :3, :3].T
    return turned_at(model, turned, ("m", "rad"))


def targets_along_tip(model: ErrorModel, setup: Setup) -> ErrorModel:
    """The model with the positions of targets along the tip's axes, in which they are given and told.

    A target is displaced in its own frame, T_tip_target D; its angles stay about its own axes.

    Args:
        model: With the set-up's targets.
        setup: Targets where they start.
    """
    turned = {}
    for t, name in enumerate(setup.target_names):
        R = setup.T_tip_target[t, :3, :3]
        if not np.array_equal(R, np.eye(3)):
            turned[target_place(name)] = R.T
    return turned_at(model, turned, ("m",))


def turned_at(model: ErrorModel, turned: Mapping[str, Array], units: tuple[str, ...]) -> ErrorModel:
    """The model with the directions at some places turned, of parameters of these units.

    Args:
        model: The model.
        turned: For each of these places a rotation, shape (3, 3).
        units: Of the parameters that are meant.
    """
    if not turned:
        return model

    def turn(one: Parameter) -> Parameter:
        if one.place not in turned or one.unit not in units:
            return one
        direction = (turned[one.place] @ one.direction.reshape(2, 3).T).T.ravel()
        return replace(one, direction=read_only(direction))

    return replace(
        model,
        parameters=tuple(turn(one) for one in model.parameters),
        terms=tuple(turn(one) for one in model.terms),
    )


def _check_names(
    cell: Cell, groups: tuple[str, ...], targets: tuple[str, ...], source: str
) -> None:
    """Refuse frames and targets of names that the table does not have."""
    for what, given, known in (
        ("frames", cell.frames, groups),
        ("targets", cell.targets, targets),
    ):
        strange = [name for name in given if name not in known]
        if strange:
            column = "group" if what == "frames" else "target"
            raise ModelError(
                f"{source}: the cell gives {what} for {choices(strange)}; the table's column '{column}' has "
                f"{choices(known)}."
            )
    ends = {name for pair in cell.distances for name in (pair.first, pair.second)}
    strange = sorted(name for name in ends if "*" not in name and name not in groups)
    if strange:
        raise ModelError(
            f"{source}: the cell states distances between groups {choices(strange)}; the table has "
            f"{choices(groups)}."
        )
