"""The rows of a table as the arrays of a fit."""

from __future__ import annotations

import numpy as np

import calib.data.kinds as registry
from calib.data.cell import AUTO, Cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from calib.model.error_model import split_name
from calib.model.families import FAMILIES
from calib.model.kinematics import Samples
from calib.registration.joint_loads import joint_loads
from calib.registration.labels import joined_labels, numbered
from calib.registration.rows import NONE, Rows
from calib.registration.same_poses import same_poses
from calib.registration.setup import Setup
from calib.registration.table_setup import measurement_setup
from calib.robot.robot import Robot
from calib.units import Array, Integers

#: Standard deviation of a length that is assumed where none is given [m]: that of a laser tracker at work.
FIRST_SIGMA = 1e-4

#: Standard deviation of an angle that is assumed where none is given [rad].
FIRST_SIGMA_ANGLE = 1e-3


def rows_and_setup(robot: Robot, measurements: Measurements, cell: Cell) -> tuple[Rows, Setup]:
    """Convert a table to the arrays of a fit.

    Args:
        robot: The nominal robot, whose joints the table's columns are.
        measurements: The table, N rows of all sets.
        cell: Frames, targets and noise as given.

    Returns:
        All N rows, in the table's order, and the measurement setup, not yet registered.

    Raises:
        MeasurementError: A pair has one row only.
        ModelError: The cell names a group or target that the table lacks.
    """
    q = measurements.joints_for(robot.joint_names)
    kinds, partner = _kinds_and_partners(measurements)
    setup = measurement_setup(cell, measurements, kinds)
    samples = Samples(
        q=q,
        frame=numbered(measurements.groups, setup.groups),
        target=numbered(measurements.targets, setup.targets),
        load=joint_loads(robot, measurements, cell, q) if _needs_loads(cell) else None,
    )
    pose = same_poses(q)
    first_rows = np.flatnonzero(partner >= 0)
    pairs = [(int(i), int(partner[i])) for i in first_rows]
    sigma_angle = measurements.sigma_angle
    rows = Rows(
        samples=samples,
        kinds=kinds,
        measured=_measured(measurements, kinds),
        partner=partner,
        sigma=_sigma(len(q), measurements.sigma, cell.sigma, FIRST_SIGMA),
        sigma_angle=_sigma(len(q), sigma_angle, cell.sigma_angle, FIRST_SIGMA_ANGLE),
        poses=_repeats(pose, samples, kinds, partner),
        blocks=joined_labels(pose, pairs),
    )
    return rows, setup


def _kinds_and_partners(measurements: Measurements) -> tuple[Integers, Integers]:
    """Numbers of the rows' kinds and of their partners, both (N,), as `Rows` has them.

    Of a pair the earlier row has the kind, the measurement and a partner; the later one has `NONE` and no partner.
    """
    kinds = numbered(measurements.kinds, registry.names())
    partner = _partners(measurements)
    later = (partner >= 0) & (partner < np.arange(len(measurements)))
    kinds[later] = NONE
    return kinds, np.where(kinds == NONE, -1, partner)


def _needs_loads(cell: Cell) -> bool:
    """True if a model that may be fitted depends on the loads of the joints, which take time to compute."""
    if cell.model == AUTO:
        return True
    _, families = split_name(cell.model)
    return any(FAMILIES[family].loaded for family in families)


def _sigma(count: int, by_row: Array | None, by_cell: float | None, assumed: float) -> Array:
    """Standard deviation of each row, shape (count,): the row's, else the cell's, else the assumed one.

    Args:
        count: Number of rows.
        by_row: shape (count,), as the table gives it, NaN where it does not [m] or [rad]; None without such a column.
        by_cell: As the cell gives it for all rows, in the same unit; None where it does not.
        assumed: In the same unit.
    """
    general = np.full(count, assumed if by_cell is None else by_cell)
    if by_row is None:
        return general
    return np.where(np.isfinite(by_row), by_row, general)


def _repeats(pose: Integers, samples: Samples, kinds: Integers, partner: Integers) -> Integers:
    """Number the rows so that repeats, of one pose, frame, target and kind, have one number, shape (N,).

    Args:
        pose: shape (N,), see `same_poses`.
        samples: Frames and targets.
        kinds: shape (N,), as `Rows` has them.
        partner: shape (N,), likewise; repeats of a pair repeat both its rows.
    """
    poses = int(pose.max(initial=-1)) + 1
    if poses == len(pose):
        return pose  # no pose is repeated
    labels = np.column_stack([pose, samples.frame, samples.target, kinds])
    labels_of_partner = np.where((partner >= 0)[:, None], labels[partner], -1)
    both = np.hstack([labels, labels_of_partner])
    _, number = np.unique(both, axis=0, return_inverse=True)
    return number.reshape(-1)


def _measured(measurements: Measurements, kinds: Integers) -> Array:
    """Measured values of each row, shape (N, K), as `Rows.measured`: point, rotation matrix by rows, readings."""
    numbers = [k for k in np.unique(kinds).tolist() if k != NONE]
    present = {k: registry.at(k) for k in numbers}
    size = max((kind.size for kind in present.values()), default=0)
    result = np.zeros((len(measurements), size))
    for number, kind in present.items():
        rows = kinds == number
        parts = []
        if kind.position:
            parts.append(measurements.points[rows])
        if kind.orientation and measurements.rotations is not None:
            parts.append(measurements.rotations[rows].reshape(-1, 9))
        for reading in kind.readings:
            values = measurements.reading(reading.name)
            parts.append(values[rows, None])
        if parts:
            result[rows, : kind.size] = np.hstack(parts)
    return result


def _partners(measurements: Measurements) -> Integers:
    """The other row of each pair, at both its rows, shape (N,); -1 elsewhere."""
    partner = np.full(len(measurements), -1)
    first, second = measurements.pair_rows.T
    partner[first] = second
    partner[second] = first
    alone = np.flatnonzero(measurements.paired & (partner < 0))
    if len(alone):
        i = int(alone[0])
        raise MeasurementError(
            f"{measurements.source or 'Measurements'}, row {measurements.rows[i]}: the pair "
            f"'{measurements.pairs[i]}' has one row only in this set."
        )
    return partner
