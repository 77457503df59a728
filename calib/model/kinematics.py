"""Poses and points of a robot under an error model, with the analytic Jacobian of every parameter.

    T_frame_target(x, q) = F D_F  T_base_tip(x, q)  T D_T

with the measurement frame F, the target T in the tip, and the displacements D of `calib.model.error_model`.
Forward kinematics and the placement regressor come from Pinocchio; the rest is one product with the
parameters' directions. No finite differences anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.model.error_model import FRAME, TARGET, TIP, ErrorModel
from calib.model.robot import Robot, last_joint_poses, rigid_inverse

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Kinematics:
    """A robot under an error model, seen at a target from a measurement frame.

    Attributes:
        robot: The nominal robot.
        model: Its parameters.
        T_frame_base: shape (4, 4), [m], pose of the base in the measurement frame at x = 0.
        T_tip_target: shape (4, 4), [m], pose of the target in the tip at x = 0.
    """

    robot: Robot
    model: ErrorModel
    T_frame_base: Array
    T_tip_target: Array

    def poses(self, x: Array, q: Array) -> Array:
        """T_frame_target.

        Args:
            x: shape (p,), [m] and [rad].
            q: shape (N, n), [rad] or [m].

        Returns:
            shape (N, 4, 4), [m].
        """
        state = _Displaced.of(self, x)
        T_root_last = last_joint_poses(state.chain, self.robot.configurations(q))
        result: Array = state.T_frame_root @ T_root_last @ (state.T_last_tip @ state.T_tip_target)
        return result

    def points(self, x: Array, q: Array) -> Array:
        """The target's position in the measurement frame, shape (N, 3), [m]."""
        return self.poses(x, q)[:, :3, 3]

    def twists(self, x: Array, q: Array) -> tuple[Array, Array]:
        """T_frame_target, and the velocity of the target in a unit of each parameter.

        The twist k of row i has the target's linear velocity first, then the angular one, both along the axes of
        the measurement frame.

        Returns:
            shape (N, 4, 4), [m], and shape (N, 6, p), [m or rad per unit of the parameter].
        """
        state = _Displaced.of(self, x)
        data = state.chain.createData()
        last = state.chain.njoints - 1
        placement = pin.SE3(state.T_last_tip @ state.T_tip_target)
        count = 6 * last
        configurations = self.robot.configurations(q)
        samples = len(configurations)
        T_root_last = np.empty((samples, 4, 4))
        regressor = np.empty((samples, 6, count))
        for i, configuration in enumerate(configurations):
            # The regressor reads what forwardKinematics left in data; without that call it is silently wrong.
            pin.forwardKinematics(state.chain, data, configuration)
            T_root_last[i] = data.oMi[last].homogeneous
            regressor[i] = pin.computeJointKinematicRegressor(
                state.chain, data, last, pin.LOCAL_WORLD_ALIGNED, placement
            )
        T_frame_last = state.T_frame_root @ T_root_last
        T_frame_tip = T_frame_last @ state.T_last_tip
        T_frame_target = T_frame_tip @ state.T_tip_target

        R_frame_root = state.T_frame_root[:3, :3]
        directions = state.directions
        twists = np.empty((samples, 6, len(self.model)))
        of_joints = regressor.reshape(-1, count) @ directions[6 : 6 + count]
        of_joints = of_joints.reshape(samples, 6, len(self.model))
        twists[:, :3] = R_frame_root @ of_joints[:, :3]
        twists[:, 3:] = R_frame_root @ of_joints[:, 3:]
        point = T_frame_target[:, :3, 3]
        # The measurement frame, the tip and the target are not in Pinocchio's regressor.
        for place, pose in (
            (FRAME, np.broadcast_to(state.T_frame_base, T_frame_tip.shape)),
            (TIP, T_frame_tip),
            (TARGET, T_frame_target),
        ):
            first = 6 * self.model.places.index(place)
            local = directions[first : first + 6]
            used = np.flatnonzero(np.any(local, axis=0))
            if len(used):
                linear = pose[:, :3, :3] @ local[:3, used]
                angular = pose[:, :3, :3] @ local[3:, used]
                arm = (point - pose[:, :3, 3])[:, :, None]
                twists[:, :3, used] += linear + _cross(angular, arm)
                twists[:, 3:, used] += angular
        return T_frame_target, twists

    def points_jacobian(self, x: Array, q: Array) -> tuple[Array, Array]:
        """The target's position and its derivative, shapes (N, 3), [m], and (N, 3, p), [m per unit]."""
        poses, twists = self.twists(x, q)
        return poses[:, :3, 3], twists[:, :3]


@dataclass(frozen=True, slots=True, eq=False)
class _Displaced:
    """The placements at one x, in the form that both passes need."""

    chain: pin.Model
    T_frame_base: Array
    T_frame_root: Array
    T_last_tip: Array
    T_tip_target: Array
    directions: Array

    @classmethod
    def of(cls, kinematics: Kinematics, x: Array) -> _Displaced:
        """Displace every placement."""
        robot, model = kinematics.robot, kinematics.model
        displacement, directions = model.displacements(x)
        n = len(robot.joints)
        T_frame_base = kinematics.T_frame_base @ displacement[0]
        return cls(
            chain=robot.chain_model(robot.placements[:n] @ displacement[1 : n + 1]),
            T_frame_base=T_frame_base,
            T_frame_root=T_frame_base @ rigid_inverse(robot.T_root_base),
            T_last_tip=robot.placements[n] @ displacement[n + 1],
            T_tip_target=kinematics.T_tip_target @ displacement[n + 2],
            directions=directions,
        )


def _cross(a: Array, b: Array) -> Array:
    """The product a x b along axis 1, shapes (N, 3, k) and (N, 3, 1): `numpy.cross` takes ten times as long."""
    result = np.empty_like(a)
    result[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    result[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    result[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return result
