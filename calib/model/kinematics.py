"""Poses and points of a robot under an error model, with the analytic Jacobian of every parameter.

    T_frame_target(x, q) = F D_F  T_base_tip(x, q + dq)  T D_T

with the measurement frame F, the target T in the tip, the displacements D of `calib.model.error_model` and the
joints' own errors dq of `joint_displacements`. The arithmetic is that of `calib.robot.kernel`, for any number of
samples. No finite differences anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError, choices
from calib.model.families import JointState, family_of
from calib.model.parameters import FRAME, TARGET, ErrorModel, Parameter
from calib.robot import kernel
from calib.robot.robot import Robot, read_only

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Where the robot stood, and which frame saw which target."""

    q: Array  #: shape (N, m), values of the measured joints, [rad] or [m].
    #: shape (N,), which of the measurement frames; all zero where there is one.
    frame: NDArray[np.int_]
    target: NDArray[np.int_]  #: shape (N,), which of the targets.
    #: shape (N, n), load on each joint of the chain [Nm, N]; None where it is not known.
    load: Array | None = None

    @classmethod
    def at(cls, q: ArrayLike, load: Array | None = None) -> Samples:
        """Joint values, seen by the first frame at the first target."""
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        first = np.zeros(len(values), dtype=np.int_)
        return cls(values, first, first, load)

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.q)

    def select(self, chosen: NDArray[np.bool_] | NDArray[np.int_] | slice) -> Samples:
        """Some of the samples, by a mask, by their indices, or a slice of them."""
        load = None if self.load is None else self.load[chosen]
        return Samples(self.q[chosen], self.frame[chosen], self.target[chosen], load)


#: Samples, or joint values alone.
Where: TypeAlias = Samples | NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Kinematics:
    """A robot under an error model, seen at targets from measurement frames."""

    robot: Robot  #: The nominal robot.
    model: ErrorModel  #: Its parameters.
    T_frame_base: Array  #: shape (F, 4, 4) or (4, 4), [m], pose of the base in each measurement frame at x = 0.
    T_tip_target: Array  #: shape (T, 4, 4) or (4, 4), [m], pose of each target in the tip at x = 0.

    def __post_init__(self) -> None:
        """One frame and one target become stacks of one; refuse another number of them than the model has."""
        for name, kind in (("T_frame_base", FRAME), ("T_tip_target", TARGET)):
            stack = np.reshape(getattr(self, name), (-1, 4, 4))
            object.__setattr__(self, name, read_only(stack))
            places = [place for place in self.model.places if place.startswith(kind)]
            if len(stack) != len(places):
                raise ModelError(
                    f"{len(stack)} poses {name} were given; the model '{self.model.name}' has {len(places)} such "
                    f"places: {choices(places)}."
                )

    def poses(self, x: Array, where: Where) -> Array:
        """T_frame_target at parameters x, shape (p,), and N samples or joint values (N, m); shape (N, 4, 4), [m]."""
        return kernel.poses(self._displaced(x)[0], self._stood(x, where))

    def points(self, x: Array, where: Where) -> Array:
        """The target's position in the measurement frame, shape (N, 3), [m]."""
        return self.poses(x, where)[:, :3, 3]

    def twists(self, x: Array, where: Where, *, rotation: bool = True) -> tuple[Array, Array]:
        """T_frame_target, (N, 4, 4), [m], and the velocity of the target in a unit of each parameter.

        The velocity, linear then angular along the axes of the measurement frame, has shape (N, 6, p), or (N, 3, p)
        without ``rotation``, [m or rad per unit of the parameter].
        """
        geometry, directions = self._displaced(x)
        return kernel.twists(geometry, directions, self._stood(x, where), rotation=rotation)

    def points_jacobian(self, x: Array, where: Where) -> tuple[Array, Array]:
        """The target's position and its derivative, shapes (N, 3), [m], and (N, 3, p), [m per unit]."""
        poses, twists = self.twists(x, where, rotation=False)
        return poses[:, :3, 3], twists

    def _displaced(self, x: Array) -> tuple[kernel.Geometry, kernel.Directions]:
        """Every placement displaced, and what a unit of each parameter does there."""
        displacement, directions = self.model.displacements(x)
        local = directions.reshape(len(displacement), 6, -1)
        frames, count = len(self.T_frame_base), len(self.robot.placements)
        inner = slice(frames, frames + count)
        geometry = self.robot.geometry(
            self.robot.placements @ displacement[inner],
            self.T_frame_base @ displacement[:frames],
            self.T_tip_target @ displacement[frames + count :],
        )
        return geometry, kernel.Directions(local[:frames], local[inner], local[frames + count :])

    def _stood(self, x: Array, where: Where) -> kernel.Stood:
        """The chain's joint values with the joints' own errors at x, and how a unit of each parameter moves them."""
        samples = where if isinstance(where, Samples) else Samples.at(where)
        values = self.robot.chain_values(samples.q)
        chosen = list(self.model.joint_terms)
        mixing = self.model.mixing[chosen]
        columns = np.flatnonzero(mixing.any(axis=0))
        moved = np.zeros((*values.shape, len(columns)))
        if len(columns):
            terms = [self.model.terms[t] for t in chosen]
            moved = joint_displacements(self.robot, terms, samples.q, samples.load)
            moved = moved @ mixing[:, columns]
            values = values + moved @ x[columns]
        return kernel.Stood(values, samples.frame, samples.target, moved, columns)


def joint_displacements(
    robot: Robot, terms: Sequence[Parameter], q: Array, load: Array | None
) -> Array:
    """How far a unit of each term, with a ``factor``, moves each joint of the chain, shape (N, n, len(terms))."""
    joints = tuple(joint.name for joint in robot.joints)
    moved = np.zeros((len(q), len(joints), len(terms)))
    for k, term in enumerate(terms):
        assert term.factor is not None
        if family_of(term.family).every_joint:
            driven: Array = np.eye(len(joints))[joints.index(term.place)]
        else:
            driven = robot.coupling[:, robot.joint_names.index(term.place)]
        state = JointState(term.place, robot.joint_names, q, joints, load)
        moved[:, :, k] = term.factor.value(state)[:, None] * driven
    return moved
