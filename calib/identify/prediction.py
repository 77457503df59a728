"""Where a result puts its targets, and how sure that is.

A predicted pose's standard deviations are those of J dx, sqrt(trace(J C J^T)), with the parameters' covariance C and
the derivative J of the predicted pose. Sockets, planes, anchors and pairs tell neither where the base stands nor how it
is turned: what moves all poses as one body is then known by the priors alone, whatever these may be. So predictions in
the base leave it out there: the rigid motion of the base that makes up best for what a parameter does at the measured
poses is taken off J, wherever else it is asked.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.kinds as registry
from calib.errors import ModelError, choices
from calib.identify.coverage import OutsideRow, outside
from calib.identify.findings import ParameterEstimate
from calib.identify.rigid_motion import best_motion, moved_by
from calib.identify.setup import Setup
from calib.identify.statistics import CrossValidation
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameters import FRAME, TARGET, ErrorModel
from calib.model.robot import Robot, read_only, rigid_inverse
from calib.model.torques import Payload, gravity_load

Array = NDArray[np.float64]

#: Values that stand for all those between the ends of a measured range.
_BETWEEN = 73

#: Poses over which expected errors are averaged; more do not change them.
_MOST_EXPECTED = 1000

#: Measured poses that say what a motion of the base makes up for; more do not change it.
_ENOUGH = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Larger:
    """A model with errors of the joints' state, which no URDF can hold.

    Attributes:
        kinematics: The nominal robot under it, with its own frames and targets where the estimation started.
        x: shape (p,), its parameters.
        covariance: shape (p, p), of ``x``.
        sizes: Size of the errors of each family.
        parameters: One entry for each element of ``x``.
        setup: Its own frames and targets.
        residual: shape (N, D), measured minus predicted, all rows [m], [rad].
        cross_validation: Errors on left-out rows; None where it was not asked for.
        base_motion: As that of `calib.identify.result.Calibration`.
        payload: What the tip carried; None where nothing was said.
        gravity: shape (3,), in the URDF's root frame [m/s^2].
    """

    kinematics: Kinematics
    x: Array
    covariance: Array
    sizes: Mapping[str, float]
    parameters: tuple[ParameterEstimate, ...]
    setup: Setup
    residual: Array
    cross_validation: CrossValidation | None
    base_motion: Array | None
    payload: Payload | None
    gravity: Array

    @property
    def model(self) -> ErrorModel:
        """Its error model."""
        return self.kinematics.model

    @property
    def name(self) -> str:
        """Its set and families, such as ``"dh+compliance"``."""
        return self.model.name

    def load(self, nominal: Robot, q: Array, payload: Payload | None = None) -> Array:
        """The load that gravity puts on the joints, shape (N, n), [Nm] or [N].

        Args:
            nominal: The nominal robot.
            q: shape (N, m), joint values [rad] or [m].
            payload: What the tip carries; None: what it carried when it was calibrated.
        """
        return gravity_load(nominal, q, payload or self.payload, self.gravity)


class Predictor:
    """What a `calib.identify.result.Calibration` says of joint values; its fields are documented there."""

    __slots__ = ()

    nominal: Robot
    robot: Robot
    setup: Setup
    kinematics: Kinematics
    x: Array
    covariance: Array
    base_motion: Array | None
    ranges: Array
    cross_validation: CrossValidation | None
    larger: Larger | None

    @property
    def model(self) -> ErrorModel:
        """The error model of the geometry, which the URDF holds."""
        return self.kinematics.model

    @property
    def kinds(self) -> frozenset[str]:
        """What the rows measure."""
        raise NotImplementedError

    def samples(
        self, q: ArrayLike, *, target: str | None = None, group: str | None = None
    ) -> Samples:
        """Joint values as a prediction takes them, with the load that gravity and payload put on the joints.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; the first where None.
            group: Name of the set-up whose frame is meant; the first where None.

        Raises:
            ModelError: No such target or set-up.
        """
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        load = None
        if self.larger is not None:
            load = self.larger.load(self.nominal, values)
        return replace(
            Samples.at(values, load),
            frame=np.full(len(values), _number(group, self.setup.groups, "set-up")),
            target=np.full(len(values), _number(target, self.setup.targets, "target")),
        )

    def predict(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        larger: bool = True,
    ) -> Array:
        """Where the calibrated robot puts the target, in the measurement frame, or in the base where there is none.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
            target: Name of the target; the first where None.
            group: Name of the set-up whose frame is meant; where None the first, and the base where only sockets,
                planes, anchors or pairs were measured.
            larger: Whether to use the larger model, where there is one; else the geometry that the URDF holds.

        Returns:
            shape (N, 3), [m].
        """
        return self.predict_poses(q, target=target, group=group, larger=larger)[:, :3, 3]

    def predict_poses(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        larger: bool = True,
    ) -> Array:
        """The target's pose, shape (N, 4, 4), [m]; frame and arguments are those of `predict`."""
        part = self.part(larger=larger)
        poses = part.kinematics.poses(part.x, self.samples(q, target=target, group=group))
        if group is None and not self.tells_place:
            poses = rigid_inverse(part.setup.T_frame_base[0]) @ poses
        return poses

    def position_std(
        self,
        q: ArrayLike,
        *,
        target: str | None = None,
        group: str | None = None,
        larger: bool = True,
    ) -> Array:
        """How sure `predict` is, sqrt(trace(J C J^T)), shape (N,), [m]; the arguments are those of `predict`.

        C is the covariance of the parameters, J the derivative of the predicted position; where only sockets, planes,
        anchors or pairs were measured, and no group is named, less what moves all positions as one body. It knows
        nothing of errors that the model lacks.
        """
        part = self.part(larger=larger)
        samples = self.samples(q, target=target, group=group)
        if group is None and part.base_motion is not None:
            return base_std(part.kinematics, part.x, part.covariance, samples, part.base_motion)[
                :, 0
            ]
        return pose_std(part.kinematics, part.x, part.covariance, samples)[:, 0]

    def tool_std(
        self,
        q: ArrayLike,
        T_tip_tool: Array,
        *,
        target: str | None = None,
        group: str | None = None,
    ) -> Array:
        """How sure it is where the corrected robot puts a tool, by the covariance of the geometry.

        Args:
            q: shape (N, m), joint values [rad] or [m].
            T_tip_tool: shape (4, 4), the tool in the tip [m]; known exactly, unless it is a target.
            target: Name of the target that the tool is; its estimate is then part of what is not sure.
            group: Name of the set-up in whose frame the pose is asked for; where it stands is part of it, too. None:
                in the base.

        Returns:
            shape (N, 2), standard deviations: of the position [m], of the angle [rad].

        Raises:
            ModelError: No such target or set-up.
        """
        samples = self.samples(q, target=target, group=group)
        kinematics, x, C, motion = self.kinematics, self.x, self.covariance, self.base_motion
        if target is None:
            own = self.model.family(TARGET)
            tools = np.broadcast_to(T_tip_tool, kinematics.T_tip_target.shape)
            kinematics, x = replace(kinematics, T_tip_target=tools), np.where(own, 0.0, x)
            C = np.where(own[:, None] | own, 0.0, C)
        if group is None:
            return base_std(kinematics, x, C, samples, motion)
        return pose_std(kinematics, x, C, samples)

    def tip_poses(self, q: ArrayLike, *, payload: Payload | None = None) -> Array:
        """T_base_tip by the larger model, or by the corrected origins where there is none, shape (N, 4, 4), [m].

        Args:
            q: shape (N, m), joint values [rad] or [m].
            payload: What the tip carries; None: what it carried when it was calibrated.
        """
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        if self.larger is None:
            return self.robot.poses(values)
        load = self.larger.load(self.nominal, values, payload)
        return tip_poses(self.larger, Samples.at(values, load))

    def outside_of_measured(self, q: ArrayLike) -> tuple[OutsideRow, ...]:
        """Which joint values lie outside of the range that the fit has seen, where errors may be larger than expected.

        Args:
            q: shape (N, m) or (m,), joint values in the robot's order, [rad] or [m].
        """
        if not np.isfinite(self.ranges).all():
            return ()
        seen = np.linspace(self.ranges[:, 0], self.ranges[:, 1], _BETWEEN)
        types = [joint.type for joint in self.nominal.inputs]
        asked = np.atleast_2d(np.asarray(q, dtype=np.float64))
        return outside(seen, asked, self.nominal.joint_names, types)

    @property
    def tells_place(self) -> bool:
        """Whether any row tells where the base stands; otherwise predictions are in the base."""
        return tells_place(self.kinds)

    def part(self, *, larger: bool) -> Predictor | Larger:
        """What to predict with: the larger model, where it is asked for and there is one, or the geometry."""
        return self.larger if larger and self.larger is not None else self


