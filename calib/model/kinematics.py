"""Poses and points of a robot under it, with the analytic Jacobian of every parameter.

    T_frame_target(x, q) = F D_F  T_base_tip(x, q + dq)  T D_T

with the measurement frame F, the target T in the tip, the displacements D of `calib.model.error_model` and the
joints' own errors dq of `joint_displacements`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.model.joint_errors import joint_displacements
from calib.model.parameters import ErrorModel
from calib.robot import kernel
from calib.robot.robot import Robot, read_only
from calib.units import Array


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Where the robot stood, and which frame saw which target."""

    q: Array  #: shape (N, m), values of the measured joints, [rad] or [m].
    frame: NDArray[np.int_]  #: shape (N,), which of the measurement frames.
    target: NDArray[np.int_]  #: shape (N,), which of the targets.
    #: shape (N, n, n + 3), see `calib.robot.gravity.gravity_loads`; None if not known.
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
        """One frame and one target become stacks of one."""
        for name in ("T_frame_base", "T_tip_target"):
            stack = np.reshape(getattr(self, name), (-1, 4, 4))
            object.__setattr__(self, name, read_only(stack))

    def poses(self, x: Array, where: Where) -> Array:
        """T_frame_target at parameters x, shape (p,), and N samples or joint values (N, m); shape (N, 4, 4), [m]."""
        return kernel.poses(self._displaced(x)[0], self._chain_samples(x, where))

    def points(self, x: Array, where: Where) -> Array:
        """The target's position in the measurement frame, shape (N, 3), [m]."""
        return self.poses(x, where)[:, :3, 3]

    def twists(self, x: Array, where: Where, *, rotation: bool = True) -> tuple[Array, Array]:
        """T_frame_target, (N, 4, 4), [m], and the target's velocity in a unit of each parameter.

        It is linear then angular, along the frame's axes, (N, 6, p), or (N, 3, p) without ``rotation``, [m, rad].
        """
        geometry, directions = self._displaced(x)
        return kernel.twists(geometry, directions, self._chain_samples(x, where), rotation=rotation)

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

    def _chain_samples(self, x: Array, where: Where) -> kernel.ChainSamples:
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
            if self.model.terms is not self.model.parameters:  # else each moves its own
                moved = moved @ mixing[:, columns]
            values = values + moved @ x[columns]
        return kernel.ChainSamples(values, samples.frame, samples.target, moved, columns)
