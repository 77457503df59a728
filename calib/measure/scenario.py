"""A scenario: what a virtual cell is to be like. A seed makes a cell, with errors of its own, out of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.kinds as registry
from calib.measure.cell import Cell
from calib.measure.disturbances import Encoder, MovedTarget, Outliers
from calib.measure.noise import TrackerNoise
from calib.measure.random_streams import stream
from calib.measure.ranges import column_limits, joint_ranges, range_text
from calib.measure.simulation import VirtualCell
from calib.measure.truth import TARGET_ERROR, draw_truth
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: Where the tracker stands if nothing says so, in the base [m].
DEFAULT_TRACKER = read_only((3.0, 0.0, 0.0))

#: The set of errors where the cell leaves the choice to the data.
DEFAULT_MODEL = "placement"

#: A joint value may pass a limit by this [rad or m]: tables hold a few digits.
_ROUNDING = 1e-4

_NOTHING = read_only(np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """What a virtual cell is to be like, before anything is drawn.

    Attributes:
        robot: The nominal robot.
        cell: Targets, frames, tracker, payload, gravity, kind, and limits of single errors.
        model: In which errors the robot is wrong, see `draw_truth`.
        sizes: Standard deviations of the errors that are drawn; None: none is.
        errors: Names and values of single errors.
        true_robot: The true geometry, if it is given.
        target_error: How far targets sit from where they are said to, standard deviation [m].
        noise: Of the instrument and the robot; None: none.
        sigma_angle: Noise of an orientation about one axis [rad].
        encoder: Steps of the joint values.
        outliers: Rows that are far off.
        moved: A target that moves.
        drift: shape (3,), of the instrument over the table [m].
        visits: How often the tour of all poses is made.
    """

    robot: Robot
    cell: Cell = field(default_factory=Cell)
    model: str = DEFAULT_MODEL
    sizes: Mapping[str, float] | None = field(default_factory=dict)
    errors: tuple[tuple[str, float], ...] = ()
    true_robot: Robot | None = None
    target_error: float = TARGET_ERROR
    noise: TrackerNoise | None = field(default_factory=TrackerNoise)
    sigma_angle: float = 0.0
    encoder: Encoder = field(default_factory=Encoder)
    outliers: Outliers | None = None
    moved: MovedTarget | None = None
    drift: Array = field(default_factory=lambda: _NOTHING)
    visits: int = 1

    @property
    def kind(self) -> str:
        """What is measured: the cell's kind, or points."""
        return self.cell.kind or "point"

    @property
    def tracker(self) -> Array | None:
        """Where the tracker stands in the base, shape (3,), [m]; None: at the origin of its frame.

        That is the cell's tracker; or where measurements are in the base frame, 3 m away along its x axis.
        """
        cell = self.cell
        if cell.tracker is not None:
            return cell.tracker.position
        elsewhere = cell.frames or cell.T_frame_base is not None or cell.estimate_frame
        return None if elsewhere else DEFAULT_TRACKER

    def draw(self, seed: int) -> VirtualCell:
        """A virtual cell with the errors of this seed.

        Raises:
            CalibError: What the scenario says does not fit the robot.
        """
        truth = draw_truth(
            self.robot,
            self.model,
            self.sizes,
            seed,
            cell=self.cell,
            errors=dict(self.errors),
            true_robot=self.true_robot,
            target_error=self.target_error,
            draw_frame=self.cell.estimate_frame or registry.get(self.kind).own_frame,
        )
        return VirtualCell(
            truth=truth,
            kind=self.kind,
            noise=self.noise,
            tracker=self.tracker,
            sigma_angle=self.sigma_angle,
            encoder=self.encoder,
            outliers=self.outliers,
            moved=self.moved,
            drift=self.drift,
            visits=self.visits,
        )

    def random_poses(self, count: int, seed: int, *, validation: bool = False) -> Array:
        """Joint values anywhere inside the limits, or the cell's ranges, shape (count, m), [rad] or [m].

        More of them are those of fewer and others. Collisions are not looked at.
        """
        return random_poses(self.robot, count, seed, self.cell.ranges, validation=validation)


def cell_noise(cell: Cell) -> TrackerNoise:
    """The noise that a cell states: its sigma, or its tracker's; a Leica AT901's and a robot's where it states none."""
    if cell.sigma is not None:
        return TrackerNoise(cell.sigma, 0.0, 0.0)
    return TrackerNoise() if cell.tracker is None else cell.tracker.noise


def random_poses(
    robot: Robot,
    count: int,
    seed: int,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    *,
    validation: bool = False,
) -> Array:
    """Joint values anywhere inside the limits, shape (count, m), [rad] or [m].

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
