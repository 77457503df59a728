"""View: which robots are shown, at which poses, with what was measured there; values only."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError, choices
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: What two robots are called, and what that means.
Names = tuple[tuple[str, str], tuple[str, str]]
NAMES: Names = (("Nominal", "the URDF as given"), ("Calibrated", "the corrected URDF"))


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points of the workspace and how well the calibrated robot knows them.

    Attributes:
        points: shape (K, 3), in the base [m].
        std: shape (K,), standard deviation of the predicted position there [m].
        measured: shape (K,), whether all joint values lie within the range of the rows that were fitted.
    """

    points: Array
    std: Array
    measured: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What is shown. N poses, one of them at a time; the marks of all of them at once.

    Attributes:
        nominal: The robot before calibration.
        calibrated: The robot after it, the same chain; None to show one robot alone.
        q: shape (N, m), [rad] or [m], the poses, in the order of ``nominal.joint_names``.
        labels: What each pose is called, such as ``"row 31"``, N of them; none for numbers from 1.
        kinds: ``"estimation"``, ``"validation"``, ``"flagged"`` or, where nothing was measured, ``"pose"``, N of them;
            none for ``"pose"``.
        nominal_target: shape (N, 4, 4) or (4, 4), T_tip_target of the nominal robot [m].
        calibrated_target: shape (N, 4, 4) or (4, 4), T_tip_target of the calibrated robot [m].
        measured: shape (N, 3), the measured targets in the base [m]; NaN where nothing was measured; may be empty.
        errors: shape (2, N), the size of what the nominal and the calibrated robot leave over of each row [m]; NaN
            where nothing was measured; empty to take the distances in the picture.
        angles: shape (2, N), likewise of orientations [rad]; may be empty.
        T_base_nominal: shape (N, 4, 4) or (4, 4), where the nominal robot stands in the calibrated one's base: the two
            find the measurement frame a little differently [m].
        instruments: shape (N, 4, 4), pose in the base of what each row was seen with, such as a tracker [m]; NaN where
            that is not known; may be empty.
        cloud: How well positions are known over the workspace; None for none.
        start: Which pose is shown first.
        rows: How many rows there are, where those shown are a choice; 0 where all are shown.
        title: The page's heading.
        verdict: What a calibration's verdict is; none for none.
        note: A sentence or two below the heading, such as what the verdict stands on.
        names: What the two robots are called, and what that means.

    Raises:
        ModelError: The robots have different joints, or an array has another shape or is not finite.
    """

    nominal: Robot
    calibrated: Robot | None
    q: Array
    labels: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    nominal_target: Array = field(default_factory=lambda: np.eye(4))
    calibrated_target: Array = field(default_factory=lambda: np.eye(4))
    measured: Array = field(default_factory=lambda: np.zeros((0, 3)))
    errors: Array = field(default_factory=lambda: np.zeros((2, 0)))
    angles: Array = field(default_factory=lambda: np.zeros((2, 0)))
    T_base_nominal: Array = field(default_factory=lambda: np.eye(4))
    instruments: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    cloud: Cloud | None = None
    start: int = 0
    rows: int = 0
    title: str = ""
    verdict: str = ""
    note: str = ""
    names: Names = NAMES

    def __post_init__(self) -> None:
        """Copy the arrays, fill in what was left out, and check that all of it fits together."""
        robot, other = self.nominal, self.calibrated
        if other is not None and robot.joint_names != other.joint_names:
            raise ModelError(
                f"The nominal robot has the joints {choices(robot.joint_names)}, the calibrated one "
                f"{choices(other.joint_names)}. Show two robots with the same chain."
            )
        count = len(self.q)
        poses, gaps = (count, 4, 4), np.nan
        for name, shape, otherwise in (
            ("q", (count, len(robot.joint_names)), None),
            ("nominal_target", poses, None),
            ("calibrated_target", poses, None),
            ("T_base_nominal", poses, None),
            ("measured", (count, 3), gaps),
            ("instruments", poses, gaps),
            ("errors", (2, count), gaps),
            ("angles", (2, count), gaps),
        ):
            given = np.asarray(getattr(self, name), dtype=np.float64)
            values = given if given.size else np.full(shape, otherwise)
            values = np.broadcast_to(values, shape) if values.shape == (4, 4) else values
            if values.shape != shape or not count or (otherwise is None and np.isnan(values).any()):
                wanted = f"finite numbers of shape {shape} are wanted, for one pose at least"
                raise ModelError(f"{name} has shape {given.shape}; {wanted}.")
            object.__setattr__(self, name, read_only(values))
        for words, default in (
            ("labels", tuple(f"pose {k + 1}" for k in range(count))),
            ("kinds", ("pose",) * count),
        ):
            object.__setattr__(self, words, tuple(getattr(self, words)) or default)

    @property
    def robots(self) -> dict[str, Robot]:
        """``"nominal"`` and, if there is one, ``"calibrated"``."""
        both = {"nominal": self.nominal}
        return both if self.calibrated is None else {**both, "calibrated": self.calibrated}

    @property
    def measures(self) -> bool:
        """Whether any row tells where the target was."""
        return bool(np.any(np.isfinite(self.measured)))

    @property
    def distances(self) -> Array:
        """The errors as they are in the picture, from measured to predicted target, shape (2, N), [m]; or NaN."""
        return np.array([np.linalg.norm(self.measured - at, axis=1) for at in self.predicted])

    @property
    def predicted(self) -> Array:
        """Where each robot puts the target, in the base, shape (2, N, 3), [m]; of one robot twice."""
        robots = [self.nominal, self.calibrated or self.nominal]
        targets = [self.nominal_target, self.calibrated_target]
        own = [robot.poses(self.q) @ T for robot, T in zip(robots, targets, strict=True)]
        return np.array([(self.T_base_nominal @ own[0])[:, :3, 3], own[1][:, :3, 3]])

    def select(self, chosen: ArrayLike, start: int = 0) -> View:
        """Some of the poses.

        Args:
            chosen: Their numbers.
            start: Which of those chosen is shown first.
        """
        at = np.asarray(chosen, dtype=int)
        return replace(
            self,
            q=self.q[at],
            labels=tuple(self.labels[i] for i in at),
            kinds=tuple(self.kinds[i] for i in at),
            nominal_target=self.nominal_target[at],
            calibrated_target=self.calibrated_target[at],
            measured=self.measured[at],
            errors=self.errors[:, at],
            angles=self.angles[:, at],
            T_base_nominal=self.T_base_nominal[at],
            instruments=self.instruments[at],
            start=start,
            rows=self.rows or len(self.q),
        )


def translated(point: ArrayLike) -> Array:
    """A pose without rotation, shape (4, 4): that of a target of which only the place is known.

    Args:
        point: shape (3,), [m].
    """
    T = np.eye(4)
    T[:3, 3] = point
    return T
