"""Pair: what a robot's controller believes, and what is true of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.compensate.arm import Arm
from calib.errors import ModelError, choices
from calib.families import FAMILIES
from calib.identify.prediction import Larger
from calib.identify.result import Calibration
from calib.model.error_model import split_name
from calib.model.readback import spread_poses
from calib.model.robot import Robot, read_only
from calib.model.torques import Payload

Array = NDArray[np.float64]

_NO_ROTATION = 1e-6

#: Origins of one robot differ by rounding [m; rotation matrices: 1].
_SAME = 1e-9

#: Two robots whose tools are typically further apart than this share of their reach are no calibration of each other;
#: looked at in so many poses.
_NO_CALIBRATION, _POSES = 0.1, 64


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """The same tool on the robot that the controller believes to have, and on the true one.

    Attributes:
        believed: The nominal model, with the tool where it is believed to be.
        true: The calibrated model, with the tool where it is.
        T_frame_base: shape (4, 4), the base in the frame that poses are given and sent in [m].
        target: Name of the target that the tool is; None where it is none.
        set_up: Name of the set-up whose frame it is; None where it is none.
        result: What is known of the true robot and how far to trust it; None where two robots were given.
    """

    believed: Arm
    true: Arm
    T_frame_base: Array
    target: str | None = None
    set_up: str | None = None
    result: Calibration | None = None

    @classmethod
    def of(
        cls,
        calibration: Calibration | Robot,
        nominal: Robot | None = None,
        *,
        tool: ArrayLike | str | None = None,
        frame: ArrayLike | str | None = None,
        larger: bool = True,
        payload: Payload | None = None,
    ) -> Pair:
        """The two models; the arguments are those of `calib.compensate.commands.commands`.

        Raises:
            ModelError: No nominal robot, one with other joints, or a tool or frame that there is not.
            UrdfError: The robot lacks joints of the result.
        """
        if isinstance(calibration, Calibration):
            nominal = calibration.nominal if nominal is None else nominal
        if nominal is None:
            message = (
                "Commands need the robot as its controller has it, beside the calibrated one. "
                "Give the nominal robot too."
            )
            raise ModelError(message)
        if isinstance(calibration, Robot):
            return cls._of_robots(nominal, calibration, tool, frame)
        return cls._of_result(nominal, calibration, tool, frame, payload, larger=larger)

    @classmethod
    def _of_robots(
        cls,
        nominal: Robot,
        corrected: Robot,
        tool: ArrayLike | str | None,
        frame: ArrayLike | str | None,
    ) -> Pair:
        """Of two robots; they know no targets and no set-ups."""
        for name, what in ((tool, "tool"), (frame, "frame")):
            if isinstance(name, str):
                message = (
                    f"The {what} is to be '{name}' of a calibration, but two robots were given and no result. Give the "
                    f"{what}'s pose, or the result."
                )
                raise ModelError(message)
        true = corrected.rebuilt(base=nominal.base, tip=nominal.tip)
        if true.joint_names != nominal.joint_names:
            message = (
                f"The corrected robot '{true.name}' has the joints {choices(true.joint_names)} from '{true.base}' to "
                f"'{true.tip}', the nominal robot '{nominal.name}' has {choices(nominal.joint_names)}. Give two URDFs "
                "of one robot."
            )
            raise ModelError(message)
        T_tip_tool = np.eye(4) if tool is None else _pose(tool, "tool")
        return cls(
            believed=Arm.of_robot(nominal, T_tip_tool),
            true=Arm.of_robot(true, T_tip_tool),
            T_frame_base=read_only(np.eye(4) if frame is None else _pose(frame, "frame")),
        )._checked()

    @classmethod
    def _of_result(
        cls,
        nominal: Robot,
        stored: Calibration,
        tool: ArrayLike | str | None,
        frame: ArrayLike | str | None,
        payload: Payload | None,
        *,
        larger: bool,
    ) -> Pair:
        """Of a result; the robot is the controller's. The corrected one stands for the one that it began with."""
        began = stored.uncorrected(nominal)
        believed = began if _same_origins(nominal, stored.corrected(nominal)) else nominal
        model = stored.larger if larger else None
        known = stored.setup if model is None else model.setup
        T_true = T_believed = np.eye(4)
        target = None
        if isinstance(tool, str):
            target = _name(known.targets, tool, "target")
            t = known.targets.index(target)
            T_true = T_believed = known.T_tip_target[t]
            if known.target_given[t]:
                # Where it was said to be, and so where the controller has it. One that was found has no such place.
                T_believed = stored.nominal_setup.T_tip_target[t]
        elif tool is not None:
            T_true = T_believed = _pose(tool, "tool")
        T_frame_base = np.eye(4)
        set_up = None
        if isinstance(frame, str):
            set_up = _name(known.groups, frame, "set-up")
            T_frame_base = known.T_frame_base[known.groups.index(set_up)]
        elif frame is not None:
            T_frame_base = _pose(frame, "frame")
        if payload is not None and not _gives_way(model):
            message = (
                "A payload is given, but the model has no compliances: "
                "its commands would be the same with any. Leave the payload out."
            )
            raise ModelError(message)
        true = (
            Arm.of_robot(stored.corrected(nominal), T_true)
            if model is None
            else Arm.of_larger(model, began, T_true, payload)
        )
        return cls(
            Arm.of_robot(believed, T_believed),
            true,
            read_only(T_frame_base),
            target=target,
            set_up=set_up,
            result=stored,
        )._checked()

    def _checked(self) -> Pair:
        """The same, unless the two are no calibration of each other.

        Raises:
            ModelError: They have the tool in places that are far apart.
        """
        q = spread_poses(self.believed.robot, _POSES)
        away = (self.true.poses(q) - self.believed.poses(q))[:, :3, 3]
        typical = float(np.median(np.linalg.norm(away, axis=1)))
        if typical > _NO_CALIBRATION * self.reach:
            message = (
                f"The calibrated robot has the tool {1e3 * typical:.0f} mm away from where the nominal robot "
                f"'{self.believed.robot.name}' ({self.believed.robot.urdf.source}) has it; a calibration "
                "moves it by millimetres. Give the nominal and the calibrated model of one robot, with zero positions "
                "that agree."
            )
            raise ModelError(message)
        return self

    @property
    def reach(self) -> float:
        """How long the true arm is, stretched out, with its tool [m]; at least a millimetre."""
        lengths = np.linalg.norm(self.true.placements[1:, :3, 3], axis=1)
        return float(max(lengths.sum() + np.linalg.norm(self.true.T_tip_tool[:3, 3]), 1e-3))

    def std(self, q: Array) -> Array:
        """How sure it is where the true robot puts the tool, shape (N, 2), [m], [rad]; NaN where nothing is known.

        Args:
            q: shape (N, m), joint values [rad] or [m].
        """
        if self.result is None:
            return np.full((len(q), 2), np.nan)
        return self.result.tool_std(q, self.true.T_tip_tool, target=self.target, group=self.set_up)


