"""Poses and points of a robot under an error model, with the analytic Jacobian of every parameter.

    T_frame_target(x, q) = F D_F  T_base_tip(x, q + dq)  T D_T

with the measurement frame F, the target T in the tip, the displacements D of `calib.model.error_model` and the
joints' own errors dq of `calib.model.joint_errors`. Forward kinematics and the placement regressor come from
Pinocchio; the rest is one product with the parameters' directions. No finite differences anywhere. From
`calib.model.batch.MANY` samples on `calib.model.kernel` computes the same, compiled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError, choices
from calib.model.batch import MANY, Displaced, points_of, poses_of, twists_of
from calib.model.joint_errors import axis_twists, joint_displacements
from calib.model.parameters import FRAME, TARGET, TIP, ErrorModel
from calib.model.robot import Robot, last_joint_poses, read_only

Array = NDArray[np.float64]

#: The other two axes of each, in the order of a right-handed frame.
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Where the robot stood, and which frame saw which target.

    Attributes:
        q: shape (N, m), values of the measured joints, [rad] or [m].
        frame: shape (N,), which of the measurement frames; all zero where there is one.
        target: shape (N,), which of the targets.
        load: shape (N, n), load on each joint of the chain [Nm, N]; None where it is not known.
    """

    q: Array
    frame: NDArray[np.int_]
    target: NDArray[np.int_]
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
    """A robot under an error model, seen at targets from measurement frames.

    Attributes:
        robot: The nominal robot.
        model: Its parameters.
        T_frame_base: shape (F, 4, 4) or (4, 4), [m], pose of the base in each measurement frame at x = 0.
        T_tip_target: shape (T, 4, 4) or (4, 4), [m], pose of each target in the tip at x = 0.

    Raises:
        ModelError: There are more or fewer frames or targets than the model has places for.
    """

    robot: Robot
    model: ErrorModel
    T_frame_base: Array
    T_tip_target: Array
    _axes: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """One frame and one target become stacks of one; refuse another number of them than the model has."""
        for name, kind in (("T_frame_base", FRAME), ("T_tip_target", TARGET)):
            stack = np.reshape(getattr(self, name), (-1, 4, 4))
            object.__setattr__(self, name, read_only(stack))
            places = [place for place in self.model.places if place.startswith(kind)]
            if len(stack) != len(places):
                message = (
                    f"{len(stack)} poses {name} were given; the model '{self.model.name}' has {len(places)} such "
                    f"places: {choices(places)}."
                )
                raise ModelError(message)
        object.__setattr__(self, "_axes", axis_twists(self.robot))

    def poses(self, x: Array, where: Where) -> Array:
        """T_frame_target.

        Args:
            x: shape (p,), [m] and [rad].
            where: N samples, or joint values of shape (N, m), [rad] or [m].

        Returns:
            shape (N, 4, 4), [m].
        """
        samples = where if isinstance(where, Samples) else Samples.at(where)
        if len(samples) >= MANY:
            return poses_of(self, x, samples)
        state = Displaced.of(self, x)
        values, _ = self._chain_values(x, samples)
        chain = self.robot.chain_model(state.placements)
        T_root_last = last_joint_poses(chain, self.robot.configurations(values))
        T_last_target = state.T_last_tip @ state.T_tip_target
        result: Array = (
            state.T_frame_root[samples.frame] @ T_root_last @ T_last_target[samples.target]
        )
        return result

    def points(self, x: Array, where: Where) -> Array:
        """The target's position in the measurement frame, shape (N, 3), [m]."""
        samples = where if isinstance(where, Samples) else Samples.at(where)
        if len(samples) >= MANY:
            return points_of(self, x, samples)
        return self.poses(x, samples)[:, :3, 3]

    def twists(self, x: Array, where: Where) -> tuple[Array, Array]:
        """T_frame_target, and the velocity of the target in a unit of each parameter.

        The twist k of row i has the target's linear velocity first, then the angular one, both along the axes of
        the measurement frame.

        Returns:
            shape (N, 4, 4), [m], and shape (N, 6, p), [m or rad per unit of the parameter].
        """
        samples = where if isinstance(where, Samples) else Samples.at(where)
        if len(samples) >= MANY:
            return twists_of(self, x, samples)
        state = Displaced.of(self, x)
        values, moved = self._chain_values(x, samples)
        T_root_last, regressor = _regressor(
            self.robot.chain_model(state.placements),
            self.robot.configurations(values),
            state.T_last_tip @ state.T_tip_target,
            samples.target,
        )
        T_frame_tip = state.T_frame_root[samples.frame] @ T_root_last @ state.T_last_tip
        T_frame_target = T_frame_tip @ state.T_tip_target[samples.target]

        R_frame_root = state.T_frame_root[samples.frame][:, :3, :3]
        directions, count = state.directions, regressor.shape[2]
        first = 6 * self.model.places.index(self.robot.joints[0].name)
        of_joints = regressor.reshape(-1, count) @ directions[first : first + count]
        of_joints = of_joints.reshape(len(samples), 6, len(self.model))
        if moved is not None:
            # The same regressor, along each joint's own axis, times how far a unit of the parameter moves that joint.
            own = np.einsum("nkij,ij->nki", regressor.reshape(len(samples), 6, -1, 6), self._axes)
            of_joints += own @ moved
        twists = np.empty_like(of_joints)
        twists[:, :3] = R_frame_root @ of_joints[:, :3]
        twists[:, 3:] = R_frame_root @ of_joints[:, 3:]
        T_frame_base = state.T_frame_base[samples.frame]
        add_outer_twists(
            twists,
            self.model.places,
            directions,
            samples,
            (T_frame_base, T_frame_tip, T_frame_target),
        )
        return T_frame_target, twists

    def points_jacobian(self, x: Array, where: Where) -> tuple[Array, Array]:
        """The target's position and its derivative, shapes (N, 3), [m], and (N, 3, p), [m per unit]."""
        poses, twists = self.twists(x, where)
        return poses[:, :3, 3], twists[:, :3]

    def _chain_values(self, x: Array, samples: Samples) -> tuple[Array, Array | None]:
        """The chain's joint values with the joints' own errors, (N, n), and what a unit of x adds, (N, n, p)."""
        values = self.robot.chain_values(samples.q)
        chosen = list(self.model.joint_terms)
        if not chosen:
            return values, None
        terms = [self.model.terms[t] for t in chosen]
        moved = joint_displacements(self.robot, terms, samples.q, samples.load)
        moved = moved @ self.model.mixing[chosen]
        return values + moved @ x, moved


