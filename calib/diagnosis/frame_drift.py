"""Drift and steps of measurement frames, by targets that stand still: found, and taken out of the measurements.

The readings of a reference, and the residuals of the robot's rows of the same station, are the evidence of
`calib.numerics.frame_path`. What is found of the frame is taken out of the measured poses, which become what they were
at the first row of the table:

    T_frame_target  <-  exp(-f w) (T_frame_target - f (v + w x (p - c)))

Two kinds of references tell who has moved: an instrument displaces all that it measures; a base those on it and the
robot's targets, but none in the world. A reference that was itself knocked displaces no row of the robot.

What is left is an error of each coordinate of a measured position: by the estimates, by the place of a step, and by a
drift too small to be found, whose standard deviation is that of its estimate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.values import Value
from calib.data.measurements import Measurements
from calib.data.references import References
from calib.diagnosis.augmented_fit import FEWEST_FREEDOM, thin
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.residuals import Residuals
from calib.errors import MeasurementError, choices
from calib.fit.estimate.fitting import Fitted
from calib.model.kinematics import Sightings
from calib.numerics.frame_path import (
    Change,
    Evidence,
    Form,
    Path,
    find_path,
    interval_of_places,
)

#: The links of references: in the world, where the instrument stands, or on the robot's base.
WORLD = "world"
BASE = "base"

#: Names of what moves, in the search for changes.
_FRAME = "frame"
_INSTRUMENT = "instrument"
_OF_BASE = "base"
_REFERENCE = "reference:"

#: Targets on one line, within this share of their extent, do not show a rotation about it.
_ON_A_LINE = 0.01

#: A column of which less than this share is not in the range of others adds nothing to them.
_IN_RANGE = 1e-4

#: Readings of a target of which one may be off by itself: of two it cannot be told which.
_TELLING = 3

#: About so many places of a step among the poses are tried.
_MOST_PLACES = 300

#: Displacements that differ by less are the same [m].
_SAME = 1e-9

#: Readings of targets that stand still scatter by less, whatever measures them, once movements are known [m].
_NOT_STILL = 0.01


class Mover(Enum):
    """The thing whose movement changed the readings."""

    #: The instrument or the base: the references do not tell which
    FRAME = "frame"
    INSTRUMENT = "instrument"
    BASE = "base"
    #: One reference, which does not stand still
    REFERENCE = "reference"
    #: One reading, which is off
    READING = "reading"


@dataclass(frozen=True, slots=True, eq=False)
class Movement(Value):
    """A drift or a step that the references show."""

    #: ``Form.DRIFT``, even from the first row to the last; ``STEP`` from a row on; ``READING`` of one row alone
    form: Form
    #: What has moved
    mover: Mover
    #: Name of the reference that moved or was read wrongly; empty if the frame moved
    reference: str
    #: Name of the station
    group: str
    #: Row number of the first row that is displaced; 0 of a drift
    row: int
    #: Row numbers between which a step happened, with a probability of 95 %; 0 if it is no step
    after_row: int
    before_row: int
    #: Shape (3,), displacement along the measurement frame's axes, of a drift from the first row to the last, and its
    #: standard deviation [m]; if it rotates too, that of the middle of the measured points
    by: Array
    std: Array
    #: Shape (3,), rotation about these axes [rad]; 0 unless three references or more show one
    rotation: Array
    #: Probability that chance shows as much anywhere in a table
    p: float

    @property
    def corrected(self) -> bool:
        """True if it was taken out of the measured poses: the frame moved, and not a reference by itself."""
        return self.mover not in (Mover.REFERENCE, Mover.READING)

    @property
    def size(self) -> float:
        """Length of the displacement [m]."""
        return float(np.linalg.norm(self.by))


@dataclass(frozen=True, slots=True)
class StillTarget:
    """A target that stands still, as it was read."""

    #: Its name, that of the station, and where it is mounted: ``"world"``, ``"base"``; empty if that was not said
    target: str
    group: str
    link: str
    #: Number of readings
    readings: int
    #: Standard deviation of a coordinate about its mean, drift and steps included [m]; NaN of a single reading
    scatter: float


@dataclass(frozen=True, slots=True, eq=False)
class FrameDrift(Value):
    """Movements and noise that the references of a table show."""

    #: The references
    targets: tuple[StillTarget, ...]
    #: What has moved, by station and row
    found: tuple[Movement, ...]
    #: Standard deviation of a coordinate of a reading without drift and steps [m], and its degrees of freedom; NaN if
    #: no reference was read twice
    scatter: float
    freedom: int
    #: Standard deviation of what is left of the drift of a measured coordinate, rms over the fitted rows [m]; NaN if no
    #: reference was read twice
    left: float

    @property
    def corrected(self) -> tuple[Movement, ...]:
        """The movements that were taken out of the measured poses."""
        return tuple(movement for movement in self.found if movement.corrected)


@dataclass(frozen=True, slots=True, eq=False)
class Displacements:
    """By how much the frames of N rows were displaced against the first row of the table."""

    #: Shape (N, 3) [m], of the measured positions
    points: Array
    #: Shape (N, 3) [rad], of the measured orientations, as a rotation vector
    turns: Array

    def same_as(self, other: Displacements) -> bool:
        """Return whether others are the same but for rounding."""
        return bool(
            np.allclose(self.points, other.points, rtol=0.0, atol=_SAME)
            and np.allclose(self.turns, other.turns, rtol=0.0, atol=_SAME)
        )


def find_frame_drift(
    measurements: Measurements,
    links: Mapping[str, str] | None = None,
    fitted: Fitted | None = None,
    taken_out: Displacements | None = None,
) -> tuple[FrameDrift, Displacements] | None:
    """Find how the measurement frames of a table moved, by its references.

    Args:
        measurements: The table as measured, with N rows.
        links: What references are mounted on by their names, ``"world"`` or ``"base"``, as `Cell.references`; None:
            nothing is known.
        fitted: A fit to its estimation rows, whose residuals tell the place of a step between two readings; None: there
            is none.
        taken_out: What was taken out of the rows before that fit; None: nothing.

    Returns:
        What was found, and the displacements of the rows; None if the table has no references.

    Raises:
        MeasurementError: ``links`` are given, and a reference of the table is not among them; or the readings of a
            reference are of several targets.
    """
    references = measurements.references
    if references is None:
        return None
    links = links or {}
    unnamed = [name for name in references.targets if links and name not in links]
    if unnamed:
        raise MeasurementError(
            f"{measurements.source or 'Measurements'}: the cell's [references] say what {choices(links)} are mounted "
            f'on, and nothing of \'{unnamed[0]}\'. Add {unnamed[0]} = "{WORLD}" or "{BASE}", or leave out all.'
        )
    poses = None
    if fitted is not None and fitted.estimate.freedom >= FEWEST_FREEDOM:
        poses = _Residuals.of(measurements, fitted, taken_out)
    count = len(measurements)
    displaced = Displacements(np.zeros((count, 3)), np.zeros((count, 3)))
    found: list[Movement] = []
    squares, freedom, left = 0.0, 0, np.zeros(count)
    for group in dict.fromkeys(references.groups):
        station = _Station.of(measurements, references, group, links)
        path = station.path(poses)
        if path.scatter > _NOT_STILL:
            _refuse_scatter(references, group, measurements.source)
        found += station.movements(path)
        station.displace(path, displaced)
        left = left + station.variance_left(path)
        if path.freedom > 0:
            squares += path.freedom * path.scatter**2
            freedom += path.freedom
    fitted_rows = measurements.estimation & measurements.positions
    rms_left = float(np.sqrt(np.mean(left[fitted_rows]))) if np.any(fitted_rows) else np.nan
    drift = FrameDrift(
        targets=tuple(_still_targets(references, links)),
        found=tuple(found),
        scatter=float(np.sqrt(squares / freedom)) if freedom else np.nan,
        freedom=freedom,
        left=rms_left,
    )
    return drift, displaced


def without_frame_drift(measurements: Measurements, displaced: Displacements) -> Measurements:
    """Take displacements of the frames out of measured positions and orientations.

    Args:
        measurements: The table as measured, with N rows.
        displaced: The displacements of its rows.

    Returns:
        The table as it would be if the frames had stood still; the same object if there are none.
    """
    if not displaced.points.any() and not displaced.turns.any():
        return measurements
    rotations = measurements.rotations
    if rotations is not None and displaced.turns.any():
        back = Rotation.from_rotvec(-displaced.turns).as_matrix()
        rotations = back @ rotations
    return replace(measurements, points=measurements.points - displaced.points, rotations=rotations)


def shown_by_references(drift: FrameDrift) -> Iterator[Reason]:
    """Say what references show: what was taken out of the measurements, or that nothing moved.

    Args:
        drift: What was found.

    Yields:
        A reason for each movement; one if there is none. ``left_m`` is what may be left of a drift of a coordinate, as
        a standard deviation.
    """
    for one in drift.found:
        common: dict[str, Any] = {"mover": one.mover.value, "reference": one.reference}
        common["group"] = one.group
        common |= {"by_xyz": one.by.tolist(), "moved_m": one.size, "p": one.p}
        if one.form is Form.READING:
            yield Reason.of(Why.REFERENCE_MISREAD, row=one.row, **common)
        elif not one.corrected:
            yield Reason.of(Why.REFERENCE_MOVED, row=one.row, **common)
        elif one.form is Form.DRIFT:
            yield Reason.of(Why.REFERENCES_DRIFT, left_m=drift.left, **common)
        else:
            between = {"after_row": one.after_row, "before_row": one.before_row}
            yield Reason.of(
                Why.REFERENCES_STEP, row=one.row, **between, left_m=drift.left, **common
            )
    readings = sum(one.readings for one in drift.targets)
    if not np.isfinite(drift.left):
        yield Reason.of(Why.REFERENCES_TOO_FEW, readings=readings)
    elif not drift.corrected:
        yield Reason.of(Why.REFERENCES_STILL, readings=readings, left_m=drift.left)


def _refuse_scatter(references: References, group: str, source: str) -> None:
    """Refuse readings of a station that cannot be of targets that stand still; `MeasurementError` names the worst."""
    here = [one for one in _still_targets(references, {}) if one.group == group]
    worst = max(here, key=lambda one: -1.0 if np.isnan(one.scatter) else one.scatter)
    raise MeasurementError(
        f"{source or 'Measurements'}: the {worst.readings} readings of the reference '{worst.target}' scatter by "
        f"{1e3 * worst.scatter:.0f} mm a coordinate, as those of several targets. Give each target that stands still a "
        "name of its own in the column 'target', also one that was put elsewhere, and correct readings that are wrong."
    )


def _still_targets(references: References, links: Mapping[str, str]) -> list[StillTarget]:
    """Return each reference, with the scatter of its readings."""
    names = list(zip(references.targets, references.groups, strict=True))
    result = []
    for target, group in dict.fromkeys(names):
        points = references.points[[name == (target, group) for name in names]]
        n = len(points)
        scatter = np.nan
        if n > 1:
            scatter = float(np.sqrt(np.sum((points - points.mean(axis=0)) ** 2) / (3.0 * (n - 1))))
        result.append(StillTarget(target, group, links.get(target, ""), n, scatter))
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _Residuals:
    """The M whitened residuals of a fit, as they were before anything was taken out."""

    #: Shape (M, b), shape (M,), and shape (M,): the table's row of each scalar, from 0
    base: Array
    residual: Array
    row: Integers
    #: Shape (M, 6), by a displacement and a rotation of the frame's content about its origin
    directions: Array

    @classmethod
    def of(
        cls, measurements: Measurements, fitted: Fitted, taken_out: Displacements | None
    ) -> _Residuals:
        """Whiten the residuals of a fit to the estimation rows of a table, and their derivatives."""
        few, chosen = thin(fitted)
        in_table = np.flatnonzero(measurements.estimation)[chosen]
        moves = measurements.moves_for(few.task.robot.joint_names)[in_table]
        residuals = Residuals.of(few, np.array(measurements.rows)[in_table], moves)
        rows, kinematics, x = (
            few.estimate.problem.rows,
            few.estimate.problem.kinematics,
            few.estimate.x,
        )
        T = kinematics.poses(x, rows.samples)
        internals = kinematics.internals(x, rows.samples)
        twists = _twists(T[:, :3, 3])
        stack = residuals.stack
        directions = residuals.whiten(rows.derivative(Sightings(T, twists, internals)))
        residual = stack.r
        if taken_out is not None:
            of_row = np.hstack([taken_out.points[in_table], taken_out.turns[in_table]])[:, :, None]
            back = residuals.whiten(rows.derivative(Sightings(T, of_row, internals)))
            residual = residual + back[:, 0]
        # The constant of each component is the frame's own place.
        base, _ = np.linalg.qr(np.column_stack([stack.A, _beyond(stack.A, stack.ones)]))
        return cls(base, residual, in_table[stack.row_of], directions)


def _beyond(base: Array, columns: Array) -> Array:
    """Return those of columns, (M, k), that are not in the range of an orthonormal base, (M, b)."""
    size = np.linalg.norm(columns, axis=0)
    left = columns / size - base @ (base.T @ (columns / size))
    return np.asarray(columns[:, np.linalg.norm(left, axis=0) > _IN_RANGE])


def _twists(points: Array) -> Array:
    """Return the motions of points, (N, 3) [m], by displacements and rotations about the origin, shape (N, 6, 6)."""
    twists = np.tile(np.eye(6), (len(points), 1, 1))
    x, y, z = points.T
    zero = np.zeros(len(points))
    # w x r = -[r] w
    cross = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]])
    twists[:, :3, 3:] = cross.transpose(2, 0, 1)
    return twists


@dataclass(frozen=True, slots=True, eq=False)
class _Station:
    """One measurement frame: its readings of references, and its rows of the robot."""

    measurements: Measurements
    references: References
    group: str
    #: Shape (K,), shape (N,): its readings, and its rows
    is_read: Mask
    is_row: Mask
    #: Names of its references, and what each is mounted on
    names: tuple[str, ...]
    links: Mapping[str, str]

    @classmethod
    def of(
        cls,
        measurements: Measurements,
        references: References,
        group: str,
        links: Mapping[str, str],
    ) -> _Station:
        """Pick the readings and the rows of a station."""
        is_read = np.array([name == group for name in references.groups])
        is_row = np.array([name == group for name in measurements.groups]) & measurements.positions
        names = [
            name for name, here in zip(references.targets, is_read.tolist(), strict=True) if here
        ]
        return cls(
            measurements, references, group, is_read, is_row, tuple(dict.fromkeys(names)), links
        )

    @property
    def span(self) -> int:
        """The last place of the table."""
        return len(self.references.sequence) - 1

    @property
    def read_places(self) -> Array:
        """Place of each of its readings."""
        rows = np.array(self.references.rows)[self.is_read]
        return self.references.places_of(rows.tolist()).astype(np.float64)

    @property
    def row_places(self) -> Array:
        """Place of each of all N rows."""
        return self.references.places_of(self.measurements.rows).astype(np.float64)

    @property
    def target_of(self) -> Array:
        """Number, in ``names``, of the target of each of its readings."""
        names = np.array(self.references.targets)[self.is_read].tolist()
        return np.array([self.names.index(name) for name in names])

    @property
    def centre(self) -> Array:
        """The middle of the measured points, shape (3,) [m]."""
        points = self.measurements.points[self.is_row]
        points = points if len(points) else self.references.points[self.is_read]
        return np.asarray(points.mean(axis=0))

    @property
    def frame_movers(self) -> tuple[str, ...]:
        """The parts of the frame that may move and can be told apart."""
        here = {self.links[name] for name in self.names if name in self.links}
        if here == {WORLD, BASE}:
            return (_INSTRUMENT, _OF_BASE)
        return (_INSTRUMENT,) if here == {WORLD} else (_FRAME,)

    @property
    def shows_rotations(self) -> bool:
        """True if three of its references, each read twice, are not on one line."""
        counts = np.bincount(self.target_of, minlength=len(self.names))
        points = self.references.points[self.is_read]
        means = np.array(
            [points[self.target_of == k].mean(axis=0) for k in np.flatnonzero(counts > 1)]
        )
        if len(means) < 3:
            return False
        sizes = np.linalg.svd(means - means.mean(axis=0), compute_uv=False)
        return bool(sizes[1] > _ON_A_LINE * sizes[0] > 0.0)

    def readings(self) -> Evidence:
        """Return the readings of its references as evidence."""
        points = self.references.points[self.is_read]
        count, target = len(points), self.target_of
        base = np.zeros((3 * count, 3 * len(self.names)))
        residual = np.empty((count, 3))
        for k in range(len(self.names)):
            mine = np.flatnonzero(target == k)
            residual[mine] = points[mine] - points[mine].mean(axis=0)
            for axis in range(3):
                base[3 * mine + axis, 3 * k + axis] = 1.0 / np.sqrt(len(mine))
        moved: dict[str, Mask] = dict.fromkeys(
            (_FRAME, _INSTRUMENT), np.ones(3 * count, dtype=np.bool_)
        )
        on_base = np.array([self.links.get(self.names[k]) == BASE for k in target])
        moved[_OF_BASE] = np.repeat(on_base, 3)
        for k, name in enumerate(self.names):
            moved[_REFERENCE + name] = np.repeat(target == k, 3)
        return Evidence(
            base=base,
            residual=residual.ravel(),
            places=np.repeat(self.read_places, 3),
            directions=_twists(points - self.centre)[:, :3].reshape(-1, 6),
            moved=moved,
            readings=np.repeat(np.arange(count), 3),
            span=self.span,
        )

    def of_poses(self, poses: _Residuals) -> Evidence:
        """Return the residuals of its rows as evidence, those of other stations beside them."""
        about_centre = poses.directions.copy()
        x, y, z = self.centre
        cross = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        about_centre[:, 3:] -= poses.directions[:, :3] @ cross
        here = self.is_row[poses.row]
        return Evidence(
            base=poses.base,
            residual=poses.residual,
            places=self.row_places[poses.row],
            directions=about_centre,
            moved=dict.fromkeys((_FRAME, _INSTRUMENT, _OF_BASE), here),
            readings=np.full(len(poses.residual), -1),
            span=self.span,
        )

    def possible(self, *, with_poses: bool) -> list[Change]:
        """Return all changes that may be found, those of the frame first."""
        evidence = self.readings()
        read = self.read_places.astype(np.int_)
        first, last = int(read.min()), int(read.max())
        rows = np.sort(self.row_places[self.is_row].astype(np.int_))
        rows = rows[:: len(rows) // _MOST_PLACES + 1]
        # Between two readings of one visit nothing is tried: a visit's first reading stands for it.
        visits = [place for place in np.sort(read).tolist() if place - 1 not in read]
        places = sorted({*rows.tolist(), *visits})
        places = [place for place in places if first < place <= last]
        result = []
        rotations = (False, True) if self.shows_rotations else (False,)
        for rigid in rotations:
            for mover in self.frame_movers:
                result.append(Change(Form.DRIFT, 0, mover, rigid, not rigid))
                result += [Change(Form.STEP, place, mover, rigid, not rigid) for place in places]
        for k, name in enumerate(self.names):
            mine = np.flatnonzero(self.target_of == k)
            mover = _REFERENCE + name
            as_frame = [
                np.array_equal(evidence.moved[mover], evidence.moved[one])
                for one in self.frame_movers
            ]
            # Without poses a reference that is the only one of its kind may as well be the frame.
            if with_poses or not any(as_frame):
                result.append(Change(Form.DRIFT, 0, mover))
                result += [Change(Form.STEP, int(place), mover) for place in sorted(read[mine])[1:]]
            if len(mine) >= _TELLING:
                result += [Change(Form.READING, int(i), _REFERENCE + name) for i in mine]
        return result

    def path(self, poses: _Residuals | None) -> Path:
        """Find the changes of the frame."""
        evidence = None if poses is None else self.of_poses(poses)
        return find_path(self.readings(), evidence, self.possible(with_poses=poses is not None))

    def movements(self, path: Path) -> list[Movement]:
        """Return the changes of a path as what has moved, by rows of the table."""
        sequence = self.references.sequence
        std = np.sqrt(np.diag(path.covariance))
        result = []
        for k, (change, mine) in enumerate(zip(path.changes, path.slices(), strict=True)):
            row = after = before = 0
            mover, name = Mover.FRAME, ""
            if change.mover.startswith(_REFERENCE):
                mover, name = Mover.REFERENCE, change.mover.removeprefix(_REFERENCE)
            elif change.mover != _FRAME:
                mover = Mover(change.mover)
            if change.form is Form.READING:
                mover = Mover.READING
                row = int(np.array(self.references.rows)[self.is_read][change.place])
            if change.form is Form.STEP:
                median, first, last = interval_of_places(path.places[k])
                row, after, before = sequence[median], sequence[first - 1], sequence[last]
            unknowns = path.unknowns[mine]
            result.append(
                Movement(
                    form=change.form,
                    mover=mover,
                    reference=name,
                    group=self.group,
                    row=row,
                    after_row=after,
                    before_row=before,
                    by=read_only(unknowns[:3]),
                    std=read_only(std[mine][:3]),
                    rotation=read_only(unknowns[3:] if change.rigid else np.zeros(3)),
                    p=path.p[k],
                )
            )
        return result

    def displace(self, path: Path, displaced: Displacements) -> None:
        """Add the displacements of its rows by what of a path is the frame's."""
        rows = np.flatnonzero(self.is_row)
        twists = _twists(self.measurements.points[rows] - self.centre)
        for k, (change, mine) in enumerate(zip(path.changes, path.slices(), strict=True)):
            if change.mover not in self.frame_movers:
                continue
            share = path.shares(k, self.row_places[rows], self.span)
            moved = share[:, None] * (twists[:, :, : change.unknowns] @ path.unknowns[mine])
            displaced.points[rows] += moved[:, :3]
            displaced.turns[rows] += moved[:, 3:]

    def variance_left(self, path: Path) -> Array:
        """Return the variance of what a path leaves of the drift of a coordinate of each of N rows [m^2]."""
        variance = np.zeros(len(self.measurements))
        rows = np.flatnonzero(self.is_row)
        places = self.row_places[rows]
        twists = _twists(self.measurements.points[rows] - self.centre)[:, :3]
        J = np.zeros((len(rows), 3, len(path.unknowns)))
        by_place = np.zeros(len(rows))
        drifting = set()
        for k, (change, mine) in enumerate(zip(path.changes, path.slices(), strict=True)):
            if change.mover not in self.frame_movers:
                continue
            along = twists[:, :, : change.unknowns]
            share = path.shares(k, places, self.span)
            J[:, :, mine] = share[:, None, None] * along
            if change.form is Form.STEP:
                moved = along @ path.unknowns[mine]
                by_place += share * (1.0 - share) * np.sum(moved**2, axis=1)
            else:
                drifting.add(change.mover)
        total = np.einsum("nip,pq,niq->n", J, path.covariance, J, optimize=True) + by_place
        variance[rows] = total / 3.0
        readings = self.readings().beyond(path.changes)
        for mover in self.frame_movers:
            if mover not in drifting:  # a drift that would not be found
                columns = readings.columns(Change(Form.DRIFT, 0, mover))
                Z = columns - readings.base @ (readings.base.T @ columns)
                # What the base explains leaves rounding, whose rank says nothing.
                tells = np.linalg.norm(Z, ord=-2) > _IN_RANGE * np.linalg.norm(columns)
                trace = np.trace(np.linalg.inv(Z.T @ Z)) if tells else np.nan
                variance[rows] += (places / max(self.span, 1)) ** 2 * path.scatter**2 * trace / 3.0
        return variance
