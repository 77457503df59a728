"""The poses of a virtual cell: random ones, those that the robot cannot take, and which row is measured at which."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import CalibError
from calib.measure.columns import SETS
from calib.measure.ranges import column_limits, joint_ranges, range_text
from calib.model.robot import Robot
from calib.simulate.disturbances import stream

Array = NDArray[np.float64]

#: A joint value may pass a limit by this [rad or m]: tables hold a few digits.
_ROUNDING = 1e-4


def random_poses(
    robot: Robot,
    count: int,
    seed: int,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    *,
    validation: bool = False,
) -> Array:
    """Joint values anywhere inside the limits, shape (count, m), [rad] or [m].

    More of them are those of fewer and others. Collisions are not looked at.

    Args:
        robot: The robot; without limits a joint is moved within one turn, or one metre.
        count: Number of poses.
        seed: Of the random numbers.
        ranges: Narrower ranges of joints by name [rad] or [m].
        validation: Whether these are the poses to validate with: other ones for the same seed.

    Raises:
        CalibError: No such joint, or a range outside its limits.
    """
    low, high = joint_ranges(robot, ranges).T
    rng = stream(seed, "validation poses" if validation else "poses")
    return np.asarray(low + (high - low) * rng.uniform(size=(count, len(low))))


def outside_limits(robot: Robot, q: ArrayLike) -> tuple[str, ...]:
    """What a person must be told of poses that the robot cannot take: a sentence for each joint beyond its limits."""
    limits = column_limits(robot)
    values = np.atleast_2d(np.asarray(q, dtype=np.float64))
    beyond = (values < limits[:, 0] - _ROUNDING) | (values > limits[:, 1] + _ROUNDING)
    said = []
    for k, name in enumerate(robot.joint_names):
        poses = np.flatnonzero(beyond[:, k])
        if not poses.size:
            continue
        slides = robot.joint_types[name] == "prismatic"
        scale, unit = (1e3, "mm") if slides else (180.0 / np.pi, "deg")
        count = f"{poses.size} poses are" if poses.size > 1 else "1 pose is"
        said.append(
            f"{count} outside the limits of '{name}', {range_text(robot, name, limits[k])}: first pose "
            f"{poses[0] + 1}, {scale * values[poses[0], k]:.6g} {unit}."
        )
    return tuple(said)


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """Which pose, stop, target and set-up each of R rows is of: all targets at each stop, one tour after the other.

    Attributes:
        route: shape (S,), the pose of each stop.
        stop, pose, target, group: shape (R,).
        poses: Number of poses.
        targets: Number of targets.
    """

    route: NDArray[np.int_]
    stop: NDArray[np.int_]
    pose: NDArray[np.int_]
    target: NDArray[np.int_]
    group: NDArray[np.int_]
    poses: int
    targets: int

    @classmethod
    def of(cls, poses: int, visits: int, targets: int, groups: int) -> Tour:
        """Poses are dealt out among the set-ups in turn; with several visits the whole tour is made again."""
        route = np.tile(np.arange(poses), visits)
        stop = np.repeat(np.arange(len(route)), targets)
        pose = route[stop]
        target = np.tile(np.arange(targets), len(route))
        return cls(route, stop, pose, target, pose % groups, poses, targets)

    def partners(self, sets: Sequence[str]) -> NDArray[np.int_]:
        """The other row of each row's pair, shape (R,): consecutive poses of one set, the same target, the same tour.

        Raises:
            CalibError: A set has an odd number of poses.
        """
        other = np.arange(self.poses)
        for name in SETS:
            chosen = [i for i, word in enumerate(sets) if word == name]
            if len(chosen) % 2:
                raise CalibError(
                    f"Distances between the targets of two poses need an even number of poses; {len(chosen)} are to "
                    f"'{name}'."
                )
            other[chosen[::2]], other[chosen[1::2]] = chosen[1::2], chosen[::2]
        rows = np.arange(len(self.pose))
        return np.asarray(rows + (other[self.pose] - self.pose) * self.targets)
