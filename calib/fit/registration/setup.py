"""Measurement setup: the frames and targets of a table, and what is estimated of them.

A row's prediction is T_frame_target = T_frame_base T_base_tip T_tip_target, with the frame of its station and its
target; base and tip are the links that these two are mounted on. A frame or target is estimated or fixed; if estimated,
its pose here is where the estimation starts: as given, then as registered. Known distances between frames give sockets
and planes a unit of length.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.errors import ModelError, choices
from calib.model.error_model import FRAME, TARGET, ErrorModel, Parameter
from calib.model.internals import FIXED, InternalUnknown, changed_internals
from calib.model.kinematics import Samples, Sightings
from calib.model.parameter_sets import DIRECTIONS
from calib.robot.robot import Robot


@dataclass(frozen=True, slots=True, eq=False)
class Setup(Value):
    """F frames and T targets, in the order of the numbers that rows refer to them with."""

    #: Names of the stations, with one frame each
    groups: tuple[str, ...]
    #: Names of the targets
    targets: tuple[str, ...]
    #: (F, 4, 4), pose of the base in each frame [m]
    T_frame_base: Array
    #: (T, 4, 4), pose of each target in the tip [m]
    T_tip_target: Array
    #: For each frame the directions that are estimated: "x" ... "rz"
    unknown: tuple[tuple[str, ...], ...]
    #: (F,), True for frames whose pose was given. The nominal robot is evaluated with it; others are registered for it
    frame_given: Mask
    #: (T,), targets that are estimated
    target_unknown: Mask
    #: (T,), True for targets whose position was given. It is either kept, or used to evaluate the nominal robot and to
    #: check the estimate
    target_given: Mask
    #: Whether targets have an orientation to estimate, because one was measured; else they are points
    rotation: bool
    #: (F,), frames whose directions are along their own axes (planes); else along the base's
    own_axes: Mask
    #: Whether the targets' orientations are known, measured or given
    oriented: bool = False
    #: Internals of the instruments that are estimated
    internals: tuple[InternalUnknown, ...] = ()
    #: For each frame the link that it is mounted on, whose pose in it ``T_frame_base`` is; empty: the robot's base
    frame_links: tuple[str, ...] = ()
    #: For each target the link that it is mounted on, in which ``T_tip_target`` is its pose; empty: the robot's tip
    target_links: tuple[str, ...] = ()

    def chains(self, robot: Robot, frame: Integers, target: Integers) -> Integers | None:
        """Return the chain that each row is seen through, shape (N,), by its index in `Robot.chains`.

        Args:
            robot: The robot.
            frame: Index of each row's frame, shape (N,).
            target: Index of each row's target, shape (N,).

        Returns:
            Indices from 0; None if the robot has one chain.

        Raises:
            ModelError: The robot has no chain between the links of a frame and a target.
        """
        if not robot.branches:
            return None
        numbers = {(chain.base, chain.tip): k for k, chain in enumerate(robot.chains)}
        bases = self.frame_links or (robot.base,) * len(self.groups)
        tips = self.target_links or (robot.tip,) * len(self.targets)
        result = np.empty(len(frame), dtype=np.int_)
        for f, t in dict.fromkeys(zip(frame.tolist(), target.tolist(), strict=True)):
            if (bases[f], tips[t]) not in numbers:
                raise ModelError(
                    f"The target '{self.targets[t]}' on '{tips[t]}' was seen from '{self.groups[f]}' on '{bases[f]}', "
                    f"but the robot was loaded without a chain between these links."
                )
            result[(frame == f) & (target == t)] = numbers[bases[f], tips[t]]
        return result

    @property
    def frame_unknowns(self) -> Mapping[str, tuple[str, ...]]:
        """Estimated directions of each frame by its station's name; "" is the name of the only one."""
        names = self.groups if len(self.groups) > 1 else ("",)
        return dict(zip(names, self.unknown, strict=True))

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the targets in the names of their parameters; "" is the name of the only one."""
        return self.targets if len(self.targets) > 1 else ("",)

    @property
    def places(self) -> tuple[list[str], list[str]]:
        """Places of the frames, and of the targets, in an error model: `Parameter.place`."""
        frames = [FRAME + name for name in self.frame_unknowns]
        return frames, [TARGET + name for name in self.target_names]

    @property
    def estimate_target(self) -> bool:
        """True if any target is estimated."""
        return bool(np.any(self.target_unknown))

    @property
    def unknown_targets(self) -> tuple[str, ...]:
        """Names of the targets that are estimated, as in `target_names`."""
        return tuple(compress(self.target_names, self.target_unknown))

    @property
    def wholly_unknown(self) -> Mask:
        """True for frames that are estimated in all six directions, shape (F,)."""
        return np.array([len(directions) == len(DIRECTIONS) for directions in self.unknown])

    @property
    def count(self) -> int:
        """Number of unknowns of all frames and targets: internals of instruments are not counted."""
        of_frames = sum(len(directions) for directions in self.unknown)
        of_each_target = 6 if self.rotation else 3
        of_targets = of_each_target * int(np.sum(self.target_unknown))
        return of_targets + of_frames

    def with_poses(self, T_frame_base: Array, T_tip_target: Array) -> Setup:
        """Return a copy with other poses of the frames and targets.

        Args:
            T_frame_base: shape (F, 4, 4), pose of the base in each frame [m].
            T_tip_target: shape (T, 4, 4), pose of each target in the tip [m].
        """
        return replace(
            self,
            T_frame_base=read_only(T_frame_base),
            T_tip_target=read_only(T_tip_target),
        )

    def displaced(self, displacement: Array) -> Setup:
        """Return a copy displaced by the parameters of an error model.

        Args:
            displacement: shape (F + ... + T, 4, 4), of all places of the model, frames first and targets last:
                `ErrorModel.displacements`. A displacement D makes T_frame_base D or T_tip_target D of a pose.
        """
        of_frames = displacement[: len(self.groups)]
        of_targets = displacement[-len(self.targets) :]
        return self.with_poses(self.T_frame_base @ of_frames, self.T_tip_target @ of_targets)

    def target_poses(self, T_base_tip: Array, samples: Samples) -> Array:
        """Predict T_frame_target of samples.

        Args:
            T_base_tip: shape (N, 4, 4), pose of the tip at each sample [m].
            samples: Their frames and targets.

        Returns:
            shape (N, 4, 4), [m].
        """
        T_frame_tip = self.T_frame_base[samples.frame] @ T_base_tip
        return np.asarray(T_frame_tip @ self.T_tip_target[samples.target])

    def sightings(self, T_base_tip: Array, samples: Samples) -> Sightings:
        """Return what the readings of samples are predicted from.

        Args:
            T_base_tip: shape (N, 4, 4), pose of the tip at each sample [m].
            samples: Their frames, targets and instruments.

        Returns:
            T_frame_target of each sample, and the internals of its instrument as this setup has them, which no
            parameter changes.
        """
        changes = [(unknown.parameter, unknown.change, FIXED) for unknown in self.internals]
        internals = changed_internals(samples.internals, changes)
        return Sightings(self.target_poses(T_base_tip, samples), internals=internals)

    def seen_by(self, samples: Samples) -> tuple[Mask, Mask]:
        """Return the frames, shape (F,), and the targets, shape (T,), that occur in samples."""
        frames = np.bincount(samples.frame, minlength=len(self.groups)) > 0
        targets = np.bincount(samples.target, minlength=len(self.targets)) > 0
        return frames, targets

    def unknown_at(self, samples: Samples) -> Mask:
        """Return the samples whose frame or target is estimated, shape (N,)."""
        frame_unknown = np.array([bool(directions) for directions in self.unknown])
        by_frame = frame_unknown[samples.frame]
        by_target = self.target_unknown[samples.target]
        return np.asarray(by_frame | by_target)

    def with_given_fixed(self, observed: Samples | None = None) -> Setup:
        """Return a copy in which given frames and targets are fixed, not estimated.

        Args:
            observed: Frames and targets that occur in these samples are fixed too; None for no others.
        """
        result = self.with_fixed(self.frame_given, self.target_given)
        if observed is None:
            return result
        return result.with_fixed(*result.seen_by(observed))

    def with_fixed(self, frames: Mask, targets: Mask) -> Setup:
        """Return a copy in which some frames and targets are fixed at their poses, not estimated.

        Args:
            frames: shape (F,), which frames.
            targets: shape (T,), which targets.
        """
        unknown: list[tuple[str, ...]] = []
        for fixed, directions in zip(frames, self.unknown, strict=True):
            unknown.append(() if fixed else directions)
        target_unknown = self.target_unknown & ~targets
        return replace(self, unknown=tuple(unknown), target_unknown=target_unknown)

    def with_estimated_not_given(self) -> Setup:
        """Return a copy with every frame and target that is estimated marked as not given, and all others as given.

        What is not given is registered for the nominal robot; what is given would not be.
        """
        frame_known = np.array([not directions for directions in self.unknown])
        return replace(self, frame_given=frame_known, target_given=~self.target_unknown)

    def turn_directions(self, model: ErrorModel) -> ErrorModel:
        """Turn directions of frame and target parameters: a plane's to its own axes, a target's position to the tip's.

        An error model has the directions of a frame along the base's axes and those of a target along its own. With the
        rotation R of T_frame_base a unit along one of the plane's axes e is the twist R^T e.

        Args:
            model: Parameters of the robot, the frames and the targets, as `calib.model.parameter_sets` makes them.

        Returns:
            The model with parameters of the same names, each still of one metre or radian a unit.
        """
        frames, targets = self.places
        R_base_frame = self.T_frame_base[:, :3, :3].swapaxes(1, 2)
        R_target_tip = self.T_tip_target[:, :3, :3].swapaxes(1, 2)
        R_of_targets = dict(zip(targets, R_target_tip, strict=True))
        planes = compress(zip(frames, R_base_frame, strict=True), self.own_axes)
        R_of_planes = dict(planes)

        def turn(parameter: Parameter) -> Parameter:
            """Return a parameter with its direction turned; those of the robot as they are."""
            R = R_of_planes.get(parameter.place)
            if R is None and parameter.unit == "m":
                R = R_of_targets.get(parameter.place)
            if R is None or parameter.unit not in ("m", "rad") or np.array_equal(R, np.eye(3)):
                return parameter
            linear_and_angular = parameter.direction.reshape(2, 3)
            direction = (R @ linear_and_angular.T).T
            return replace(parameter, direction=read_only(direction.ravel()))

        parameters = tuple(map(turn, model.parameters))
        terms = tuple(map(turn, model.terms))
        if parameters == model.parameters and terms == model.terms:
            return model
        return replace(model, parameters=parameters, terms=terms)


class KnownDistance(NamedTuple):
    """A known distance between the origins of two frames, such as two sockets on one bar."""

    #: Index of a frame in `Setup.groups`, from 0
    first: int
    #: Index of the other
    second: int
    #: Distance of their origins [m]
    length: float
    #: Its standard deviation [m]
    sigma: float


def known_distances(cell: Cell, setup: Setup) -> tuple[KnownDistance, ...]:
    """Resolve the distances that a cell states between groups to the frames of a table.

    Args:
        cell: Its distances name groups; a "*" stands for the same text in both names.
        setup: Its groups are those of the table.

    Returns:
        One distance between frames, by their numbers, for each pair of groups that a stated one names.

    Raises:
        ModelError: A distance whose groups the table lacks.
    """
    result: list[KnownDistance] = []
    for distance in cell.distances:
        pairs = distance.pairs(setup.groups)
        if not pairs:
            raise ModelError(
                f"A distance is stated between the groups '{distance.first}' and '{distance.second}'; the table's "
                f"column 'group' has {choices(setup.groups)}."
            )
        for first, second in pairs:
            frames = setup.groups.index(first), setup.groups.index(second)
            result.append(KnownDistance(*frames, distance.length, distance.sigma))
    return tuple(result)
