"""check: has anything moved since a calibration, and what, by a few fresh rows?

The evidence and the test are those of `calib.verbs.check.evidence`, the numbers that they weigh those of
`calib.verbs.check.innovations`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.special import logsumexp

from calib.basics.arguments import check_number, check_path
from calib.basics.arrays import Array
from calib.basics.jobs import one_blas_thread
from calib.basics.tables import Table
from calib.basics.values import Value, shown_by
from calib.data.cell import Cell
from calib.data.columns import SETS
from calib.data.forms.column_options import ColumnsInput
from calib.data.inputs import CellInput, TableInput, cell_of, inputs_of
from calib.data.measurements import Measurements
from calib.errors import MeasurementError, ModelError, choices
from calib.fit.registration.board_ends import with_ends_of
from calib.fit.registration.rows import Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Samples
from calib.result.calibration import Calibration
from calib.result.calibration_file import ResultInput, result_of
from calib.result.chain_of_result import with_chain_of_result
from calib.robot.ranges import spread_between, spread_poses
from calib.show.lines import listed, row_ranges
from calib.verbs.check.causes import MOVING, Cause, Code, causes_of, moving_causes
from calib.verbs.check.evidence import Directions, EvidenceTest, estimate, log_weights
from calib.verbs.check.innovations import LEVER, Stack, Stop, StoredResult, numbered_as, stacked
from calib.verbs.evaluate.accuracy import fitted_rows

#: ``"nothing"``: no evidence that anything has moved; ``"moved"``: one cause has at least `SURE`; ``"undecided"``:
#: something has moved, and several causes explain it; ``"row"``: a single stop is off; ``"other"``: none of the causes.
Outcome = Literal["nothing", "moved", "undecided", "row", "other"]

#: A cause with this probability, if something has moved, is named alone.
SURE = 0.95

#: Several causes are named until they have this probability together.
NAMED = 0.99

#: Joint values over which the effect of a displacement is averaged.
_POSES = 256


@dataclass(frozen=True, slots=True, eq=False)
class Finding(Value):
    """A cause, how probable it is, and what it would have done."""

    #: ``"frame"``, ``"target"``, ``"base"``, ``"hand"``, ``"joint"``, ``"row"`` or ``"other"``
    code: Code
    #: Name of the frame, target or joint; empty for the only frame or target, and where there is none
    name: str
    #: Probability, if something is off at all
    probability: float
    #: Change of a joint's zero [rad] or [m]; of rows and others the distance by which the target is displaced at each,
    #: rms [m]; of the rest that over the fitted joint values, as ``change``
    size: float
    #: Its standard deviation
    size_std: float
    #: ``"m"`` or ``"rad"``
    unit: str
    #: Angle by which something has turned [rad]; NaN if it does not show
    turn: float
    #: Change of the target's positions over the fitted joint values, rms [m]; NaN for rows and others
    change: float
    #: Its standard deviation [m]
    change_std: float
    #: Rows that are off, for the code ``"row"``
    rows: tuple[int, ...] = ()
    #: Their image
    image: str = ""


@dataclass(frozen=True, slots=True)
class Noticed(Value):
    """The smallest displacement of a cause that these stops would have shown in 95 of 100 checks."""

    #: As of a `Finding`
    code: Code
    #: As of a `Finding`
    name: str
    #: Shift in the direction that shows least [m]; of a sliding joint its zero; infinite if it does not show, NaN if
    #: there is none
    shift: float
    #: Turn about the axis that shows least, wherever it is [rad]; of a joint that turns its zero; infinite or NaN as
    #: the shift
    turn: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CheckResult(Value):
    """The answer of a few fresh rows about a stored result."""

    #: The stored result
    result: Calibration
    #: The answer, an `Outcome`
    outcome: Outcome
    #: Probability of as much evidence if nothing has moved
    p_value: float
    #: Probability of "nothing", with equal odds beforehand
    nothing: float
    #: The causes, the most probable first
    findings: tuple[Finding, ...]
    #: Number of stops
    stops: int
    #: Number of numbers that they measure, an image's as six
    numbers: int
    #: Norm of measured minus predicted over its expectation, rms over all numbers; 1 if nothing has moved
    ratio: float
    #: Expected error of the result at a new point, rms, without that of the instrument's scale [m]
    expected: float
    #: Tolerance of positions, as given [m]; None: none
    tolerance: float | None
    #: The result, prepared to be compared with
    stored: StoredResult
    #: The stops, whitened
    stack: Stack
    #: The causes that were weighed
    causes: tuple[Cause, ...]
    #: How each shows at the stops
    directions: tuple[Directions, ...]
    #: The distribution of the evidence if nothing has moved
    test: EvidenceTest

    def __repr__(self) -> str:
        """One line: the answer."""
        return str(shown_by("verbs.check.text").answer(self))

    def summary(self) -> str:
        """Return the answer as text, as ``calib check`` prints it."""
        return str(shown_by("verbs.check.text").check_text(self))

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the answer as JSON, in SI units; see docs/check.md.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            ArgumentError: The path is of another type.
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        return Path(shown_by("verbs.check.check_file").write_check(self, path, overwrite=overwrite))

    @property
    def named(self) -> tuple[Finding, ...]:
        """The causes that are named: none, the one that is sure, or those that together are."""
        if self.outcome == "nothing":
            return ()
        if self.outcome != "undecided":
            return self.findings[:1]
        total = np.cumsum([finding.probability for finding in self.findings])
        return self.findings[: int(np.searchsorted(total, NAMED)) + 1]

    @property
    def noticed(self) -> tuple[Noticed, ...]:
        """The smallest displacement of each cause that would have been noticed; it is computed when it is asked for."""
        return tuple(_noticed(self.test, self.stack, cause) for cause in moving_causes(self.stored))

    @property
    def matters(self) -> bool | None:
        """True if the likeliest cause changes positions by more than the tolerance, or the expected error without one.

        None: nothing has moved, or its effect is not known.
        """
        if not self.named or not np.isfinite(self.named[0].change):
            return None
        allowed = self.expected if self.tolerance is None else self.tolerance
        return bool(self.named[0].change > allowed)


@one_blas_thread()
def check(
    calibration: ResultInput,
    measurements: TableInput,
    cell: CellInput = None,
    *,
    tolerance: float | None = None,
) -> CheckResult:
    """Check by a few fresh rows whether anything has moved since a calibration, and what.

    Args:
        calibration: The result, or the path of its file.
        measurements: The fresh rows, or the path of their table; three stops are enough if they are chosen well, see
            `check_poses`. All rows count, also those of the set ``validate``.
        cell: Further facts, such as a payload or the sigma of the rows; None: there are none.
        tolerance: Change of positions that does not matter [m]; None: the result's expected error.

    Returns:
        The outcome, the probability of each cause, how far it has moved, and what would not have been noticed.

    Raises:
        ArgumentError: An argument of another type.
        MeasurementError: The table has no row that measures anything, or a row that the result was fitted to, or it
            measures orientations, of which the result knows nothing.
        ModelError: It has a frame or a target that the result lacks.
    """
    result = result_of(calibration)
    if tolerance is not None:
        check_number("tolerance", tolerance, 0.0)
    stored = StoredResult.of(result)
    stops = fresh_stops(stored, measurements, cell_of(cell))
    return judged(stored, stops, tolerance)


def fresh_stops(stored: StoredResult, measurements: TableInput, cell: Cell) -> tuple[Stop, ...]:
    """Read fresh rows as stops, compared with what a result predicts; errors as of `check`."""
    result = stored.result
    known = result.complete_cell(with_chain_of_result(cell, result, "The calibration"))
    if result.non_geometric is not None:
        payload = known.payload or result.non_geometric.payload
        known = replace(known, payload=payload, gravity=result.non_geometric.gravity)
    if isinstance(measurements, (str, Path)):
        measurements = read_fresh(result, measurements)
    arm, table, known = inputs_of(result.nominal, measurements, known)
    rows, setup = rows_and_setup(arm, table, replace(known, model="auto"))
    rows = _in_result(stored, rows, setup.groups, setup.targets, table.source)
    from_one_end = with_ends_of(
        table,
        known,
        rows,
        stored.part.setup,
        stored.displaced.robot.poses(rows.joints, rows.samples.chain),
    )
    if from_one_end.other_end:
        table = from_one_end
        rows, setup = rows_and_setup(arm, table, replace(known, model="auto"))
        rows = _in_result(stored, rows, setup.groups, setup.targets, table.source)
    source = table.source or "Measurements"
    if not rows.count:
        raise MeasurementError(f"{source}: no row measures anything.")
    fitted = fitted_rows(result, result.nominal, table, known)
    if fitted.any():
        numbers = row_ranges(np.array(table.rows)[fitted].tolist())
        raise MeasurementError(
            f"{source}: the calibration was fitted to rows of this table, {numbers}, which cannot show that something "
            "has moved since. Give only rows that were measured afterwards."
        )
    known_units = result.rows.channels.select(result.rows.estimation).present
    if set(rows.channels.present) - set(known_units):
        raise MeasurementError(
            f"{source}: its rows measure {_measured(rows.channels.present)}; the calibration was fitted to "
            f"{_measured(known_units)} and cannot predict more. Check with rows that measure these alone, or leave "
            'columns out: --columns "rx=-".'
        )
    stated = {unit for unit, values in table.stated_sigma.items() if np.isfinite(values).all()}
    return stored.stops(rows, stated | set(cell.sigma), table.rows, table.images)


def _measured(units: Iterable[str]) -> str:
    """Say what is measured in these units, by their symbols."""
    words = {"m": "positions or lengths", "rad": "orientations", "px": "images"}
    return listed([words.get(unit, unit) for unit in units])


def read_fresh(
    result: Calibration,
    path: str | Path,
    columns: ColumnsInput = None,
    points: str | Path | None = None,
    points_unit: str | None = None,
) -> Measurements:
    """Read a table of fresh rows; those of the set ``validate`` count like those of ``estimate``.

    Args:
        result: The result that they are compared with, whose joints are its columns.
        path: The table.
        columns: Names and units of its columns, as by ``--columns``; None: as they are.
        points: A list of measured points; None: they are in the table.
        points_unit: Unit of that list; None: as it says.

    Raises:
        MeasurementError: The table cannot be read as one of this robot.
    """
    arm, table = result.nominal, Table.read(path)
    estimate, validate = SETS
    if "set" in table.header:
        k = table.header.index("set")
        changed = [
            [*row[:k], estimate, *row[k + 1 :]] if row[k] == validate else row
            for row in table.cells
        ]
        table = replace(table, cells=tuple(changed))
    return Measurements.read(
        table,
        arm.joint_names,
        arm.joint_types,
        columns,
        None,
        points,
        points_unit,
        needs_all_joints=not arm.branches,
    )


def _in_result(
    stored: StoredResult, rows: Rows, groups: tuple[str, ...], targets: tuple[str, ...], source: str
) -> Rows:
    """Number frames and targets of rows as the result does; `ModelError` if it lacks one."""
    setup, samples = stored.part.setup, rows.samples
    numbers = []
    for what, of_table, known, index in (
        ("stations", groups, setup.groups, samples.frame),
        ("targets", targets, setup.targets, samples.target),
    ):
        number = numbered_as(of_table, known, index)
        if number is None:
            lacking = [name for name in of_table if name not in known]
            raise ModelError(
                f"{source or 'Measurements'}: the result has the {what} {choices(known)}; the table's "
                f"{choices(lacking)} are not among them. Check with rows of these."
            )
        numbers.append(number)
    frame, target = numbers
    return replace(rows, samples=replace(samples, frame=frame, target=target))


def judged(
    stored: StoredResult,
    stops: tuple[Stop, ...],
    tolerance: float | None = None,
    test: EvidenceTest | None = None,
) -> CheckResult:
    """Weigh the causes by stops that were compared with a result.

    Args:
        stored: The result.
        stops: The fresh stops.
        tolerance: As of `check`.
        test: Of an earlier check at the same poses; None: its distribution is drawn.
    """
    result = stored.result
    stack = stacked(stops)
    moving = moving_causes(stored)
    causes, directions = causes_of(moving, stack)
    freedom = stored.freedom
    weights = logsumexp(log_weights(directions, stack.y[:, None], freedom)[:, :, 0], axis=1)
    evidence = float(logsumexp(weights))
    if test is None:
        test = EvidenceTest.of(directions, len(stack.y), freedom)
    p_value = test.p_value(evidence)
    probability = np.exp(weights - evidence)
    findings = [
        _finding(stored, stack, causes[k], directions[k], float(probability[k]))
        for k in np.argsort(-probability, kind="stable").tolist()
    ]

    outcome: Outcome = "nothing"
    if evidence > test.limit:
        best = findings[0]
        outcome = "undecided"
        if best.probability >= SURE:
            outcome = "moved" if best.code in MOVING else "row" if best.code == "row" else "other"
    return CheckResult(
        result=result,
        outcome=outcome,
        p_value=p_value,
        nothing=float(
            1.0 / (1.0 + np.exp(min(evidence - np.log(sum(d.prior for d in directions)), 700.0)))
        ),
        findings=tuple(findings),
        stops=len(stops),
        numbers=len(stack.y),
        ratio=float(np.sqrt(np.mean(stack.y**2))),
        expected=_expected(stored),
        tolerance=tolerance,
        stored=stored,
        stack=stack,
        causes=causes,
        directions=directions,
        test=test,
    )


def _expected(stored: StoredResult) -> float:
    """Return the expected error at poses like those measured, without that of the scale, which nothing moves [m]."""
    part = stored.part
    return float(np.sqrt(max(part.new_point[0] ** 2 - part.by_scale[0] ** 2, 0.0)))


def _finding(
    stored: StoredResult, stack: Stack, cause: Cause, directions: Directions, probability: float
) -> Finding:
    """Estimate the displacement of a cause, and its effect."""
    mean, covariance = estimate(directions, stack.y, stored.freedom)
    if cause.code not in MOVING:
        shift = mean.reshape(-1, 6)[:, :3]
        size = float(np.sqrt(np.mean(np.sum(shift**2, axis=1))))
        spread = np.trace(
            covariance.reshape(len(shift), 6, len(shift), 6)[:, :3, :, :3].trace(0, 0, 2)
        )
        std = float(np.sqrt(spread / len(shift)))
        return Finding(
            code=cause.code,
            name="",
            probability=probability,
            size=size,
            size_std=std,
            unit="m",
            turn=np.nan,
            change=np.nan,
            change_std=np.nan,
            rows=cause.rows,
            image=cause.image,
        )
    change, change_std = _effect(stored, cause, mean, covariance)
    if cause.code == "joint":
        return Finding(
            code=cause.code,
            name=cause.name,
            probability=probability,
            size=float(mean[0] * cause.scale[0]),
            size_std=float(np.sqrt(covariance[0, 0]) * cause.scale[0]),
            unit=cause.units[0],
            turn=np.nan,
            change=change,
            change_std=change_std,
        )
    turns = np.array([unit == "rad" for unit in cause.units])
    visible = np.linalg.norm(directions.V[:, turns], axis=0) > 1e-6 if turns.any() else np.zeros(0)
    turn = float(np.linalg.norm(mean[turns]) / LEVER) if np.any(visible) else np.nan
    return Finding(
        code=cause.code,
        name=cause.name,
        probability=probability,
        size=change,
        size_std=change_std,
        unit="m",
        turn=turn,
        change=change,
        change_std=change_std,
    )


def _effect(
    stored: StoredResult, cause: Cause, mean: Array, covariance: Array
) -> tuple[float, float]:
    """Return the change of the target's positions over the fitted joint values, rms, and its standard deviation [m]."""
    samples = _spread_samples(stored, cause)
    _, twists = stored.displaced.twists(
        np.zeros(len(stored.displaced.model)), samples, rotation=False
    )
    by_cause = twists @ cause.mixing
    change = np.sqrt(np.mean(np.sum((by_cause @ mean) ** 2, axis=1)))
    variance = np.mean(
        np.trace(by_cause @ covariance @ by_cause.transpose(0, 2, 1), axis1=1, axis2=2)
    )
    return float(change), float(np.sqrt(variance))