def pose_std(kinematics: Kinematics, x: Array, covariance: Array, samples: Samples) -> Array:
    """Standard deviations of predicted poses, sqrt(trace(J C J^T)), shape (N, 2): position [m] and angle [rad].

    Args:
        kinematics: Of the fit.
        x: shape (p,), its parameters.
        covariance: shape (p, p), of ``x``.
        samples: N joint values, each with its frame and target.
    """
    return _spread(kinematics.twists(x, samples)[1], covariance)


def base_std(
    kinematics: Kinematics, x: Array, covariance: Array, samples: Samples, motion: Array | None
) -> Array:
    """The same of poses in the base, shape (N, 2), less a motion of the base; the other arguments are those above.

    Args:
        kinematics: Of the fit.
        x: shape (p,), its parameters.
        covariance: shape (p, p), of ``x``.
        samples: N joint values, each with its target.
        motion: shape (6, p), see `base_motion`; None for none.
    """
    poses, twists = _in_base(kinematics, x, samples)
    if motion is not None:
        twists[:, :3] -= moved_by(motion, poses[:, :3, 3])
        twists[:, 3:] -= motion[3:]
    return _spread(twists, covariance)


def base_motion(kinematics: Kinematics, x: Array, samples: Samples) -> Array:
    """The motion of the base that makes up best for a unit of each parameter, over some poses, shape (6, p).

    Args:
        kinematics: Of the fit.
        x: shape (p,), its parameters.
        samples: The poses that were measured.
    """
    some = samples.select(np.linspace(0, len(samples) - 1, min(len(samples), _ENOUGH)).astype(int))
    poses, twists = _in_base(kinematics, x, some)
    return read_only(best_motion(poses[:, :3, 3], twists[:, :3]))


