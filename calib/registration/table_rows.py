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
from calib.registration.table_setup import setup_of
from calib.robot.robot import Robot
from calib.units import Array, Integers

#: The noise assumed until the data have told theirs [m], [rad].
FIRST_SIGMA, FIRST_SIGMA_ANGLE = 1e-4, 1e-3


def rows_of(robot: Robot, measurements: Measurements, cell: Cell) -> tuple[Rows, Setup]:
    """All rows of a table, for a robot and a set-up; `MeasurementError` where a pair has lost its other row."""
    m, count = measurements, len(measurements)
    q = m.joints_for(robot.joint_names)
    kinds, partner = numbered(m.kinds, registry.names()), _partners(m)
    # Of a pair the earlier row carries what was measured, and the later one nothing more.
    kinds[(partner >= 0) & (partner < np.arange(count))] = NONE
    partner = np.where(kinds == NONE, -1, partner)
    setup = setup_of(cell, m, kinds)
    blocks = same_poses(q)
    # The load on the joints takes its time to work out: a model may be fitted that asks for it, or not.
    counts = cell.model == AUTO or any(FAMILIES[f].loaded for f in split_name(cell.model)[1])
    samples = Samples(
        q=q,
        frame=numbered(m.groups, setup.groups),
        target=numbered(m.targets, setup.targets),
        load=joint_loads(robot, m, cell, q) if counts else None,
    )

    def sigma(by_row: Array | None, by_cell: float | None, first: float) -> Array:
        general = np.full(count, first if by_cell is None else by_cell)
        return general if by_row is None else np.where(np.isfinite(by_row), by_row, general)

    poses = blocks
    if int(blocks.max(initial=-1)) + 1 < count:  # repeats: of one pose, frame, target and kind
        own = np.column_stack([blocks, samples.frame, samples.target, kinds])
        other = np.where((partner >= 0)[:, None], own[partner], -1)
        poses = np.unique(np.hstack([own, other]), axis=0, return_inverse=True)[1].reshape(-1)
    rows = Rows(
        samples=samples,
        kinds=kinds,
        measured=_measured(m, kinds),
        partner=partner,
        sigma=sigma(m.sigma, cell.sigma, FIRST_SIGMA),
        sigma_angle=sigma(m.sigma_angle, cell.sigma_angle, FIRST_SIGMA_ANGLE),
        poses=poses,
        blocks=joined_labels(
            blocks, [(int(i), int(partner[i])) for i in np.flatnonzero(partner >= 0)]
        ),
    )
    return rows, setup


def _measured(m: Measurements, kinds: Integers) -> Array:
    """What was measured, as `calib.registration.rows.Rows` has it, shape (N, K)."""
    present = [(registry.at(k), kinds == k) for k in np.unique(kinds).tolist() if k != NONE]
    result = np.zeros((len(m), max((kind.size for kind, _ in present), default=0)))
    for kind, rows in present:
        parts = [m.points[rows]] if kind.position else []
        if kind.orientation and m.rotations is not None:
            parts.append(m.rotations[rows].reshape(-1, 9))
        parts += [m.reading(one.name)[rows, None] for one in kind.readings]
        result[rows, : kind.size] = np.hstack(parts) if parts else 0.0
    return result


def _partners(m: Measurements) -> Integers:
    """The other row of each pair, shape (N,); -1 where there is none."""
    partner = np.full(len(m), -1)
    one, other = m.pair_rows.T
    partner[one], partner[other] = other, one
    alone = np.flatnonzero(m.paired & (partner < 0))
    if len(alone):
        i = int(alone[0])
        raise MeasurementError(
            f"{m.source or 'Measurements'}, row {m.rows[i]}: the pair '{m.pairs[i]}' has one row only in this set."
        )
    return partner
