"""Where a result puts its targets, and how sure that is.

A predicted pose's standard deviations are those of J dx, sqrt(trace(J C J^T)), with the parameters' covariance C and
the derivative J of the very pose that is predicted: in the measurement frame, or in the base where sockets, planes,
anchors or pairs alone were measured. These tell neither where the base stands nor how it is turned, so what moves all
poses as one body is then known by the priors only, and is part of the standard deviation all the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.kinds as registry
from calib.errors import ModelError, choices
from calib.identify.coverage import OutsideRow, outside
from calib.identify.findings import ParameterEstimate
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

        C is the covariance of the parameters, J the derivative of the predicted position, in the same frame as
        `predict`. It knows nothing of errors that the model lacks.
        """
        part = self.part(larger=larger)
        in_base = group is None and not self.tells_place
        samples = self.samples(q, target=target, group=group)
        return pose_std(
            part.kinematics, part.x, part.covariance, samples, without=(FRAME,) if in_base else ()
        )[:, 0]

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
        known = tuple(f for f, named in ((FRAME, group), (TARGET, target)) if named is None)
        samples = self.samples(q, target=target, group=group)
        if target is not None:
            return pose_std(self.kinematics, self.x, self.covariance, samples, without=known)
        tools = np.broadcast_to(T_tip_tool, self.kinematics.T_tip_target.shape)
        x = np.where(self.model.family(TARGET), 0.0, self.x)
        tool = replace(self.kinematics, T_tip_target=tools)
        return pose_std(tool, x, self.covariance, samples, without=known)

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


def pose_std(
    kinematics: Kinematics,
    x: Array,
    covariance: Array,
    samples: Samples,
    *,
    without: tuple[str, ...] = (),
) -> Array:
    """Standard deviations of predicted poses, sqrt(trace(J C J^T)), shape (N, 2): position [m] and angle [rad].

    Args:
        kinematics: Of the fit.
        x: shape (p,), its parameters.
        covariance: shape (p, p), of ``x``.
        samples: N joint values, each with its frame and target.
        without: Families of parameters that are taken as exact, such as `FRAME` for predictions in the base.
    """
    chosen = np.flatnonzero(~kinematics.model.family(*without))
    twists = kinematics.twists(x, samples)[1][:, :, chosen]
    covariance = covariance[np.ix_(chosen, chosen)]
    wide = (twists.reshape(-1, len(chosen)) @ covariance).reshape(twists.shape)
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


def expected_error(
    kinematics: Kinematics, x: Array, covariance: Array, samples: Samples, *, in_base: bool
) -> float:
    """Standard deviation of the predicted position over some samples, a thousand at most, rms [m].

    Args:
        kinematics: Of the fit.
        x: shape (p,), its parameters.
        covariance: shape (p, p), of ``x``.
        samples: Joint values, each with its frame and target.
        in_base: Whether positions in the base are meant, not in the measurement frame.
    """
    chosen = samples.select(slice(0, _MOST_EXPECTED))
    without = (FRAME,) if in_base else ()
    std = pose_std(kinematics, x, covariance, chosen, without=without)[:, 0]
    return float(np.sqrt(np.mean(std**2)))


def tells_place(kinds: frozenset[str]) -> bool:
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
        message = f"There is no {what} '{name}'; there is {choices(names)}."
        raise ModelError(message)
    return names.index(name)