def expected_error(
    kinematics: Kinematics, x: Array, covariance: Array, samples: Samples, motion: Array | None
) -> float:
    """Standard deviation of the predicted position over some samples, a thousand at most, rms [m].

    Args:
        kinematics: Of the fit.
        x: shape (p,), its parameters.
        covariance: shape (p, p), of ``x``.
        samples: Joint values, each with its frame and target.
        motion: Of the base, where the measurements do not tell where that stands.
    """
    chosen = samples.select(slice(0, _MOST_EXPECTED))
    if motion is None:
        std = pose_std(kinematics, x, covariance, chosen)
    else:
        std = base_std(kinematics, x, covariance, chosen, motion)
    return float(np.sqrt(np.mean(std[:, 0] ** 2)))


def _in_base(kinematics: Kinematics, x: Array, samples: Samples) -> tuple[Array, Array]:
    """T_base_target, shape (N, 4, 4), and what a unit of each parameter does to it, shape (N, 6, p); frames nothing."""
    of_frame = kinematics.model.family(FRAME)
    frames = np.broadcast_to(np.eye(4), kinematics.T_frame_base.shape)
    in_base = replace(kinematics, T_frame_base=frames)
    poses, twists = in_base.twists(np.where(of_frame, 0.0, x), samples)
    return poses, np.where(of_frame, 0.0, twists)


def _spread(twists: Array, covariance: Array) -> Array:
    """The root of the summed variances of a position, and of an angle, shape (N, 2)."""
    wide = (twists.reshape(-1, len(covariance)) @ covariance).reshape(twists.shape)
    variance = np.sum(wide * twists, axis=2).reshape(-1, 2, 3).sum(axis=2)
    return read_only(np.sqrt(np.maximum(variance, 0.0)))


def tip_poses(part: Predictor | Larger, samples: Samples) -> Array:
    """T_base_tip by the parameters, the joints' own errors included, shape (N, 4, 4), [m].

    Args:
        part: A result, or its larger model.
        samples: Joint values, with the loads that the model needs.
    """
    T = part.kinematics.poses(part.x, samples)
    into_base = np.linalg.inv(part.setup.T_frame_base)[samples.frame]
    return np.asarray(into_base @ T @ np.linalg.inv(part.setup.T_tip_target)[samples.target])


def tells_place(kinds: Iterable[str]) -> bool:
    """Whether rows of these kinds tell where the base stands; otherwise predictions are in the base."""
    return any(registry.get(kind).position for kind in kinds)


def _number(name: str | None, names: tuple[str, ...], what: str) -> int:
    """The place of a name among names; 0 where none is given.

    Raises:
        ModelError: There is no such name.
    """
    if name is None:
        return 0
    if name not in names:
        raise ModelError(f"There is no {what} '{name}'; there is {choices(names)}.")
    return names.index(name)
