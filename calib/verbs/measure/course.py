"""The course of a session: all stops so far, and what follows from them.

A course is never changed: a stop that is added, taken back or skipped makes the next one. What a session keeps on disk
are the stops with what was said of them, from which `Course.restored` makes the same course again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2

import calib.data.kinds as registry
from calib.basics.arrays import Array, Mask
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.model.families import FAMILIES
from calib.model.parameter_sets import DIRECTIONS
from calib.numerics.moves import last_moves
from calib.robot.robot import Robot
from calib.verbs.measure.breaks import Break, cell_after, forgotten, relabelled
from calib.verbs.measure.design import Choice, Design, Known
from calib.verbs.measure.expectation import Expectation
from calib.verbs.measure.moved import find_moved
from calib.verbs.measure.row_check import (
    FAR_LENGTH,
    SAME_PLACE,
    History,
    RowCheck,
    check_row,
    conflicts,
    contradiction,
    is_same_again,
)
from calib.verbs.measure.running_fit import RunningFit
from calib.verbs.measure.stop import SAME_POSE, Answer, Finding, Row, Stop
from calib.verbs.plan.forecast import information

#: What is known of the noise beforehand, in degrees of freedom: if the cell states it, and if it is assumed.
_STATED = 300.0
_ASSUMED = 4.0

#: A stated noise that the rows contradict with this probability does not count.
_CONTRADICTED = 1e-3

#: Least standard deviation of errors of a family, over the typical one: few stops may show none.
_LEAST_ERRORS = 1.0 / 3.0

#: Degrees of freedom from which on the sizes of errors are those of the fit.
_ENOUGH_FREEDOM = 10.0

#: How often a stop is measured again before the session goes on without it.
_TRIES = 3

#: Stops from which on a fit tells where the target is about.
_TELLING = 8

#: Stops among which one that contradicts most others is wrong.
_FEWEST_JUDGES = 4

#: Stops that were found good before the aim is reached: without any a wrong reading would not have shown.
_CHECKED = 2

#: The most explanations that are found at a stop.
_AT_ONCE = 3

#: Fits to 8, 16, 32, ... stops are those from which the fits to more stops begin.
_FIRST_START = 8


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """Expected error after a stop [m]."""

    #: Number of the stop
    stop: int
    #: Number of stops that count by then
    stops: int
    error: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class FitStart(Value):
    """The fit to the first stops that count, from which fits to more of them begin."""

    #: Numbers of the stops
    numbers: tuple[int, ...]
    #: What had moved by then
    breaks: tuple[Break, ...]
    #: None: they do not determine frames and targets
    fit: RunningFit | None


@dataclass(frozen=True, eq=False)
class Course:
    """All stops of a session so far."""

    robot: Robot
    cell: Cell
    design: Design
    #: Error that shall hold [m]; None: as good as ``reference``
    error: float | None
    #: Shape (p, p), information of the random poses that the aim is as good as, with the noise as stated
    reference: Array
    #: All stops, in the order of their measurement
    stops: tuple[Stop, ...] = ()
    #: What has moved
    breaks: tuple[Break, ...] = ()
    #: The fit to the stops that count
    fit: RunningFit | None = None
    #: Candidates that were skipped
    skipped: tuple[int, ...] = ()
    #: Number of the stop that is not measured again, because it was skipped
    left: int = 0
    #: The design of the row before
    planned: tuple[int, ...] = ()
    #: Expected error after each number of stops
    curve: tuple[CurvePoint, ...] = ()
    #: Fits to the first stops
    starts: tuple[FitStart, ...] = ()
    #: The course before the last stop, not fitted; None: there is no stop
    before: Course | None = None

    # What counts

    @cached_property
    def counted(self) -> tuple[Stop, ...]:
        """The stops that count."""
        return tuple(stop for stop in self.stops if stop.counts)

    @cached_property
    def history(self) -> History:
        """The squares of the good stops."""
        good = [stop.answer for stop in self.counted if stop.answer.outcome == "good"]
        return History(
            sum(answer.square * answer.numbers for answer in good),
            float(sum(answer.numbers for answer in good)),
        )

    def tables(self) -> list[Measurements]:
        """Return the readings of the stops that count, with names as of what has moved, and with their moves."""
        return [self.table(stop) for stop in self.counted]

    def tables_to_calibrate(self) -> list[Measurements]:
        """Return the readings of the stops that count, without those that do not place their own station.

        Something may have moved again after a few stops; a session knows about where it stood before, and a calibration
        by the table does not. It holds out a pose at a time: the others have to place the station still.
        """
        tables = self.tables()
        if not self.breaks:
            return tables
        by_pose: dict[str, dict[bytes, int]] = {}
        for table in tables:
            numbers = sum(len(registry.get(kind).units) for kind in table.kinds)
            pose = np.round(table.joints[0] / SAME_POSE).tobytes()
            by_pose.setdefault(table.groups[0], {})[pose] = numbers
        placed = {
            group
            for group, numbers in by_pose.items()
            if sum(numbers.values()) - max(numbers.values()) > len(DIRECTIONS)
        }
        return [table for table in tables if table.groups[0] in placed]

    def table(self, stop: Stop) -> Measurements:
        """Return the readings of a stop with names as of what has moved, and with its moves."""
        table = relabelled(stop.row.readings, stop.number, self.breaks)
        return replace(table, moves=np.tile(self.moves[stop.number], (len(table), 1)))

    @cached_property
    def moves(self) -> dict[int, Array]:
        """The last move of each joint before each stop, by its number."""
        if not self.stops:
            return {}
        straight = last_moves(np.array([stop.row.joints for stop in self.stops]))
        return {
            stop.number: move if stop.row.moves is None else stop.row.moves
            for stop, move in zip(self.stops, straight, strict=True)
        }

    # What is known

    @cached_property
    def known(self) -> Known:
        """The information of the stops so far."""
        sensitivity = self.design.sensitivity
        noise, freedom = self._noise()
        total = np.zeros((len(sensitivity.names),) * 2)
        stops, start = self.counted, 0
        ends = [*self.breaks, None]
        for broken in ends:
            last = len(stops)
            if broken is not None:
                last = next((i for i, s in enumerate(stops) if s.number >= broken.stop), last)
            part = stops[start:last]
            if part:
                total = total + information(self._measured(part) / noise[:, None])
            if broken is not None:
                total = forgotten(total, sensitivity, broken)
            start = max(start, last)
        return Known(total, self._precision(), noise, freedom)

    def _measured(self, stops: Sequence[Stop]) -> Array:
        """Return the whitened derivatives of what was measured at some stops, (t, d, p), with the noise as stated."""
        sensitivity = self.design.sensitivity
        q = np.array([stop.row.joints for stop in stops])
        moves = np.array([self.moves[stop.number] for stop in stops])
        return sensitivity.measured(q, moves, self._seen(stops))

    def _seen(self, stops: Sequence[Stop]) -> Mask | None:
        """Return which views measured at some stops, (t, v); None with one view."""
        sensitivity = self.design.sensitivity
        if len(sensitivity.views) == 1:
            return None
        setup = sensitivity.setup
        seen = np.zeros((len(stops), len(sensitivity.views)), dtype=np.bool_)
        for i, stop in enumerate(stops):
            table = stop.row.readings
            there = set(zip(table.groups, table.targets, strict=True))
            for v, view in enumerate(sensitivity.views):
                names = {(setup.groups[view.frame], setup.targets[t]) for t in view.targets}
                seen[i, v] = bool(names & there)
        return seen

    def _noise(self) -> tuple[Array, float]:
        """Return the noise of the scalars at a stop over the stated one, (d,), and its degrees of freedom."""
        sensitivity = self.design.sensitivity
        cell = sensitivity.cell
        q = self.design.joints[:50]
        stated = sensitivity.sigma_by_unit(q)
        factors = {}
        estimate = None if self.fit is None else self.fit.fitted.estimate
        freedom = np.inf
        for unit, sigma in stated.items():
            is_stated = unit in cell.sigma or (unit == "m" and cell.tracker is not None)
            before = _STATED if is_stated else _ASSUMED
            ratio, own = 1.0, 0.0
            if estimate is not None and unit in estimate.sigma:
                # The freedom is that of all scalars.
                channels = estimate.problem.rows.channels
                share = channels.where(unit).sum() / max(channels.used.sum(), 1)
                own = max(estimate.freedom, 0.0) * float(share)
                ratio = (estimate.sigma[unit] / sigma) ** 2
            tail = chi2.cdf(own * ratio, own) if own > 0.0 else 0.5
            if own >= _ENOUGH_FREEDOM and min(tail, 1.0 - tail) < _CONTRADICTED:
                before = _ASSUMED if not is_stated else 0.0
            square = (own * ratio + before) / (own + before)
            factors[unit] = float(np.sqrt(square * self.history.factor))
            freedom = min(freedom, own + before)
        units = []
        for view in sensitivity.views:
            d = len(view.instrument.kind.units) * len(view.targets)
            units.append([*view.instrument.kind.units] * len(view.targets) if d else [])
        flat = [unit for of_view in units for unit in of_view]
        columns = self.design.measured.shape[1]
        if len(flat) != columns:  # of pictures a stop has as many numbers as tell of it
            flat = [next(iter(stated))] * columns
        assert set(flat) <= set(RESIDUAL_UNITS)
        return np.array([factors.get(unit, 1.0) for unit in flat]), freedom

    def _precision(self) -> Array:
        """Return 1 / variance of each parameter before the rows: sizes of errors as the fit found them, if it could."""
        sensitivity = self.design.sensitivity
        if self.fit is None or self.fit.fitted.estimate.freedom < _ENOUGH_FREEDOM:
            return sensitivity.precision
        if sensitivity.cell.priors.source != "data":
            return sensitivity.precision
        precision = np.array(sensitivity.precision)
        found = self.fit.fitted.estimate.prior_std
        for k, parameter in enumerate(sensitivity.kinematics.model.parameters):
            family = parameter.family
            if family in found and parameter.name not in sensitivity.cell.parameter_priors:
                least = _LEAST_ERRORS * FAMILIES[family].typical
                precision[k] = 1.0 / max(found[family], least) ** 2
        return precision

    @cached_property
    def expected(self) -> Expectation | None:
        """The expected error of a calibration by the stops that count; None: not known yet.

        That is before they have as many numbers as parameters can be determined, and while it is not known what has
        moved: then only priors hold the rest, and they are wide.
        """
        numbers = len(self.counted) * self.design.measured.shape[1]
        if self.fit is None or numbers < self.design.workspace.rank:
            return None
        if not all(broken.is_decided for broken in self.breaks):
            return None
        return self.design.expected(self.known.total, self.known.freedom)

    @cached_property
    def aim(self) -> float:
        """The error within which the calibration shall be [m]."""
        if self.error is not None:
            return self.error
        known = self.known
        scale = float(np.sqrt(np.mean(known.noise**2)))
        total = self.reference / scale**2 + np.diag(known.precision)
        return self.design.expected(total, known.freedom).high

    @property
    def reached(self) -> bool:
        """True if the expected error is within the aim, and stops check each other."""
        if self.expected is None or self.expected.high > self.aim:
            return False
        return sum(stop.answer.outcome == "good" for stop in self.counted) >= _CHECKED

    # What is next

    @property
    def repeated(self) -> Stop | None:
        """The stop that is to be measured again; None: there is none."""
        if not self.stops or self.stops[-1].answer.outcome != "again" or self.stops[-1].counts:
            return None
        last = self.stops[-1]
        if last.number == self.left:
            return None
        return last if len(self._tries(last.row.joints)) < _TRIES else None

    def _tries(self, joints: Array) -> list[Stop]:
        """Return the last stops, one after the other, that are of one pose and do not count."""
        tries: list[Stop] = []
        for stop in reversed(self.stops):
            if stop.counts or np.abs(stop.row.joints - joints).max() > SAME_POSE:
                break
            tries.append(stop)
        return tries

    @cached_property
    def choice(self) -> Choice | None:
        """The poses still to be measured, the next one first; None: no candidate is left."""
        last = self.stops[-1].row.joints if self.stops else None
        left_out = [*self.skipped]
        for stop in self.stops:
            same = np.abs(self.design.joints - stop.row.joints).max(axis=1) <= SAME_POSE
            if self.design.moves is not None:
                side = np.sign(self.moves[stop.number])
                same &= np.all(np.sign(self.design.moves) == side, axis=1)
            left_out += np.flatnonzero(same).tolist()
        return self.design.choose(self.known, self.aim, last, self.planned, left_out)

    # What follows

    def with_row(
        self, row: Row, proposed: Sequence[Array], planned: tuple[int, ...] | None = None
    ) -> tuple[Course, Answer]:
        """Add a stop, and say what it says.

        Args:
            row: What was measured.
            proposed: Poses that were proposed last, shape (m,) each.
            planned: The design by which the last one was proposed; None: by none.
        """
        number = len(self.stops) + 1
        before = None if self.expected is None else self.expected.high
        table = relabelled(row.readings, number, self.breaks)
        earlier = [
            (stop.number, relabelled(stop.row.readings, stop.number, self.breaks))
            for stop in self.stops
        ]
        rank = self.design.workspace.rank
        check = check_row(
            self.robot, self.fit, table, number, earlier, proposed, self.history, rank
        )
        far = check.prediction is not None and check.prediction.residual.get("m", 0.0) > FAR_LENGTH
        if check.is_off is None or (far and not check.is_off):
            counted = [(s.number, t) for s, t in zip(self.counted, self.tables(), strict=True)]
            place = self._place_of(table.targets[0])
            wrong = contradiction(self.robot, place, counted, table, number)
            if wrong is not None:
                check = replace(check, is_off=True, findings=(wrong,))
        accepted = not check.is_off
        together: list[int] = []
        if check.is_off:
            together = self._agreeing(row, table, check)
            accepted = bool(together) or self._shows_another(row, check)
        outcome = "again" if not accepted else "good" if check.is_off is False else "unknown"
        prediction = check.prediction
        shown = None if check.is_off is None else prediction
        answer = Answer(
            stop=number,
            outcome=outcome,  # type: ignore[arg-type]
            residual={} if shown is None else shown.residual,
            usual={} if shown is None else shown.usual,
            square=check.square,
            numbers=0 if prediction is None else len(prediction.y),
            findings=check.findings if not accepted else (),
            before=before,
            after=before,
        )
        stops = [
            replace(stop, counts=True) if stop.number in together else stop for stop in self.stops
        ]
        course = self.followed_by(Stop(number, row, answer, accepted), stops, planned)
        if accepted:
            course, found = course.refitted()._explained(
                given=(number, *together) if together else ()
            )
            expected = course.expected
            if not course.stops[-1].counts:
                outcome = "again"
            elif together and not found:  # that far off is what the model lacks
                outcome = "good"
            answer = replace(
                answer,
                outcome=outcome,  # type: ignore[arg-type]
                findings=(*answer.findings, *found),
                after=None if expected is None else expected.high,
            )
            course = course._with_answer(answer)
        return course._on_curve(), answer

    def _place_of(self, target: str) -> Array | None:
        """Return about where a target is in the tip, shape (4, 4) [m]: as stated, or as stops tell; None: unknown."""
        stated = self.design.sensitivity.setup
        if stated.target_given[0]:
            return np.asarray(stated.T_tip_target[0])
        if self.fit is None or self.fit.count < _TELLING:
            return None
        setup = self.fit.fitted.estimated_setup()
        if target not in setup.targets:
            return None
        return np.asarray(setup.T_tip_target[setup.targets.index(target)])

    def _without_contradicted(self) -> tuple[Course, tuple[Finding, ...]]:
        """Return the course without the stops that most others contradict, and the findings of that."""
        tables = self.tables()
        if len(tables) < _FEWEST_JUDGES:
            return self, ()
        place = self._place_of(tables[0].targets[0])
        share = conflicts(self.robot, place, tables).sum(axis=1)
        wrong = np.flatnonzero(share > 0.5 * (len(tables) - 1)).tolist()
        numbers = [self.counted[k].number for k in wrong]
        if not numbers or 2 * len(numbers) >= len(tables):
            return self, ()
        stops = tuple(replace(s, counts=s.counts and s.number not in numbers) for s in self.stops)
        return replace(self, stops=stops), tuple(Finding("gross", (n,)) for n in numbers)

    def _shows_another(self, row: Row, check: RowCheck) -> bool:
        """Return whether a stop that is off shows that an earlier one is: without that one, it is as expected."""
        if self.fit is None or any(f.code != "gross" for f in check.findings):
            return False
        stop = Stop(len(self.stops) + 1, row, Answer(len(self.stops) + 1, "unknown"), counts=True)
        trial = self.followed_by(stop, self.stops, None).refitted()
        if trial.fit is None:
            return False
        found = find_moved(trial.fit, self.history.factor, len(trial.counted))
        last = len(trial.counted) - 1
        return len(found) == 1 and found[0].what == "stop" and found[0].first != last

    def _agreeing(self, row: Row, table: Measurements, check: RowCheck) -> list[int]:
        """Return the numbers of the stops before that one which is off too agrees with: then both count."""
        tries = self._tries(row.joints)
        if check.prediction is None and not any(f.code == "repeated" for f in check.findings):
            # Without a fit readings agree that are a few times the noise apart.
            pairs = [(s, s.row.readings) for s in tries if len(s.row.readings) == len(table)]
            return [
                s.number for s, t in pairs if np.abs(t.points - table.points).max() < SAME_PLACE
            ]
        if not tries or self.fit is None or check.prediction is None:
            return []
        # The mistake may have been made twice; that a joint is elsewhere is believed once more.
        believed = {"repeated": _TRIES, "swapped": _TRIES, "not_there": _TRIES - 1}
        if any(len(tries) < believed.get(finding.code, 1) for finding in check.findings):
            return []
        agreeing = []
        for stop in tries:
            other = relabelled(stop.row.readings, stop.number, self.breaks)
            same, _ = is_same_again(self.fit, other, table, self.history)
            if same:
                agreeing.append(stop.number)
        return agreeing

    @property
    def cell_now(self) -> Cell:
        """The cell with what has moved as further targets and stations."""
        return self._cell_of(self.tables_to_calibrate())

    def _cell_of(self, tables: Sequence[Measurements]) -> Cell:
        """Return the cell with what has moved, as far as it occurs in some readings."""
        occurring = {name for table in tables for name in (*table.targets, *table.groups)}
        rotation = self.design.sensitivity.setup.rotation
        cell = cell_after(self.cell, self.breaks, occurring, rotation=rotation)
        # A target that was not measured yet is none of the fit.
        seen = {name: place for name, place in cell.targets.items() if name in occurring}
        return replace(cell, targets=seen) if seen else cell

    def refitted(self) -> Course:
        """Return the course with the fit to the stops that count.

        It begins where that to the first 8, 16, 32, ... stops ended: so it depends on the stops alone, whatever was
        fitted before.
        """
        starts = self.starts
        fit: RunningFit | None = None
        count = len(self.counted)
        sizes = [_FIRST_START * 2**k for k in range(count.bit_length())]
        for size in [*(size for size in sizes if size < count), count]:
            numbers = tuple(stop.number for stop in self.counted[:size])
            breaks = tuple(
                broken for broken in self.breaks if broken.stop <= max(numbers, default=0)
            )
            same = [s for s in starts if s.numbers == numbers and s.breaks == breaks]
            if same:
                fit = same[0].fit
                continue
            tables = self.tables()[:size]
            fit = RunningFit.of(self.robot, self._cell_of(tables), tables, fit)
            if size in sizes:
                starts = (*starts, FitStart(numbers, breaks, fit))
        return replace(self, fit=fit, starts=starts)

    def _explained(self, given: Sequence[int] = ()) -> tuple[Course, tuple[Finding, ...]]:
        """Return the course with what has moved and without stops that are far off by now, and the findings of that.

        Stops that were ``given`` twice, with the same reading, are not taken for gross ones.
        """
        course, findings = self, list[Finding]()
        for _ in range(_AT_ONCE):
            course, found = course._one_explained(given)
            if found is None:
                break
            findings.append(found)
        return course, tuple(findings)

    def _one_explained(self, given: Sequence[int]) -> tuple[Course, Finding | None]:
        """Return the course with the best explanation of its residuals, and what that is; None if there is nothing."""
        if self.fit is None:
            return self, None
        open_ = bool(self.breaks) and not self.breaks[-1].is_decided
        course = self
        if open_:
            course = replace(self, breaks=self.breaks[:-1]).refitted()
        same = replace(self, starts=course.starts)
        if course.fit is None:
            return same, None
        numbers = [stop.number for stop in self.counted]
        # Before frames, targets and robot were determined nothing that moved could be told from them.
        first = -(-self.design.workspace.rank // self.design.measured.shape[1])
        if course.breaks:
            first = max(first, 1 + sum(number <= course.breaks[-1].stop for number in numbers))
        found = find_moved(course.fit, self.history.factor, first)
        alone = [m for m in found if m.what == "stop" and numbers[m.first] not in given]
        moved = [m for m in found if m.what != "stop"]
        if alone and found[0] in alone:
            if len(alone) > 1 or (moved and moved[0].first < len(numbers) - 1):
                return same, None  # later stops will tell
            number = numbers[alone[0].first]
            stops = tuple(
                replace(stop, counts=stop.counts and stop.number != number) for stop in self.stops
            )
            gain = {"gain": alone[0].gain}
            return replace(same, stops=stops).refitted(), Finding("gross", (number,), gain)
        if not moved:
            return same, None
        setup = course.fit.fitted.estimated_setup()
        broken = Break.of(moved, numbers, setup, course.breaks)
        if open_ and broken.same_as(self.breaks[-1]):
            return same, None
        course = replace(course, breaks=(*course.breaks, broken)).refitted()
        since = tuple(stop.number for stop in course.counted if stop.number >= broken.stop)
        name = broken.target if broken.target is not None else broken.station
        gain = {"gain": moved[0].gain}
        return course, Finding(broken.code, since, gain, name or "")

    def _with_answer(self, answer: Answer) -> Course:
        """Return the course with the last stop's answer replaced."""
        return replace(self, stops=(*self.stops[:-1], replace(self.stops[-1], answer=answer)))

    def _on_curve(self) -> Course:
        """Return the course with the expected error after its last stop."""
        expected = self.expected
        if expected is None:
            return self
        last = self.stops[-1].number
        point = CurvePoint(last, len(self.counted), expected.error, expected.low, expected.high)
        return replace(self, curve=(*self.curve, point))

    def followed_by(
        self, stop: Stop, stops: Sequence[Stop], planned: tuple[int, ...] | None
    ) -> Course:
        """Return the course with one more stop, not fitted.

        Args:
            stop: The stop.
            stops: Those before it, as they count by now.
            planned: The design by which it was proposed; None: by none.
        """
        return replace(
            self,
            stops=(*stops, stop),
            planned=self.planned if planned is None else planned,
            before=replace(self, fit=None),
        )

    def without_last(self) -> Course:
        """Return the course as it was before its last stop, but for what was skipped; it is not fitted yet."""
        assert self.before is not None
        return replace(self.before, skipped=self.skipped)

    def with_skipped(self, joints: Array, planned: tuple[int, ...] | None) -> Course:
        """Return the course without a pose that cannot be reached, from neither side; nor is it measured again.

        Args:
            joints: Its joint values, shape (m,) [rad] or [m].
            planned: The design by which it was proposed; None: by none.
        """
        same = np.abs(self.design.joints - joints).max(axis=1) <= SAME_POSE
        return replace(
            self,
            skipped=(*self.skipped, *np.flatnonzero(same).tolist()),
            left=0 if self.repeated is None else self.repeated.number,
            planned=self.planned if planned is None else planned,
        )

    @property
    def outliers(self) -> tuple[int, ...]:
        """Numbers of the stops that the fit finds far off by now, though they were accepted."""
        if self.fit is None:
            return ()
        flagged = self.fit.fitted.estimate.outliers
        stops = np.unique(self.fit.stops[flagged])
        numbers = [stop.number for stop in self.counted]
        return tuple(numbers[k] for k in stops.tolist())
