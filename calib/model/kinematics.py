"""Poses and points of a robot under an error model, with the analytic Jacobian of every parameter.

    T_frame_target(x, q) = F D_F  T_base_tip(x, q + dq)  T D_T

with the measurement frame F, the target T in the tip, the displacements D of `calib.model.parameter_sets` and the
joints' own errors dq of `joint_displacements`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.values import Value
from calib.model.error_model import ErrorModel
from calib.model.error_on_chain import model_on_chain
from calib.model.internals import InternalValues, changed_internals
from calib.model.joint_errors import joint_displacements
from calib.robot import kernel
from calib.robot.robot import Robot


@dataclass(frozen=True, slots=True, eq=False)
class Samples(Value):
    """Joint values in N samples, and the measurement frame and the target of each."""

    #: Shape (N, m), values of the measured joints, [rad] or [m], in the order of `Robot.joint_names`.
    q: Array
    #: Shape (N,), index of the measurement frame, from 0.
    frame: Integers
    #: Shape (N,), index of the target, from 0.
    target: Integers
    #: shape (N, n, n + 3) or more, see `calib.robot.gravity.gravity_loads`; None if not known.
    load: Array | None = None
    #: Shape (N, c), internals of the instruments before the fit, see `calib.model.internals`; None if they have none.
    internals: Array | None = None
    #: Shape (N, m), last move of each measured joint before the sample, [rad] or [m], see `calib.numerics.moves`; 0
    #: where it is not known; None: known nowhere.
    moves: Array | None = None
    #: Shape (N,), index of the chain between frame and target in `Robot.chains`, from 0; None: the first.
    chain: Integers | None = None

    @classmethod
    def at(cls, q: ArrayLike, load: Array | None = None, moves: Array | None = None) -> Samples:
        """Return samples of the first target, seen from the first frame.

        Args:
            q: Shape (N, m) or (m,), [rad] or [m], in the order of `Robot.joint_names`.
            load: Shape (N, n, n + 3), see `calib.robot.gravity.gravity_loads`; None if not known.
            moves: Shape (N, m), last move of each joint, [rad] or [m]; None if not known.
        """
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        first = np.zeros(len(values), dtype=np.int_)
        return cls(values, first, first, load, moves=moves)

    def __len__(self) -> int:
        """The number N of samples."""
        return len(self.q)

    def rows_of_chain(self, number: int) -> Integers:
        """Return the indices of the samples of one chain of a robot, by its number in `Robot.chains`, from 0."""
        if self.chain is None:
            return np.arange(len(self) if number == 0 else 0)
        return np.flatnonzero(self.chain == number)

    def select(self, chosen: Mask | Integers | slice) -> Samples:
        """Return some of the N samples: a mask, shape (N,), their indices, or a slice."""
        load = None if self.load is None else self.load[chosen]
        internals = None if self.internals is None else self.internals[chosen]
        moves = None if self.moves is None else self.moves[chosen]
        chain = None if self.chain is None else self.chain[chosen]
        return Samples(
            self.q[chosen], self.frame[chosen], self.target[chosen], load, internals, moves, chain
        )


@dataclass(frozen=True, slots=True, eq=False)
class Sightings(Value):
    """The basis of predicted readings of N rows: the target as its instrument has it before it."""

    #: Shape (N, 4, 4), pose of each row's target in its measurement frame [m].
    T_frame_target: Array
    #: Shape (N, 6, p), motion of each target by each of p parameters, see `Kinematics.twists`; (N, 3, p), translations
    #: alone, if no row depends on its target's orientation; None: predictions alone are wanted.
    twists: Array | None = None
    #: Internals of the instruments, and the parameters that change them; None: as they are before the fit.
    internals: InternalValues | None = None


#: Sightings, or T_frame_target (N, 4, 4) alone: then by instruments as they are before the fit.
SightingsOrPoses: TypeAlias = Sightings | Array

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
    #: The chains of the robot, each with the error model on it.
    _chains: tuple[tuple[Robot, ErrorModel], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Make one frame and one target stacks of one, and carry the errors over to each chain."""
        for name in ("T_frame_base", "T_tip_target"):
            stack = np.reshape(getattr(self, name), (-1, 4, 4))
            object.__setattr__(self, name, read_only(stack))
        chains = [
            (chain, model_on_chain(self.model, self.robot, chain)) for chain in self.robot.chains
        ]
        object.__setattr__(self, "_chains", tuple(chains))

    def poses(self, x: Array, samples: SamplesOrValues) -> Array:
        """Return T_frame_target, the pose of each sample's target in its measurement frame.

        Args:
            x: Shape (p,), the parameters in their units.
            samples: N samples, or joint values (N, m) of the first frame and target.

        Returns:
            Shape (N, 4, 4), [m].
        """
        if not isinstance(samples, Samples):
            samples = Samples.at(samples)
        if len(self._chains) == 1:
            return self._poses_on(self._chains[0], x, samples)
        poses = np.empty((len(samples), 4, 4))
        for number, chain in enumerate(self._chains):
            rows = samples.rows_of_chain(number)
            poses[rows] = self._poses_on(chain, x, samples.select(rows))
        return poses

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
        if not isinstance(samples, Samples):
            samples = Samples.at(samples)
        if len(self._chains) == 1:
            return self._twists_on(self._chains[0], x, samples, rotation=rotation)
        poses = np.empty((len(samples), 4, 4))
        # Samples come last in memory, as the kernel has them.
        twists = np.empty((len(x), 6 if rotation else 3, len(samples))).transpose(2, 1, 0)
        for number, chain in enumerate(self._chains):
            rows = samples.rows_of_chain(number)
            chosen = samples.select(rows)
            poses[rows], twists[rows] = self._twists_on(chain, x, chosen, rotation=rotation)
        return poses, twists

    def internals(self, x: Array, samples: Samples) -> InternalValues | None:
        """Return the internals of the instruments at x; None if those of the samples have none.

        Args:
            x: Shape (p,), the parameters in their units.
            samples: N samples.
        """
        changes = [(parameter, x[k], k) for k, parameter in self.model.internals]
        return changed_internals(samples.internals, changes)

    def sightings(self, x: Array, samples: Samples) -> Sightings:
        """Return what the readings of samples are predicted from.

        Args:
            x: Shape (p,), the parameters in their units.
            samples: N samples.
        """
        return Sightings(self.poses(x, samples), internals=self.internals(x, samples))

    def linearised(self, x: Array, samples: Samples, *, rotation: bool = True) -> Sightings:
        """Return what the readings of samples, and their derivatives by all parameters, are predicted from.

        Args:
            x: Shape (p,), the parameters in their units.
            samples: N samples.
            rotation: False if no reading depends on its target's orientation.
        """
        poses, twists = self.twists(x, samples, rotation=rotation)
        return Sightings(poses, twists, self.internals(x, samples))

    def _poses_on(self, chain: tuple[Robot, ErrorModel], x: Array, samples: Samples) -> Array:
        """Return T_frame_target, (N, 4, 4) [m], of samples of one chain at x, (p,)."""
        motion = self._displaced(chain, x)
        return kernel.poses(motion.geometry, self._chain_samples(chain, x, samples))

    def _twists_on(
        self, chain: tuple[Robot, ErrorModel], x: Array, samples: Samples, *, rotation: bool
    ) -> tuple[Array, Array]:
        """Return what `twists` returns, for samples of one chain."""
        motion = self._displaced(chain, x)
        chain_samples = self._chain_samples(chain, x, samples)
        return kernel.twists(motion, chain_samples, rotation=rotation)

    def _displaced(self, chain: tuple[Robot, ErrorModel], x: Array) -> kernel.Motion:
        """Return frames, placements and targets displaced by x, (p,), and the twists there of each parameter's unit."""
        robot, model = chain
        displacements, twists = model.displacements(x)
        twists = twists.reshape(len(displacements), 6, -1)
        first = len(self.T_frame_base)
        last = first + len(robot.placements)
        geometry = robot.geometry(
            placements=robot.placements @ displacements[first:last],
            T_frame_base=self.T_frame_base @ displacements[:first],
            T_tip_target=self.T_tip_target @ displacements[last:],
        )
        directions = kernel.Directions(
            bases=twists[:first], placements=twists[first:last], targets=twists[last:]
        )
        return kernel.Motion(geometry, directions)

    def _chain_samples(
        self, chain: tuple[Robot, ErrorModel], x: Array, samples: Samples
    ) -> kernel.ChainSamples:
        """Return the chain's n joint values, (N, n), with the joints' own errors at x, (p,), and their derivative by x.

        ModelError if an error needs the loads on the joints, and the samples have none.
        """
        robot, model = chain
        values = robot.chain_values(samples.q)
        joint_terms = list(model.joint_terms)
        mixing = model.mixing[joint_terms]
        columns = np.flatnonzero(mixing.any(axis=0))
        moved = np.zeros((*values.shape, len(columns)))
        if len(columns):
            terms = [model.terms[t] for t in joint_terms]
            moved = joint_displacements(
                robot, terms, samples.q, samples.load, samples.moves, loaded=self.robot
            )
            if model.terms is not model.parameters:  # else each moves its own
                moved = moved @ mixing[:, columns]
            values = values + moved @ x[columns]
        return kernel.ChainSamples(
            values=values,
            frame=samples.frame,
            target=samples.target,
            moved=moved,
            columns=columns,
        )