def _gives_way(model: Larger | None) -> bool:
    """Whether a larger model has compliances."""
    return model is not None and any(FAMILIES[f].loaded for f in split_name(model.name)[1])


def _same_origins(a: Robot, b: Robot) -> bool:
    """Whether the joints of two chains have the same origins, up to rounding."""
    others = b.origins()
    return all(np.abs(T - others[name]).max() <= _SAME for name, T in a.origins().items())


def _name(names: Sequence[str], name: str, what: str) -> str:
    """The name that is meant: the only one there is for the empty name.

    Raises:
        ModelError: There is none, or a name is wanted.
    """
    if name in names:
        return name
    if not name and len(names) == 1:
        return names[0]
    message = f"The calibration has no {what} '{name}'; it has {choices(names)}."
    if not name:
        message = f"The calibration has {len(names)} {what}s: {choices(names)}. Name one of them."
    raise ModelError(message)


def _pose(given: ArrayLike, what: str) -> Array:
    """A pose, shape (4, 4), from a pose or from a position, shape (3,), [m].

    Raises:
        ModelError: Neither.
    """
    values = np.asarray(given, dtype=np.float64)
    if values.shape == (3,) and np.isfinite(values).all():
        T = np.eye(4)
        T[:3, 3] = values
        return read_only(T)
    if values.shape != (4, 4) or not np.isfinite(values).all():
        message = (
            f"The {what} has the shape {values.shape}; a pose (4, 4) or a position (3,), of finite numbers, "
            "is wanted."
        )
        raise ModelError(message)
    R = values[:3, :3]
    if np.abs(R.T @ R - np.eye(3)).max() > _NO_ROTATION or np.linalg.det(R) < 0.0:
        message = (
            f"The upper left block of the {what}'s pose is no rotation; its columns must be unit vectors at right "
            "angles, right-handed."
        )
        raise ModelError(message)
    return read_only(values)