def add_outer_twists(
    twists: Array,
    places: Sequence[str],
    directions: Array,
    samples: Samples,
    poses: tuple[Array, Array, Array],
) -> None:
    """Add what the measurement frames, the tip and the targets do, which are not in Pinocchio's regressor.

    Args:
        twists: shape (N, 6, p), added to in place.
        places: See `ErrorModel.places`.
        directions: shape (6 len(places), p), see `ErrorModel.displacements`.
        samples: N of them.
        poses: Of base, tip and target of each sample in its frame, each of shape (N, 4, 4), [m].
    """
    point = poses[2][:, :3, 3]
    tip, outer = _outer_places(tuple(places))
    for k in outer:
        local = directions[6 * k : 6 * k + 6]
        used = np.flatnonzero(local.any(axis=0))
        if not len(used):
            continue
        # Columns between them, which do not act here, add nothing.
        first, last = int(used[0]), int(used[-1]) + 1
        local = local[:, first:last]
        if k == tip:
            seen, pose = None, poses[1]
        elif k < tip:
            seen, pose = samples.frame == k, poses[0]
        else:
            seen, pose = samples.target == k - tip - 1, poses[2]
        if seen is None or seen.all():
            twists[:, :, first:last] += _moved_with(pose, point, local)
        else:
            twists[seen, :, first:last] += _moved_with(pose[seen], point[seen], local)


@lru_cache(maxsize=64)
def _outer_places(places: tuple[str, ...]) -> tuple[int, tuple[int, ...]]:
    """The number of the tip, and those of all places that are no joint's."""
    tip = places.index(TIP)
    outer = (k for k, one in enumerate(places) if k == tip or one.startswith((FRAME, TARGET)))
    return tip, tuple(outer)


def _moved_with(T: Array, point: Array, local: Array) -> Array:
    """The twists of points that local twists of a body carry along, shape (N, 6, k).

    Args:
        T: Poses of the body, shape (N, 4, 4), [m].
        point: shape (N, 3), [m].
        local: shape (6, k), in the body's own axes.
    """
    R = T[:, :3, :3]
    twists = np.zeros((len(T), 6, local.shape[1]))
    twists[:, :3] = R @ local[:3]
    if local[3:].any():
        angular = R @ local[3:]
        twists[:, :3] += _cross(angular, (point - T[:, :3, 3])[:, :, None])
        twists[:, 3:] = angular
    return twists


def _regressor(
    chain: pin.Model, configurations: Array, T_last_target: Array, target: NDArray[np.int_]
) -> tuple[Array, Array]:
    """The last joint's pose, (N, 4, 4), and the target's placement regressor, (N, 6, 6 n), along the root's axes."""
    data = chain.createData()
    last = chain.njoints - 1
    pose = data.oMi[last]  # as forwardKinematics writes it
    T_root_last = np.empty((len(configurations), 4, 4))
    regressor = np.empty((len(configurations), 6, 6 * last))
    placements = [pin.SE3(T) for T in T_last_target]
    for i, (configuration, t) in enumerate(zip(configurations, target.tolist(), strict=True)):
        # The regressor reads what forwardKinematics left in data; without that call it is silently wrong.
        pin.forwardKinematics(chain, data, configuration)
        T_root_last[i] = pose.homogeneous
        regressor[i] = pin.computeJointKinematicRegressor(
            chain, data, last, pin.LOCAL_WORLD_ALIGNED, placements[t]
        )
    return T_root_last, regressor


def _cross(a: Array, b: Array) -> Array:
    """The product a x b along axis 1, shapes (N, 3, k) and (N, 3, 1): `numpy.cross` takes ten times as long."""
    return np.asarray(a[:, _NEXT] * b[:, _LAST] - a[:, _LAST] * b[:, _NEXT])
