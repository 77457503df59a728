"""Trackers, and other gauges of the target itself: of its position, its orientation, or a length.

A laser tracker sees a reflector within its range, and within the cone around the direction that its opening faces. The
standard deviation of a coordinate grows with the distance d, sigma^2 = (constant + per_length d)^2 + repeatability^2;
see `calib.data.surroundings.TrackerNoise`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS, VECTOR
from calib.data.cell import Cell
from calib.data.inputs import table_of_poses
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.data.surroundings import Reflector, TrackerNoise
from calib.errors import ModelError, choices
from calib.instruments.instrument import Assumption, Condition, Instrument, Sightline
from calib.model.error_model import ErrorModel
from calib.robot.robot import Robot

#: Noise of lengths if none is stated.
USUAL_NOISE = TrackerNoise()

#: The target itself is measured.
_ORIGIN = read_only([[0.0, 0.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TrackerInstrument(Instrument):
    """A laser tracker, or another gauge of what a kind measures of a target."""

    kind: Kind
    sigma: Mapping[str, float]
    T_instrument_base: Array | None
    #: Noise of a coordinate or length.
    noise_of_length: TrackerNoise
    #: Least and largest distance that it measures [m].
    distances: tuple[float, float] = (0.0, np.inf)
    #: The reflector on the tip; None: it is seen from all sides.
    reflector: Reflector | None = None
    points: Array = field(default_factory=lambda: _ORIGIN)
    ahead: float = 0.0
    assumed: tuple[tuple[Assumption, tuple[float, ...]], ...] = ()

    @classmethod
    def of(cls, cell: Cell) -> TrackerInstrument:
        """Return the instrument of a cell.

        Args:
            cell: Kind of measurement (None: ``"point"``), tracker, reflector, noise.

        Raises:
            ModelError: Poses cannot be chosen freely for rows of this kind, or its frame is not given.
        """
        name = cell.kind or "point"
        kind = registry.get(name)
        if kind.is_image:
            raise ModelError(
                f"Rows of the kind '{name}' are planned as images: give the camera and the board (--camera, --board "
                "and --board-at)."
            )
        unplaced = kind.own_frame and cell.T_frame_base is None and not cell.frames
        if unplaced or len(cell.frames) > 1 or not kind.free:
            kinds = [registry.get(known) for known in registry.names()]
            free = [known.name for known in kinds if known.free and not known.is_image]
            raise ModelError(
                f"Poses are planned for the kinds {choices(free)}, at one station; of one with a "
                "frame of its own, such as distances, give the base in it (frame_xyz_mm in the cell "
                f"file). Here the kind is '{name}'."
            )
        sigma = {
            unit: cell.sigma.get(unit, of.assumed_sigma) for unit, of in RESIDUAL_UNITS.items()
        }
        assumed = "rad" in kind.units and "rad" not in cell.sigma
        tracker = cell.tracker
        instrument = cls(
            kind=kind,
            sigma=sigma,
            T_instrument_base=None,
            noise_of_length=noise_of_lengths(cell),
            reflector=cell.reflector,
            assumed=(("orientation_noise", (sigma["rad"],)),) if assumed else (),
        )
        if tracker is None:
            return instrument
        # Its orientation does not matter for what it sees.
        T_tracker_base = np.eye(4)
        T_tracker_base[:3, 3] = -tracker.position
        distances = (tracker.nearest, tracker.farthest)
        return replace(instrument, T_instrument_base=read_only(T_tracker_base), distances=distances)

    @property
    def locates(self) -> bool:
        """True if positions are measured."""
        return self.kind.position

    def sees(self, sightlines: Sequence[Sightline]) -> Iterator[Condition]:
        """Yield the conditions that the targets are in range, and the instrument in the cones of their reflectors."""
        for sightline in sightlines:
            yield Condition("tracker_range", partial(self.in_range, sightline))
        if self.reflector is not None:
            for sightline in sightlines:
                yield Condition("reflector_cone", partial(self.in_cone, sightline, self.reflector))

    def in_range(self, sightline: Sightline, q: Array) -> Mask:
        """Test at joint values (n, m) whether the instrument measures a target at its distance, shape (n,)."""
        distance = sightline.distances(q)
        nearest, farthest = self.distances
        return np.asarray((distance >= nearest) & (distance <= farthest))

    def in_cone(self, sightline: Sightline, reflector: Reflector, q: Array) -> Mask:
        """Test at joint values (n, m) whether the instrument is in the cone from which a reflector is seen, shape (n,).

        The angle from the reflector's normal to the direction from the target to the instrument is at most its
        acceptance.
        """
        T = sightline.target_poses(q)
        towards = -T[:, :3, 3]
        normal = T[:, :3, :3] @ (sightline.T_tip_target[:3, :3].T @ reflector.normal)
        across = np.linalg.norm(np.cross(normal, towards), axis=1)
        along = np.einsum("ni,ni->n", normal, towards)
        return np.asarray(np.arctan2(across, along) <= reflector.acceptance)

    def noise(self, distance: Array) -> Array:
        """Return the standard deviation of a coordinate or length, shape (n,), [m], at distances (n,) [m]."""
        return np.asarray(self.noise_of_length.std(distance))

    def stop_rows(self, robot: Robot, targets: Sequence[str], group: str) -> Measurements:
        """Return a row for each target, with all joints at 0 and placeholders for what is measured."""
        joints = np.zeros((len(targets), len(robot.inputs)))
        table = table_of_poses(robot, self.kind.name, joints)
        return replace(table, targets=tuple(targets), groups=(group,) * len(targets))

    def predict(self, T_frame_target: Array) -> Array:
        """Predict the k readings of the kind, shape (n, k), at n poses T_frame_target, (n, 4, 4) [m]."""
        return self.kind.readings_at(T_frame_target)

    def whitened(
        self, T_frame_target: Array, twists: Array, noise: Array, model: ErrorModel
    ) -> Array:
        """Differentiate the D scalars of each of k targets at n stops by p parameters, shape (n, k D, p), by target.

        The targets are at T_frame_target, (n, k, 4, 4) [m], and move by the twists, (n, k, 6, p), of the parameters of
        the model; the noise is of a coordinate at each stop, (n,) [m].

        With the noise s of a coordinate, the repeatability r of the robot is a part of s that all k targets of one stop
        share. The mean of their coordinates then has the variance s^2 / k (1 + (k - 1) rho), rho = r^2 / s^2: the mean
        over targets of the derivative is scaled accordingly. Differences between targets are more exact than s; a fit,
        to which rows are independent, makes no use of that, and nor does this.
        """
        n, targets = T_frame_target.shape[:2]
        T = T_frame_target.reshape(-1, 4, 4)
        moved = twists.reshape(len(T), *twists.shape[2:])
        slopes = self.kind.derivative(self.predict(T), T, moved)
        sigma = np.empty((len(T), len(self.kind.units)))
        for column, unit in enumerate(self.kind.units):
            sigma[:, column] = np.repeat(noise, targets) if unit == "m" else self.sigma[unit]
        by_target = (slopes / sigma[:, :, None]).reshape(n, targets, -1, len(model))
        if targets > 1 and self.kind.position:
            rho = (self.noise_of_length.repeatability / noise) ** 2
            loss = 1.0 - 1.0 / np.sqrt(1.0 + (targets - 1) * rho)
            shared = by_target[:, :, :VECTOR].mean(axis=1, keepdims=True)
            by_target[:, :, :VECTOR] -= loss[:, None, None, None] * shared
        return np.asarray(by_target.reshape(n, -1, len(model)))


def noise_of_lengths(cell: Cell) -> TrackerNoise:
    """Return the noise of lengths: a cell's ``sigma["m"]`` everywhere, else that of its tracker, else a usual one."""
    if "m" in cell.sigma:
        return TrackerNoise(cell.sigma["m"], 0.0, 0.0)
    return USUAL_NOISE if cell.tracker is None else cell.tracker.noise
