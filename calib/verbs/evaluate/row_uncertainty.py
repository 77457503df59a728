"""Expanded uncertainty of the errors of measured rows: that of the prediction and of the measurement together.

The displacement of a predicted target has the covariance V (`calib.uncertainty`). With the derivative D of a row's
scalars by the displacement, and the standard deviations s of what was measured, the row's error has

    S = D V D^T + diag(s^2)

U is the length that an error with this covariance stays below with the probability of k = 2, in each unit. V includes
how the robot arrives and what the model lacks. s is what table, cell or calibration state of the instrument. Where
nothing states it, the scatter of the rows counts as the robot's, in V, and s is 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS, Channels
from calib.basics.values import ReadOnlyMapping, Value, keep_read_only
from calib.data.cell import Cell
from calib.data.columns import DEFAULT_TARGET
from calib.data.measurements import Measurements
from calib.errors import ModelError
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.internals import InternalValues
from calib.model.kinematics import Sightings
from calib.result.calibration import Calibration
from calib.result.row_scatter import UNITS
from calib.robot.robot import Robot
from calib.uncertainty.at_poses import PoseUncertainty, uncertainty_at
from calib.uncertainty.coverage import covered_length


@dataclass(frozen=True, slots=True, eq=False)
class RowUncertainty(Value):
    """Uncertainty of the errors of N rows, of D scalars each; NaN in rows whose frame or target it is not known for."""

    #: Shape (N, D, D), covariance of the predicted scalars, in their units
    predicted: Array
    #: Shape (N, D), standard deviation of the measured scalars
    measured: Array
    #: Degrees of freedom of ``predicted`` by the symbol of the scalars' unit, shape (N,) each
    freedom: Mapping[str, Array]
    #: The units of the scalars
    channels: Channels
    #: Scale of ``predicted`` with which its t distribution of ``freedom`` is like the sum of its parts, by the symbol
    #: of the unit, shape (N,) each; 1 where it is missing
    factor: Mapping[str, Array] = field(default_factory=ReadOnlyMapping)

    def __post_init__(self) -> None:
        """Keep read-only copies of the mappings."""
        keep_read_only(self, "freedom", "factor")

    def of_errors(self, unit: str) -> Array:
        """Return the expanded uncertainty of each row's error in a unit, shape (N,); NaN where it is not known.

        Args:
            unit: Symbol of the unit, ``"m"``, ``"rad"`` or ``"px"``.
        """
        return self._expanded(unit, self.measured**2)

    def of_predictions(self, unit: str) -> Array:
        """Return the same without the measurement's part: U of each prediction, shape (N,)."""
        return self._expanded(unit, np.zeros_like(self.measured))

    def of_mean(self, unit: str, repeats: Integers) -> float:
        """Return the expanded uncertainty of the mean error of some rows at one pose, whose predictions are the same.

        Args:
            unit: Symbol of the unit.
            repeats: Shape (n,), indices of the rows.
        """
        variance = np.mean(self.measured[repeats] ** 2, axis=0) / len(repeats)
        first = repeats[:1]
        alone = replace(
            self,
            predicted=self.predicted[first],
            measured=np.sqrt(variance)[None],
            freedom={symbol: of_unit[first] for symbol, of_unit in self.freedom.items()},
            factor={symbol: of_unit[first] for symbol, of_unit in self.factor.items()},
            channels=self.channels.select(first),
        )
        return float(alone.of_errors(unit)[0])

    def _expanded(self, unit: str, variance: Array) -> Array:
        """Return U in a unit with variances (N, D) of what was measured, which count as known."""
        of_unit = self.channels.where(unit)
        known = np.any(of_unit, axis=1) & np.isfinite(self.predicted).all(axis=(1, 2))
        result = np.full(len(known), np.nan)
        if not np.any(known):
            return read_only(result)
        mask = of_unit[known]
        predicted = self.predicted[known] * (mask[:, :, None] & mask[:, None, :])
        if unit in self.factor:
            predicted = self.factor[unit][known][:, None, None] * predicted
        noise = variance[known] * mask
        total = predicted + noise[:, :, None] * np.eye(mask.shape[1])
        by_prediction = np.trace(predicted, axis1=1, axis2=2)
        whole = by_prediction + np.sum(noise, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            freedom = self.freedom[unit][known] * (whole / by_prediction) ** 2
        freedom = np.where(np.isnan(freedom), np.inf, freedom)
        result[known] = covered_length(total, freedom)
        return read_only(result)


def row_uncertainty(
    result: Calibration,
    robot: Robot,
    table: Measurements,
    cell: Cell,
    setup: Setup,
    *,
    which: Sequence[str],
    non_geometric: bool,
) -> RowUncertainty | None:
    """Return the uncertainty of the errors of a table's rows by a calibrated robot.

    Args:
        result: The calibration.
        robot: The robot that was evaluated, with the chains of the result.
        table: The N rows.
        cell: Loads, noise, cameras and boards of these rows.
        setup: Their frames and targets, as evaluated.
        which: Places that are the result's, of ``"frame"`` and ``"target"``. A frame that is not adds nothing: the
            prediction is that in the base.
        non_geometric: Whether the non-geometric model predicts; else the geometry.

    Returns:
        The uncertainty. It is not known in rows of targets that are not the result's, and of pairs, whose two errors
        are not independent. None if the result does not predict at these rows.
    """
    rows, _ = rows_and_setup(robot, table, setup.in_cell(cell))
    frame_of, target_of = {}, {}
    if "frame" in which:
        frame_of = matching(setup.groups, result.setup.groups)
    if "target" in which:
        by_name = setup.targets[0] != DEFAULT_TARGET
        target_of = matching(setup.targets, result.setup.targets, by_name=by_name)
    frame = np.array([frame_of.get(k, -1) for k in range(len(setup.groups))])[rows.samples.frame]
    target = np.array([target_of.get(k, -1) for k in range(len(setup.targets))])
    target = target[rows.samples.target]

    width = rows.width
    predicted = np.full((len(rows), width, width), np.nan)
    freedom = {unit: np.full(len(rows), np.inf) for unit in RESIDUAL_UNITS}
    factor = {unit: np.ones(len(rows)) for unit in RESIDUAL_UNITS}
    known = (target >= 0) & ~rows.where(lambda kind: kind.paired or kind.of_joint)
    for in_base in (False, True):
        chosen = np.flatnonzero(known & ((frame < 0) == in_base))
        if not len(chosen):
            continue
        some = rows.select(chosen)
        try:
            samples = result.samples(some.joints, payload=cell.payload, moves=some.samples.moves)
            of_result = np.maximum(frame[chosen], 0)
            chain = result.setup.chains(result.nominal, of_result, target[chosen])
        except ModelError:
            return None
        samples = replace(samples, frame=of_result, target=target[chosen], chain=chain)
        at_rows = uncertainty_at(result, samples, non_geometric=non_geometric, in_base=in_base)
        T_frame_base = setup.T_frame_base[some.samples.frame] if in_base else None
        predicted[chosen] = _of_scalars(some, at_rows, T_frame_base)
        for unit in RESIDUAL_UNITS:
            U, nu, V = at_rows.position, at_rows.position_freedom, at_rows.covariance[:, :3, :3]
            if unit == "rad":
                U, nu = at_rows.orientation, at_rows.orientation_freedom
                V = at_rows.covariance[:, 3:, 3:]
            by_covariance = covered_length(V, nu)
            freedom[unit][chosen] = nu
            is_uncertain = by_covariance > 0.0
            factor[unit][chosen[is_uncertain]] = (U / by_covariance)[is_uncertain] ** 2
    stds = _measured_std(result, rows, table, cell)
    return RowUncertainty(read_only(predicted), stds, freedom, rows.channels, factor)


def _of_scalars(rows: Rows, at_rows: PoseUncertainty, T_frame_base: Array | None) -> Array:
    """Return D V D^T of N rows, (N, D, D); V is along the axes of the base, at ``T_frame_base`` (N, 4, 4), if given."""
    poses, V = at_rows.poses, at_rows.covariance
    if T_frame_base is not None:
        poses = T_frame_base @ poses
        turn = np.zeros((len(rows), 6, 6))
        turn[:, :3, :3] = turn[:, 3:, 3:] = T_frame_base[:, :3, :3]
        V = turn @ V @ turn.transpose(0, 2, 1)
    internals = rows.samples.internals
    unit_twists = np.broadcast_to(np.eye(6), V.shape)
    sightings = Sightings(
        poses, unit_twists, None if internals is None else InternalValues.fixed(internals)
    )
    D = rows.derivative(sightings)
    return np.asarray(D @ V @ D.transpose(0, 2, 1))


def _measured_std(result: Calibration, rows: Rows, table: Measurements, cell: Cell) -> Array:
    """Return the standard deviation of each measured scalar, (N, D): as the table, the cell or the result states it."""
    stds = np.zeros(rows.used.shape)
    for unit in rows.channels.present:
        of_result = result.noise.sigma_given.get(unit, 0.0)
        scatter = result.geometry.scatter
        if scatter is not None and unit in UNITS:
            variance = scatter.instrument[UNITS.index(unit)]
            of_result = float(np.sqrt(variance)) if np.isfinite(variance) else of_result
        general = cell.sigma.get(unit, of_result)
        by_row = table.stated_sigma.get(unit, np.full(len(rows), np.nan))
        by_row = np.where(np.isfinite(by_row), by_row, general)
        of_unit: Mask = rows.channels.where(unit)
        stds = np.where(of_unit, by_row[:, None], stds)
    return read_only(stds)


def matching(
    names: tuple[str, ...], known: tuple[str, ...], *, by_name: bool = False
) -> dict[int, int]:
    """Match the names of stations or targets of a table with those of a result.

    Args:
        names: Those of the table.
        known: Those of the result.
        by_name: Two single ones are matched only if they have the same name; else whatever they are called.

    Returns:
        The index of each name in the result by its index in the table, both from 0; names it lacks are left out.
    """
    if len(names) == len(known) == 1 and not by_name:
        return {0: 0}
    return {k: known.index(name) for k, name in enumerate(names) if name in known}
