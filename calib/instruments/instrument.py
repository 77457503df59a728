"""The interface of instruments: what sees a target, how exactly, and what it reads.

An instrument is fixed to one link and its target to another; a link that no joint moves is the world. All that an
instrument needs of the robot is the pose of the target in its own frame, by the chain between the two links
(`calib.robot.chain.chain_between`), from that of the instrument, the base, to that of the target, the tip:

    T_instrument_target(q) = T_instrument_base  T_base_tip(q)  T_tip_target

So a tracker in the world with a reflector on the flange, a camera on the flange with a board on the table, and a camera
on the table with a board on the flange differ only in their chains. A second instrument, or a second target on another
link, is one more `Sightline`: another chain of the same URDF, ``robot.rebuilt(base=..., tip=...)``, which takes the
values of its own ``joint_names``. An instrument does not know of other instruments, or of the chain along which it
looks.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from calib.basics.arrays import Array, Mask, rigid_inverse
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.model.error_model import ErrorModel
from calib.robot.robot import Robot

#: What an instrument may assume if a cell does not state it.
Assumption = Literal[
    "orientation_noise",  # the noise of an orientation [rad]
    "camera_assumed",  # the focal length of an unknown lens [px]
    "image_noise",  # the noise of an image coordinate [px]
]


class Condition(NamedTuple):
    """Condition that a pose of the robot must pass, and the reason of refusal."""

    #: Word for the reason why a pose that does not pass is refused.
    reason: str
    #: Function of joint values (n, m), [rad] or [m], that returns whether each pose passes, shape (n,).
    passes: Callable[[Array], Mask]


@dataclass(frozen=True, slots=True, eq=False)
class Sightline(Value):
    """An instrument on one link and its target on another, with the chain between the two."""

    #: The chain, from the link of the instrument to the link of the target.
    robot: Robot
    #: Shape (4, 4), pose of the instrument's link in the instrument [m].
    T_instrument_base: Array
    #: Shape (4, 4), pose of the target in its link [m].
    T_tip_target: Array

    @property
    def eye(self) -> Array:
        """Position of the instrument in its link, shape (3,), [m]."""
        return np.asarray(rigid_inverse(self.T_instrument_base)[:3, 3])

    def target_poses(self, q: Array) -> Array:
        """Predict the pose of the target in the instrument, T_instrument_target, by the nominal robot.

        Args:
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Shape (N, 4, 4), [m].
        """
        return np.asarray(self.T_instrument_base @ self.robot.poses(q) @ self.T_tip_target)

    def distances(self, q: Array) -> Array:
        """Predict how far the target is from the instrument at joint values (N, m), shape (N,), [m]."""
        T_base_target = self.robot.poses(q) @ self.T_tip_target
        return np.asarray(np.linalg.norm(T_base_target[:, :3, 3] - self.eye, axis=1))

    def tip_poses(self, T_instrument_target: Array) -> Array:
        """Return the poses of the chain's tip in its base, with the target at given poses in the instrument.

        Args:
            T_instrument_target: Shape (N, 4, 4), [m].

        Returns:
            T_base_tip, shape (N, 4, 4), [m].
        """
        T_base_instrument = rigid_inverse(self.T_instrument_base)
        return np.asarray(
            T_base_instrument @ T_instrument_target @ rigid_inverse(self.T_tip_target)
        )


class Instrument(Value, ABC):
    """What sees a target and measures it."""

    __slots__ = ()

    #: Number of random numbers that make a viewpoint, see `viewpoints`; 0: it sees the target at most poses.
    VIEWPOINT_NUMBERS: ClassVar[int] = 0

    #: What one row of a table measures: prediction and derivative are those of the registry.
    kind: Kind
    #: Standard deviation of one scalar by its unit, as stated or assumed; that of lengths is `noise`.
    sigma: Mapping[str, float]
    #: Shape (4, 4), pose of the chain's base in the instrument [m]; None: its place is not known.
    T_instrument_base: Array | None
    #: Shape (n, 3), points in the target's frame that must not be hidden from the instrument [m]. The first is the one
    #: whose predicted position counts.
    points: Array
    #: Distance from the instrument at which lines of sight begin, beyond its own housing [m].
    ahead: float
    #: What was assumed, each with its values in SI units.
    assumed: tuple[tuple[Assumption, tuple[float, ...]], ...]

    @property
    @abstractmethod
    def locates(self) -> bool:
        """True if positions are measured; else only the shape of all positions together can be known."""

    def in_cell(self, cell: Cell) -> Cell:
        """Return a cell as a fit of the instrument's rows will use it, with what was assumed."""
        return cell

    def stops(self, q: Array) -> Array:
        """Return the joint values of the robot's stops (n, m), by those of the rows of a table (N, m), [rad] or [m]."""
        return q

    def with_internals(self, internals: Array) -> Instrument:
        """Return the instrument with the internals of its rows at a stop, one of several instruments of a cell.

        Args:
            internals: Shape (c, k), see `calib.instruments.internals`.
        """
        del internals
        return self

    @abstractmethod
    def sees(self, sightlines: Sequence[Sightline]) -> Iterator[Condition]:
        """Yield the conditions under which all targets are measured, the cheap ones first.

        Args:
            sightlines: One for each target.
        """

    def viewpoints(self, unit: Array) -> Array:
        """Return poses of the target that are measured well, spread evenly; for instruments that seldom see it.

        Args:
            unit: Random numbers between 0 and 1, shape (n, `VIEWPOINT_NUMBERS`).

        Returns:
            T_instrument_target, shape (n, 4, 4), or fewer, [m]; none if the instrument sees its target at most poses
            anyway: `VIEWPOINT_NUMBERS` is 0.
        """
        del unit
        return np.zeros((0, 4, 4))

    @abstractmethod
    def noise(self, distance: Array) -> Array:
        """Return the standard deviation of one scalar, with the robot's repeatability.

        Args:
            distance: Of the target from the instrument, shape (n,), [m].

        Returns:
            Shape (n,), [m], or [px] of images.
        """

    @abstractmethod
    def stop_rows(self, robot: Robot, targets: Sequence[str], group: str) -> Measurements:
        """Return the rows of one stop of the robot, all joints at 0, with arbitrary measured values.

        Args:
            robot: The chain, whose joints have a column each.
            targets: Names of the targets.
            group: Name of the station.
        """

    @abstractmethod
    def predict(self, T_frame_target: Array) -> Array:
        """Predict what the instrument reads of a target.

        Args:
            T_frame_target: Poses of the target in the measurement frame, shape (n, 4, 4), [m].

        Returns:
            Shape (n, ...), in SI units or [px].
        """

    @abstractmethod
    def whitened(
        self, T_frame_target: Array, twists: Array, noise: Array, model: ErrorModel
    ) -> Array:
        """Differentiate what is measured of all targets at a stop by the parameters, whitened by the noise.

        Args:
            T_frame_target: Poses of the k targets in the measurement frame, shape (n, k, 4, 4), [m].
            twists: Motion of each target along the frame's axes by each of p parameters, shape (n, k, 6, p), see
                `calib.model.kinematics.Kinematics.twists`.
            noise: Standard deviation of a scalar at each stop, see `noise`, shape (n,).
            model: The p parameters, some of which may be the instrument's own numbers.

        Returns:
            Shape (n, d, p), in standard deviations of the noise per unit of the parameter.
        """


def transform(T: Array, points: Array) -> Array:
    """Return points (c, 3) [m] at poses (N, 4, 4) [m] of their frame, shape (N, c, 3) [m]."""
    return np.asarray(points @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3])
