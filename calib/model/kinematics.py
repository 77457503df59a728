"""Poses and points of a robot under an error model, with the analytic Jacobian of every parameter.

    T_frame_target(x, q) = F D_F  T_base_tip(x, q + dq)  T D_T

with the measurement frame F, the target T in the tip, the displacements D of `calib.model.error_model` and the
joints' own errors dq of `joint_displacements`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.values import Value
from calib.model.joint_errors import joint_displacements
from calib.model.parameters import ErrorModel, Parameter
from calib.robot import kernel
from calib.robot.robot import Robot

#: In place of the index of a parameter, for a number that is not estimated.
FIXED = -1


@dataclass(frozen=True, slots=True, eq=False)
class Samples(Value):
    """Joint values in N samples, and the measurement frame and the target of each."""

    #: Shape (N, m), values of the measured joints, [rad] or [m], in the order of `Robot.joint_names`.
    q: Array
    #: Shape (N,), index of the measurement frame, from 0.
    frame: Integers
    #: Shape (N,), index of the target, from 0.
    target: Integers
    #: shape (N, n, n + 3), see `calib.robot.gravity.gravity_loads`; None if not known.
    load: Array | None = None
    #: shape (N, `calib.camera.optics.COUNT`), numbers of camera and board by which images are predicted, before the
    #: fit; None if there are no cameras.
    optics: Array | None = None

    @classmethod
    def at(cls, q: ArrayLike, load: Array | None = None) -> Samples:
        """Return samples of the first target, seen from the first frame.

        Args:
            q: Shape (N, m) or (m,), [rad] or [m], in the order of `Robot.joint_names`.
            load: Shape (N, n, n + 3), see `calib.robot.gravity.gravity_loads`; None if not known.
        """
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        first = np.zeros(len(values), dtype=np.int_)
        return cls(values, first, first, load)

    def __len__(self) -> int:
        """The number N of samples."""
        return len(self.q)

    def select(self, chosen: Mask | Integers | slice) -> Samples:
        """Return some of the samples: a mask, their indices, or a slice."""
        load = None if self.load is None else self.load[chosen]
        optics = None if self.optics is None else self.optics[chosen]
        return Samples(self.q[chosen], self.frame[chosen], self.target[chosen], load, optics)


@dataclass(frozen=True, slots=True, eq=False)
class Optics(Value):
    """Numbers of camera and board in N samples, and the parameters that add to them."""

    #: shape (N, c), `calib.camera.optics.COUNT` numbers of each sample.
    values: Array
    #: shape (N, c), index of the parameter that adds to each number, from 0; `FIXED` for one that is not estimated.
    parameter: Integers


def changed_optics(
    samples: Samples, parameters: Sequence[Parameter], x: Array, numbers: Sequence[int]
) -> Optics | None:
    """Add the values of parameters to the numbers of camera and board in samples; return None if there are no cameras.

    Args:
        samples: N samples, with these numbers before the fit.
        parameters: k parameters of cameras and boards.
        x: shape (k,), their values.
        numbers: Their indices among all parameters.
    """
    if samples.optics is None:
        return None
    values = samples.optics.copy()
    parameter_of = np.full(values.shape, FIXED)
    for parameter, value, number in zip(parameters, x, numbers, strict=True):
        rows = np.ones(len(samples), dtype=bool)
        for column, selected in parameter.samples:
            rows &= samples.optics[:, column] == selected
        values[rows, parameter.optic] += value
        parameter_of[rows, parameter.optic] = number
    return Optics(values, parameter_of)


#: Samples, or joint values (N, m) alone: then of the first target, seen from the first frame.
SamplesOrValues: TypeAlias = Samples | Array


@dataclass(frozen=True, slots=True, eq=False)
class Kinematics(Value):
    """A robot under an error model, seen at targets from measurement frames."""

    #: The nominal robot.
    robot: Robot
    #: Its p parameters x.
    model: ErrorModel
    #: Shape (F, 4, 4) or (4, 4), [m], pose of the base in each measurement frame at x = 0.
    T_frame_base: Array
    #: Shape (T, 4, 4) or (4, 4), [m], pose of each target in the tip at x = 0.
    T_tip_target: Array

    def __post_init__(self) -> None:
        """Make one frame and one target stacks of one."""
        for name in ("T_frame_base", "T_tip_target"):
            stack = np.reshape(getattr(self, name), (-1, 4, 4))
            object.__setattr__(self, name, read_only(stack))

    def poses(self, x: Array, samples: SamplesOrValues) -> Array:
        """Return T_frame_target, the pose of each sample's target in its measurement frame.

        Args:
            x: Shape (p,), the parameters in their units.
            samples: N samples, or joint values (N, m) of the first frame and target.

        Returns:
            Shape (N, 4, 4), [m].
        """
        geometry, _ = self._displaced(x)
        return kernel.poses(geometry, self._chain_samples(x, samples))

    def points(self, x: Array, samples: SamplesOrValues) -> Array:
        """Return the target's position in the measurement frame.

        Args:
            x: Shape (p,), the parameters in their units.
            samples: N samples, or joint values (N, m) of the first frame and target.

        Returns:
            Shape (N, 3), [m].
        """
        return self.poses(x, samples)[:, :3, 3]

    def twists(
        self,
        x: Array,
        samples: SamplesOrValues,
        *,
        rotation: bool = True,
    ) -> tuple[Array, Array]:
        """Return T_frame_target and its Jacobian: the target's velocity per unit of each parameter.

        Args:
            x: Shape (p,), the parameters in their units.
            samples: N samples, or joint values (N, m) of the first frame and target.
            rotation: False for the velocity of the target's origin alone.

        Returns:
            T_frame_target, shape (N, 4, 4), [m]; and the Jacobian, shape (N, 6, p), linear [m] then angular [rad]
            velocity along the frame's axes, or (N, 3, p) without ``rotation``.
        """
        geometry, directions = self._displaced(x)
        chain_samples = self._chain_samples(x, samples)
        return kernel.twists(geometry, directions, chain_samples, rotation=rotation)

    def optics(self, x: Array, samples: Samples) -> Optics | None:
        """Return the numbers of camera and board by which images are predicted; None if there are no cameras.

        Args:
            x: Shape (p,), the parameters in their units.
            samples: N samples.
        """
        optical = self.model.optical
        numbers = [k for k, _ in optical]
        return changed_optics(samples, [parameter for _, parameter in optical], x[numbers], numbers)

    def _displaced(self, x: Array) -> tuple[kernel.Geometry, kernel.Directions]:
        """Return all placements displaced by x, and the twist of a unit of each parameter there."""
        displacements, twists = self.model.displacements(x)
        twists = twists.reshape(len(displacements), 6, -1)
        first = len(self.T_frame_base)
        last = first + len(self.robot.placements)
        geometry = self.robot.geometry(
            placements=self.robot.placements @ displacements[first:last],
            T_frame_base=self.T_frame_base @ displacements[:first],
            T_tip_target=self.T_tip_target @ displacements[last:],
        )
        directions = kernel.Directions(
            bases=twists[:first], placements=twists[first:last], targets=twists[last:]
        )
        return geometry, directions

    def _chain_samples(self, x: Array, samples: SamplesOrValues) -> kernel.ChainSamples:
        """Return the chain's joint values with the joints' own errors at x, and their derivative by the parameters."""
        if not isinstance(samples, Samples):
            samples = Samples.at(samples)
        values = self.robot.chain_values(samples.q)
        joint_terms = list(self.model.joint_terms)
        mixing = self.model.mixing[joint_terms]
        columns = np.flatnonzero(mixing.any(axis=0))
        moved = np.zeros((*values.shape, len(columns)))
        if len(columns):
            terms = [self.model.terms[t] for t in joint_terms]
            moved = joint_displacements(self.robot, terms, samples.q, samples.load)
            if self.model.terms is not self.model.parameters:  # else each moves its own
                moved = moved @ mixing[:, columns]
            values = values + moved @ x[columns]
        return kernel.ChainSamples(
            values=values,
            frame=samples.frame,
            target=samples.target,
            moved=moved,
            columns=columns,
        )
