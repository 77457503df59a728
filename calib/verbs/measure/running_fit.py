"""The fit to the stops so far, and what it predicts of a stop that it has not seen.

With the residual y of a new stop, its derivative A by the parameters and the noise N, the covariance of y is

    S = N + A C A^T,

C that of the parameters. The corners of a picture enter as the six numbers that they tell of the place of their board.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.basics.values import Value, keep_read_only
from calib.data.cell import AUTO, Cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.instruments.internals import with_starts
from calib.instruments.tracker import noise_of_lengths
from calib.model.internals import InternalValues
from calib.model.kinematics import Samples, Sightings
from calib.result.fewer_corners import with_fewer_corners
from calib.robot.robot import Robot
from calib.verbs.plan.sensitivity import PLANNED_FOR_AUTO

#: Degrees of freedom of the noise that the cell states or assumes, beside those of a fit, whose noise may be too small.
_NOISE_BEFORE = 4.0

#: Singular values below this share of the largest are rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Prediction(Value):
    """A stop compared with what a fit predicts of it: k numbers, in standard deviations of their noise."""

    #: Shape (k,), measured minus predicted
    y: Array
    #: Shape (k, k), covariance of y if the stop is as good as the others
    S: Array
    #: Norm of measured minus predicted by unit, rms over the targets or corners [m], [rad], [px]
    residual: Mapping[str, float]
    #: Its usual size
    usual: Mapping[str, float]

    def __post_init__(self) -> None:
        """Keep read-only copies of the mappings."""
        keep_read_only(self, "residual", "usual")

    @property
    def square(self) -> float:
        """y^T S^-1 y over the number of its entries: 1 on average if the stop is as good as the others."""
        return float(self.y @ np.linalg.solve(self.S, self.y)) / len(self.y)


@dataclass(frozen=True, slots=True, eq=False)
class RunningFit(Value):
    """A fit to some stops."""

    #: The robot in its cell with the model that was fitted
    fitted: Fitted
    #: The rows of the stops
    rows: Rows
    #: Shape (N,), which stop each row is of, from 0
    stops: Integers
    #: The cell, with the intrinsics from which fits begin
    cell: Cell

    @classmethod
    def of(
        cls,
        robot: Robot,
        cell: Cell,
        tables: Sequence[Measurements],
        before: RunningFit | None = None,
    ) -> RunningFit | None:
        """Fit the model of a cell to stops.

        Args:
            robot: The nominal robot.
            cell: The cell; the model ``"auto"`` is ``"placement"``, the largest geometry.
            tables: What was measured at each stop.
            before: A fit to some of the stops, where this one begins; None: frames and targets are registered.

        Returns:
            The fit; None if the stops do not determine frames and targets.
        """
        if not tables:
            return None
        table, _ = with_fewer_corners(Measurements.joined(tables))
        of_row = _stop_of_rows(tables)[np.array(table.rows) - 1] if len(tables) > 1 else None
        stops = np.zeros(len(table), dtype=np.int_) if of_row is None else of_row
        try:
            rows, setup = rows_and_setup(robot, table, cell)
            if cell.cameras:
                cell = with_starts(cell, table, rows.samples.internals)
            is_auto = cell.model == AUTO
            name = PLANNED_FOR_AUTO if is_auto else cell.model
            task = Task(robot, cell, setup, name, allow_absent=is_auto)
            near: tuple[Fitted, ...] = ()
            registered = None
            if before is not None:
                known = before.fitted.setup
                is_same = (known.groups, known.targets) == (setup.groups, setup.targets)
                near = (before.fitted,) if is_same else ()
                registered = _where_they_were(setup, known)
            return cls(fit(task, rows, registered=registered, near=near), rows, stops, cell)
        except MeasurementError:
            return None

    @property
    def count(self) -> int:
        """Number of stops."""
        return int(self.stops.max()) + 1

    def predict(self, table: Measurements) -> Prediction | None:
        """Compare a stop with what the fit predicts; None if it has a frame or target that the fit has not."""
        fitted, setup = self.fitted, self.fitted.setup
        if not (
            set(table.groups) <= set(setup.groups) and set(table.targets) <= set(setup.targets)
        ):
            return None
        rows = self._rows(table)
        estimate = fitted.estimate
        linear = Problem.initial(fitted.kinematics, rows).linear(estimate.x)
        noise = np.ones((len(rows), rows.width))
        known = estimate.problem.rows
        by_channel = {
            (kind.name, unit): value
            for kind, unit, value in zip(
                known.channel_kinds, known.channels.units, estimate.noise, strict=True
            )
        }
        for c, (kind, unit) in enumerate(zip(rows.channel_kinds, rows.channels.units, strict=True)):
            noise[rows.channels.index == c] = by_channel.get((kind.name, unit), estimate.noise[0])
        used = rows.used
        larger = self._larger_noise(noise)
        y = (linear.residual(estimate.x) / (noise * larger))[used]
        A = (linear.A / noise[:, :, None])[used]
        by_places, reduce = None, np.eye(len(y))
        if rows.is_image.all():
            by_places = self._by_places(rows, noise)
            reduce = _column_space(by_places).T
            y, A = reduce @ y, reduce @ A
        S = np.eye(len(y)) + A @ estimate.covariance @ A.T
        if by_places is not None:
            # The arm displaces all corners of a picture alike.
            anew = reduce @ by_places[:, :3] * noise_of_lengths(self.cell).repeatability
            S += anew @ anew.T
        residual = rows.residual(fitted.kinematics.sightings(estimate.x, rows.samples))
        square = float(np.trace(S)) / len(y)
        by_unit: dict[str, float] = {}
        usual: dict[str, float] = {}
        for unit in rows.channels.present:
            norms = rows.channels.norms(residual, unit)
            measuring = rows.channels.where(unit)
            by_unit[unit] = float(np.sqrt(np.nanmean(norms**2)))
            scalars = measuring.sum(axis=1).max()
            factor = float(np.max(larger[measuring]))
            usual[unit] = float(factor * estimate.sigma.get(unit, 0.0) * np.sqrt(scalars * square))
        return Prediction(y, S, by_unit, usual)

    def _larger_noise(self, noise: Array) -> Array:
        """Return how many times the noise is that of the fit, 1 or more, for noise as that found it.

        A fit to few stops takes some of the noise for errors of the robot: what is stated or assumed counts too.
        """
        freedom = max(self.fitted.estimate.freedom, 0.0)
        square = (freedom * noise**2 + _NOISE_BEFORE) / (freedom + _NOISE_BEFORE)
        return np.asarray(np.maximum(np.sqrt(square) / noise, 1.0))

    def places(self, q: Array) -> Array:
        """Predict where each target is at joint values (m,), in the measurement frame, shape (k, 3), [m]."""
        setup = self.fitted.setup
        k = len(setup.targets)
        samples = Samples(np.tile(q, (k, 1)), np.zeros(k, dtype=np.int_), np.arange(k))
        T = self.fitted.kinematics.poses(self.fitted.estimate.x, samples)
        return np.asarray(T[:, :3, 3])

    def distances(self, table: Measurements, q: Array) -> Array:
        """Return how far readings are from what is predicted at other joint values, in standard deviations.

        Args:
            table: The readings of a stop.
            q: Joint values of n poses, shape (n, m), [rad] or [m].

        Returns:
            Shape (n,), root of the mean square over the numbers of the stop.
        """
        rows = self._rows(table)
        kinematics, x = self.fitted.kinematics, self.fitted.estimate.x
        n, k = len(q), len(rows)
        everywhere = rows.select(np.tile(np.arange(k), n))
        samples = replace(everywhere.samples, q=np.repeat(q, k, axis=0))
        residual = everywhere.standardise(everywhere.residual(kinematics.sightings(x, samples)))
        squares = np.where(everywhere.used, residual**2, 0.0).reshape(n, -1)
        return np.asarray(np.sqrt(squares.sum(axis=1) / rows.used.sum()))

    def _rows(self, table: Measurements) -> Rows:
        """Return the readings of a stop as rows with the numbers that frames and targets have in the fit."""
        setup = self.fitted.setup
        # Where they are is known from the fit.
        cell = replace(self.cell, frames={}, targets={})
        rows, own = rows_and_setup(self.fitted.task.robot, table, cell)
        frame = np.array([setup.groups.index(name) for name in own.groups])
        target = np.array([setup.targets.index(name) for name in own.targets])
        samples = replace(
            rows.samples, frame=frame[rows.samples.frame], target=target[rows.samples.target]
        )
        return replace(rows, samples=samples)

    def _by_places(self, rows: Rows, noise: Array) -> Array:
        """Return what a displacement of the boards does to their corners, in standard deviations, (k, 6) [m, rad]."""
        fitted = self.fitted
        seen = fitted.kinematics.linearised(fitted.estimate.x, rows.samples)
        fixed = None if seen.internals is None else InternalValues.fixed(seen.internals.values)
        motions = np.broadcast_to(np.eye(6), (len(rows), 6, 6))
        moved = Sightings(seen.T_frame_target, motions, fixed)
        return np.asarray((rows.standardise(rows.derivative(moved)) / noise[:, :, None])[rows.used])


def _column_space(B: Array) -> Array:
    """Return an orthonormal basis of the column space of B (k, 6), (k, r)."""
    size = np.maximum(np.linalg.norm(B, axis=0), np.finfo(float).tiny)
    U, singular, _ = np.linalg.svd(B / size, full_matrices=False)
    return np.asarray(U[:, singular > _ROUNDING * singular[0]])


def _stop_of_rows(tables: Sequence[Measurements]) -> Integers:
    """Return the number of the stop of each row, from 0."""
    return np.repeat(np.arange(len(tables)), [len(table) for table in tables])


def _where_they_were(setup: Setup, before: Setup) -> Setup | None:
    """Return a setup with frames and targets where an earlier fit began, or as given; None if one is neither."""
    frames, targets = [], []
    for k, name in enumerate(setup.groups):
        if name in before.groups:
            frames.append(before.T_frame_base[before.groups.index(name)])
        elif setup.frame_given[k]:
            frames.append(setup.T_frame_base[k])
    for k, name in enumerate(setup.targets):
        if name in before.targets:
            targets.append(before.T_tip_target[before.targets.index(name)])
        elif setup.target_given[k]:
            targets.append(setup.T_tip_target[k])
    if len(frames) < len(setup.groups) or len(targets) < len(setup.targets):
        return None
    return setup.with_poses(np.stack(frames), np.stack(targets))
