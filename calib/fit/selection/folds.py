"""Folds: the rows that a cross-validation holds out together, and their residuals by fits without them.

Rows of one pose are never in different folds: they share the error of the pose, so one would predict what the other
measures. If there are enough stations, each fold is a whole station instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.errors import MeasurementError
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.task import Task
from calib.fit.registration.labels import joined_stations
from calib.fit.registration.registration import register_all_rows
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.model.kinematics import Samples
from calib.numerics.errors import CrossValidation, Errors
from calib.numerics.neighbours import along_path

#: Largest number of folds: up to as many poses or stations are held out one at a time.
_MOST_FOLDS = 60

#: Number of folds if there are more poses than that.
_FEW_FOLDS = 10

#: Pieces of a path in each of these, of 100 rows or more: far longer than errors of neighbours are alike.
_PIECES = 10

#: From this number on whole stations are held out; of two, one half of all rows would be.
_FEWEST_STATIONS = 3


#: If more than this share of the poses is seen from several stations, stations are no poses of their own.
_MOSTLY = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Folds:
    """Rows that are held out together; each row is in one fold."""

    #: Name, such as ``"leave-one-out"``, ``"leave-one-station-out"``, ``"10-fold"`` or ``"10-fold-in-time"``
    method: str
    #: For each fold, True for the rows that it holds out, each of shape (N,)
    masks: tuple[Mask, ...]

    @classmethod
    def of(
        cls,
        blocks: Integers,
        stations: Integers | None = None,
        measured_rows: int | None = None,
        *,
        in_time: bool = False,
    ) -> Folds:
        """Divide rows into folds: whole stations if at least three are given, else single poses, or tenths of many.

        Args:
            blocks: Number of the block of each row, shape (N,). Rows of one block (one pose, or the two of a pair) stay
                together.
            stations: Number of the station of each row, shape (N,); None: stations are not held out whole.
            measured_rows: Number of rows that hold a measurement themselves, by default all: of a pair one does. It
                decides on the method's name alone.
            in_time: Whether blocks follow each other along a path: then a tenth consists of pieces of the path, as
                neighbours tell much the same.

        Returns:
            The folds; a single one if all rows are of one block. Of very many stations several are held out together.
        """
        if stations is not None and len(np.unique(stations)) >= _FEWEST_STATIONS:
            numbers = np.unique(stations)
            size = -(-len(numbers) // _MOST_FOLDS)  # rounded up
            masks = []
            for first in range(0, len(numbers), size):
                held_out = numbers[first : first + size]
                masks.append(np.isin(stations, held_out))
            method = "leave-one-station-out" if size == 1 else "leave-stations-out"
            return cls(method, tuple(masks))

        present, block = np.unique(blocks, return_inverse=True)
        count = len(present)
        if count > _MOST_FOLDS:
            name = f"{_FEW_FOLDS}-fold"
            if in_time:
                # Blocks are numbered in the order in which they occur.
                block = block * (_FEW_FOLDS * _PIECES) // count
                name = f"{_FEW_FOLDS}-fold-in-time"
            tenths = tuple(block % _FEW_FOLDS == k for k in range(_FEW_FOLDS))
            return cls(name, tenths)
        without_repeats = count in (len(blocks), measured_rows)
        method = "leave-one-out" if without_repeats else "leave-one-pose-out"
        return cls(method, tuple(block == k for k in range(count)))

    @classmethod
    def of_task(cls, task: Task, rows: Rows, *, by_poses: bool = False) -> Folds:
        """Divide the rows of a fit into folds.

        Stations are held out whole if there are three or more, each with poses of its own, and the others determine
        all that is needed to predict one. Several cameras that look at one pose are held out together, by the pose.

        Args:
            task: The fit; what is estimated of frames, and the known distances between them, decide.
            rows: The N rows that are fitted.
            by_poses: Whether poses are held out, also where stations could be.

        Returns:
            Two folds or more.

        Raises:
            MeasurementError: All rows are of one pose, so nothing is left to fit.
        """
        stations = joined_stations(rows, task.distances)
        # Joints at their stops are stations by name alone, which tell nothing of each other.
        of_joint = any(kind.of_joint for kind in rows.present)
        whole = (
            not by_poses
            and not of_joint
            and not _see_the_same_poses(rows.blocks, stations)
            and _stations_predict_each_other(task, rows, stations)
        )
        is_measured = np.any(rows.used, axis=1)
        measured_rows = int(np.sum(is_measured))
        in_time = along_path(rows.joints)
        folds = cls.of(rows.blocks, stations if whole else None, measured_rows, in_time=in_time)
        if len(folds.masks) < 2:
            raise MeasurementError(
                "These are rows of one pose, which tell nothing of the robot: its errors there cannot be told from the "
                "target's place, and none is left to validate with. Measure more poses; calib plan chooses them."
            )
        return folds

    def join(self, rows: Rows, residuals: Sequence[Array], outliers: Mask) -> CrossValidation:
        """Join the held-out residuals of all folds.

        Args:
            rows: The N rows that were divided.
            residuals: Of each fold, measured minus predicted at the rows that it holds out, shape (n, d), in
                the order of the rows; d may be less than D if all of them lack a kind.
            outliers: Rows that the fit to all rows flagged, shape (N,).

        Returns:
            Residuals of shape (N, D), and their errors with and without the outliers.
        """
        residual = np.zeros(rows.used.shape)
        for mask, of_fold in zip(self.masks, residuals, strict=True):
            residual[mask, : of_fold.shape[1]] = of_fold
        good = ~outliers
        _, block = np.unique(rows.blocks, return_inverse=True)
        return CrossValidation(
            method=self.method,
            folds=len(self.masks),
            poses=block.reshape(-1),
            residual=read_only(residual),
            errors=Errors.of(residual, rows.channels),
            errors_without_outliers=Errors.of(residual[good], rows.channels.select(good)),
        )


def _see_the_same_poses(blocks: Integers, stations: Integers) -> bool:
    """Return whether most blocks, (N,), have rows of several stations, (N,): cameras that look at the same poses."""
    pairs = np.unique(np.column_stack([blocks, stations]), axis=0)
    _, stations_of_block = np.unique(pairs[:, 0], return_counts=True)
    return bool(np.mean(stations_of_block > 1) > _MOSTLY)


def _stations_predict_each_other(task: Task, rows: Rows, stations: Integers) -> bool:
    """Return whether the rows of any station, by their numbers, (N,), can be predicted from those of the others.

    The frame of a held-out station is registered to its own rows. It takes from the others the orientation of each
    target, and the place of the base if its own frame is known.
    """
    # Each target whose orientation was measured must be so at two stations or more.
    oriented = rows.where(lambda kind: kind.orientation)
    targets = rows.samples.target
    for target in np.unique(targets[oriented]):
        of_target = oriented & (targets == target)
        if len(np.unique(stations[of_target])) < 2:
            return False
    # No station, or more than one, must be measured in a known frame: one alone determines where the base stands.
    positions = rows.where(lambda kind: kind.position)
    in_known_frame = positions & ~task.setup.wholly_unknown[rows.samples.frame]
    return len(np.unique(stations[in_known_frame])) != 1


def held_out_residual(fitted: Fitted, rows: Rows, held_out: Mask, outliers: Mask) -> Array:
    """Return the residual of held-out rows, by a fit to the others.

    Args:
        fitted: Fit to all rows except those that are held out.
        rows: The N rows of all folds.
        held_out: True for the n rows that the fit has not used, shape (N,).
        outliers: True for the rows that have no part in a registration, shape (N,).

    Returns:
        Measured minus predicted at the held-out rows, shape (n, D), in the units of the rows' channels; frames and
        targets that only they see are registered to them first.
    """
    samples = rows.samples.select(held_out)
    T_base_tip = fitted.tip_poses(samples)
    setup = fitted.estimated_setup()
    return residual_after_registration(T_base_tip, setup, rows, held_out, ~held_out, outliers)


def residual_after_registration(
    T_base_tip: Array,
    setup: Setup,
    rows: Rows,
    held_out: Mask,
    used: Mask,
    outliers: Mask,
) -> Array:
    """Return the residual of held-out rows; frames and targets that only they see are registered to them first.

    Args:
        T_base_tip: Predicted poses of the tip in the base at the n held-out rows, shape (n, 4, 4), [m].
        setup: Frames and targets as estimated from the rows that were used.
        rows: The N rows of all folds.
        held_out: True for the n rows to predict, shape (N,).
        used: True for the rows from which frames and targets were estimated, shape (N,).
        outliers: True for the rows that have no part in the registration, shape (N,), unless they are more than half of
            a frame's.

    Returns:
        Measured minus predicted at the held-out rows, shape (n, D), in the units of the rows' channels.
    """
    held_out_rows = rows.select(held_out)
    known_frames, known_targets = setup.seen_by(rows.samples.select(used))
    unseen = setup.with_fixed(known_frames, known_targets)
    if unseen.count:
        good = held_out_rows.without(outliers[held_out])
        setup = register_all_rows(T_base_tip[good], unseen, held_out_rows.select(good))
    return held_out_rows.residual(setup.sightings(T_base_tip, held_out_rows.samples))


def seen_only_by(fitted: Fitted, chosen: Mask) -> Mask:
    """Find the parameters of frames and targets that only some rows see.

    Args:
        fitted: A fit with p parameters to N rows.
        chosen: True for the rows in question, shape (N,).

    Returns:
        True for the parameters of frames and targets that none of the other rows sees, shape (p,).
    """
    samples = fitted.estimate.problem.rows.samples
    parameters = fitted.kinematics.model.parameters
    places_alone = Samples(samples.q[:, :0], samples.frame, samples.target)
    frames_seen, targets_seen = fitted.setup.seen_by(places_alone.select(~chosen))
    if np.all(frames_seen) and np.all(targets_seen):
        return np.zeros(len(parameters), dtype=bool)
    frames, targets = fitted.setup.places
    unseen_frames = compress(frames, ~frames_seen)
    unseen_targets = compress(targets, ~targets_seen)
    unseen = {*unseen_frames, *unseen_targets}
    return np.array([parameter.place in unseen for parameter in parameters], dtype=bool)