def _spread_samples(stored: StoredResult, cause: Cause) -> Samples:
    """Return joint values over the fitted ranges, of the frame and the target of a cause, or of the first ones."""
    result, setup = stored.result, stored.part.setup
    ranges = result.rows.ranges
    robot = result.robot
    q = spread_poses(robot)[:_POSES]
    if np.isfinite(ranges).all():
        q = spread_between(ranges, _POSES)
    frame = setup.groups.index(cause.name) if cause.code == "frame" and cause.name else 0
    target = setup.targets.index(cause.name) if cause.code == "target" and cause.name else 0
    count = len(q)
    of_frame, of_target = np.full(count, frame), np.full(count, target)
    chain = None
    if robot.branches:
        try:
            chain = setup.chains(robot, of_frame, of_target)
        except ModelError:  # the first target is not seen from there
            chain = np.zeros(count, dtype=np.int_)
    return Samples(q, of_frame, of_target, chain=chain)


def _noticed(test: EvidenceTest, stack: Stack, cause: Cause) -> Noticed:
    """Find the smallest shift alone, and turn with any shift, of a cause that are noticed in 95 of 100 checks."""
    found = {}
    for unit in ("m", "rad"):
        chosen = np.array([of == unit for of in cause.units])
        found[unit] = np.nan
        whole = stack.by_displacements @ cause.mixing
        derivative = whole[:, chosen]
        size = np.linalg.norm(derivative, axis=0)
        if not np.any(size > 1e-6):
            continue  # as the turn of a point
        if unit == "rad" and not chosen.all():
            # About whichever point: what no shift makes good.
            Q, _ = np.linalg.qr(whole[:, ~chosen])
            derivative = derivative - Q @ (Q.T @ derivative)
        U, singular, _ = np.linalg.svd(derivative, full_matrices=False)
        found[unit] = np.inf
        if len(singular) == int(chosen.sum()) and singular[-1] > 1e-6 * size.max():
            length = test.detected_length(U[:, -1])
            found[unit] = float(length / singular[-1] * (1.0 if unit == "m" else 1.0 / LEVER))
    return Noticed(cause.code, cause.name, found["m"], found["rad"])
