"""True robots of `verification_study.py`, made without `calib.fit.estimate`.

Forward kinematics and gravity come from Pinocchio, on a model of the URDF that the true robot writes. The errors of the
joints' state, and joint values that bring a target to a socket or a plane, are computed here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from studies import draw_errors

from calib.basics.arrays import Array
from calib.model.parameter_sets import error_model
from calib.numerics.geometry import pose_of
from calib.robot.gravity import Payload
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot

#: Position of the target in the tip [m].
TARGET = (-0.06, 0.07, 0.03)

#: Standard deviation of errors that are lengths [m].
LENGTH = 0.5e-3

#: Standard deviation of errors that are angles [rad].
ANGLE = 3e-3


@dataclass(frozen=True, slots=True, eq=False)
class JointErrors:
    """Errors of the joints' state: dq = gain q + sin sin(q) + cos cos(q) + compliance load, shape (n,) each."""

    gain: Array  # [-]
    sin: Array  # of the eccentricity [rad]
    cos: Array  # of the eccentricity [rad]
    compliance: Array  # [rad/Nm]

    @classmethod
    def none(cls, count: int) -> JointErrors:
        """Return errors of zero of so many joints."""
        zeros = np.zeros(count)
        return cls(zeros, zeros, zeros, zeros)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """A true robot, and the targets on it."""

    nominal: Robot  # The robot that calib is given
    x: Array  # shape (p,), the geometric errors
    model: str  # Name of the model that x belongs to
    robot: Robot  # The true geometry
    targets: Array  # shape (T, 4, 4), T_tip_target [m]
    state: JointErrors
    payload: Payload | None = None
    _pin: pin.Model = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Build Pinocchio's model of the URDF."""
        model = pin.buildModelFromXML(self.robot.urdf.data.decode())
        frame = model.frames[model.getFrameId(self.robot.tip)]
        if self.payload is not None:
            com = np.array(self.payload.com)
            mass = pin.Inertia(self.payload.mass, com, np.zeros((3, 3)))
            model.appendBodyToJoint(frame.parentJoint, mass, frame.placement)
        object.__setattr__(self, "_pin", model)

    @classmethod
    def draw(
        cls,
        nominal: Robot,
        rng: np.random.Generator,
        model: str = "dh",
        *,
        targets: int = 1,
        rotation: bool = False,
        compliance: float = 0.0,
        payload: Payload | None = None,
    ) -> Truth:
        """Draw the geometric errors of a robot, with standard deviations `LENGTH` and `ANGLE`, and its targets.

        Args:
            nominal: The nominal robot.
            rng: Random numbers.
            model: Model of the errors that are drawn.
            targets: Number of targets.
            rotation: The targets are turned anyhow; their axes are those of the tip otherwise.
            compliance: Compliance of each joint [rad/Nm].
            payload: Payload of the tip.
        """
        parameters = error_model(nominal, model, target=False)
        x = draw_errors(parameters, LENGTH, ANGLE, rng)
        T_tip_target = np.tile(np.eye(4), (targets, 1, 1))
        T_tip_target[:, :3, 3] = np.array(TARGET) + np.linspace(0.0, 0.1, targets)[:, None]
        T_tip_target[:, :3, 3] += 5e-3 * rng.normal(size=(targets, 3))
        if rotation:
            for T in T_tip_target:
                T[:3, :3] = pin.exp3(0.5 * rng.normal(size=3))
        joints = len(nominal.joints)
        zeros = np.zeros(joints)
        state = JointErrors(zeros, zeros, zeros, np.full(joints, compliance))
        true = parameters.apply(nominal, x) if len(x) else nominal
        return cls(nominal, x, model, true, T_tip_target, state, payload)

    def load(self, values: Mapping[str, Array]) -> Array:
        """Return the torque of gravity on each joint of the chain, shape (N, n), [Nm].

        Args:
            values: Values of the URDF's joints by name, shape (N,) each, [rad] or [m].
        """
        data = self._pin.createData()
        columns = self._velocity_columns()
        torques = []
        for configuration in self._configurations(values):
            torque = pin.computeGeneralizedGravity(self._pin, data, configuration)
            torques.append(-torque[columns])
        return np.array(torques)

    def joint_values(self, q: Array) -> dict[str, Array]:
        """Return the true values of the URDF's joints by name, shape (N,) each, [rad] or [m].

        Args:
            q: shape (N, m), joint values that the controller reads [rad] or [m].
        """
        read = self.robot.urdf_values(q)
        state = self.state
        unloaded = dict(read)
        for i, joint in enumerate(self.robot.joints):
            value = read[joint.name]
            error = state.gain[i] * value
            error = error + state.sin[i] * np.sin(value) + state.cos[i] * np.cos(value)
            unloaded[joint.name] = value + error
        if not np.any(state.compliance):
            return unloaded
        true = unloaded
        for _ in range(4):  # the load is that where the arm has sagged to
            sag = self.load(true) * state.compliance
            true = dict(unloaded)
            for i, joint in enumerate(self.robot.joints):
                true[joint.name] = unloaded[joint.name] + sag[:, i]
        return true

    def poses(self, q: Array, target: int | NDArray[np.int_] = 0) -> Array:
        """Return T_base_target, shape (N, 4, 4), [m].

        Args:
            q: shape (N, m), joint values that the controller reads [rad] or [m].
            target: Number of the target, from 0; of all rows or of each, shape (N,).
        """
        model, data = self._pin, self._pin.createData()
        base, tip = (model.getFrameId(link) for link in (self.robot.base, self.robot.tip))
        of_target = np.broadcast_to(target, (len(q),))
        result = np.empty((len(q), 4, 4))
        for i, configuration in enumerate(self._configurations(self.joint_values(q))):
            pin.framesForwardKinematics(model, data, configuration)
            T_base_tip = data.oMf[base].actInv(data.oMf[tip]).homogeneous
            result[i] = T_base_tip @ self.targets[of_target[i]]
        return result

    def points(self, q: Array, target: int | NDArray[np.int_] = 0) -> Array:
        """Return positions of a target in the base, shape (N, 3), [m]; arguments as for `poses`."""
        return self.poses(q, target)[:, :3, 3]

    def reach(self, directions: Array, heights: Array, q: Array) -> Array:
        """Find joint values at which the first target is at given heights along some directions, by Newton's method.

        Args:
            directions: shape (k, 3), unit vectors in the base.
            heights: shape (N, k), heights along them of each row [m].
            q: shape (N, m), joint values to start from [rad].

        Returns:
            shape (M, m), joint values of the rows for which it succeeds [rad].
        """
        q = q.copy()
        identity = np.eye(len(directions))
        for _ in range(20):
            residual = self.points(q) @ directions.T - heights
            if np.abs(residual).max() < 1e-11:
                break
            J = directions @ self._position_jacobian(q)
            gram = J @ J.transpose(0, 2, 1) + 1e-9 * identity
            multiplier = np.linalg.solve(gram, residual[:, :, None])[:, :, 0]
            step = -np.einsum("nkj,nk->nj", J, multiplier)
            largest = np.maximum(np.abs(step).max(axis=1), 1e-12)
            q = q + step * np.minimum(1.0, 0.3 / largest)[:, None]
        q = np.arctan2(np.sin(q), np.cos(q))
        error = np.abs(self.points(q) @ directions.T - heights).max(axis=1)
        reached: Array = q[error < 1e-10]
        return reached

    def _velocity_columns(self) -> list[int]:
        """Return the columns of the chain's joints in Pinocchio's velocity vectors."""
        model = self._pin
        return [model.idx_vs[model.getJointId(joint.name)] for joint in self.robot.joints]

    def _configurations(self, values: Mapping[str, Array]) -> Array:
        """Return Pinocchio's configuration vectors, shape (N, nq), of joint values by name."""
        count = len(next(iter(values.values())))
        result = np.tile(pin.neutral(self._pin), (count, 1))
        for name, value in values.items():
            joint = self._pin.getJointId(name)
            first = self._pin.idx_qs[joint]
            if self._pin.nqs[joint] == 2:  # a joint without limits: cosine and sine
                result[:, first] = np.cos(value)
                result[:, first + 1] = np.sin(value)
            else:
                result[:, first] = value
        return result

    def _position_jacobian(self, q: Array) -> Array:
        """Return the derivative of the first target's position by q, shape (N, 3, m), [m/rad]: it steers `reach`."""
        model, data = self._pin, self._pin.createData()
        base, tip = (model.getFrameId(link) for link in (self.robot.base, self.robot.tip))
        columns = self._velocity_columns()
        local = pin.ReferenceFrame.LOCAL
        result = np.empty((len(q), 3, q.shape[1]))
        for i, configuration in enumerate(self._configurations(self.joint_values(q))):
            J = pin.computeFrameJacobian(model, data, configuration, tip, local)[:, columns]
            pin.framesForwardKinematics(model, data, configuration)
            R_base_tip = data.oMf[base].rotation.T @ data.oMf[tip].rotation
            linear = J[:3] - pin.skew(self.targets[0, :3, 3]) @ J[3:]
            result[i] = R_base_tip @ linear @ self.robot.mimic_matrix
        return result


def draw_joint_values(robot: Robot, count: int, rng: np.random.Generator) -> Array:
    """Draw joint values inside the limits, shape (count, m), [rad] or [m]."""
    return random_joint_values(robot, count, int(rng.integers(2**31)))


def draw_frame(rng: np.random.Generator) -> Array:
    """Draw the pose of the base in a tracker's frame, shape (4, 4), [m]."""
    R = pin.exp3(rng.uniform(-2.0, 2.0, size=3))
    return pose_of(rng.uniform(-2.0, 2.0, size=3), R)
