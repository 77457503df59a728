"""Session: a calibration that is being measured, one stop after the other.

It proposes the pose that tells most, says of each stop at once whether it is good, and when it is enough. Everything is
in its folder: an append-only journal, from which `Session.open` goes on wherever it ended, and the table of the stops
that count.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from calib.basics.arguments import (
    check_callable,
    check_flags,
    check_path,
    check_type,
    check_whole,
    wrong_type,
)
from calib.basics.arrays import Array, read_only
from calib.basics.dates import date_text, now
from calib.basics.files import write_atomically
from calib.basics.jobs import Progress, one_blas_thread
from calib.basics.json_files import plain
from calib.data.cell import Cell
from calib.data.inputs import CellInput, RobotInput, cell_of, robot_of
from calib.data.measurements import Measurements
from calib.errors import FileError, MeasurementError, ModelError
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.measure.aim import Aim
from calib.verbs.measure.breaks import Break
from calib.verbs.measure.course import Course, CurvePoint
from calib.verbs.measure.design import Design
from calib.verbs.measure.headers import column_fault, headers_of, quoted
from calib.verbs.measure.journal import Journal
from calib.verbs.measure.settings import (
    CELL,
    JOURNAL,
    PICTURES,
    TABLE,
    Settings,
    cell_of_robot,
    robot_file,
)
from calib.verbs.measure.state import NextPose, State, state_of
from calib.verbs.measure.stop import Answer, Finding, Row, Stop
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.collision import CollisionCheck
from calib.verbs.plan.forecast import information
from calib.verbs.plan.pose_candidates import rounded
from calib.verbs.plan.reachable import check_placed, reachable
from calib.verbs.plan.sensitivity import Sensitivity

#: Candidates of a session; of pictures as many as a plan has.
_CANDIDATES = 6000

#: Draws of random poses, whose median the aim is as good as.
_DRAWS = 9

_USUAL_AIM = Aim()

#: Begins the cell file.
_CELL_HEAD = """\
# The cell that measurements.csv belongs to, with what has moved. calib measure writes it anew at each stop.

"""


@dataclass(frozen=True, slots=True, eq=False)
class _Added:
    """A row that the journal has."""

    row: Row
    key: str
    #: Poses that were proposed, shape (m,) each
    proposed: list[Array]
    #: The design by which they were; None: by none
    planned: tuple[int, ...] | None


class Session:
    """A calibration that is being measured.

    For example:

        cell = calib.Cell(base="base", tip="tool0", estimate_frame=True)
        session = calib.Session.start("session", "ur3", cell, calib.Aim(error=1e-4))
        while not session.state.reached:
            print(session.next().joints)  # drive there, [rad]
            x, y, z = map(float, input("x y z [mm]: ").split())
            print(session.add({"x [mm]": x, "y [mm]": y, "z [mm]": z}).summary())
        result = session.calibrate()
    """

    def __init__(self, folder: Path, settings: Settings, journal: Journal, course: Course) -> None:
        """Make a session; use `start` or `open`."""
        self.folder = folder
        self._settings = settings
        self._journal = journal
        self._course = course
        #: Why the table lacks the last stops, such as a full disk; empty: it does not
        self.behind = ""
        self._proposed: NextPose | None = None
        self._answers: dict[str, Answer] = {}
        # The threads of a server add one after the other.
        self._lock = threading.RLock()

    @classmethod
    @one_blas_thread()
    def start(
        cls,
        folder: str | Path,
        robot: RobotInput,
        cell: CellInput = None,
        aim: Aim = _USUAL_AIM,
        *,
        collisions: bool = True,
        start: Sequence[float] = (),
        seed: int = 0,
        progress: Progress | None = None,
    ) -> Session:
        """Start a session in a folder.

        Args:
            folder: The folder; it is made if it does not exist, and has no session yet.
            robot: The nominal robot; or the path of its URDF, xacro, MJCF or DH rows, or a name such as ``"ur3"``, with
                the cell's links.
            cell: What is known of instrument, targets, frames and surroundings, as for `calib.plan`; or the path of a
                cell file; None: the default cell. The model ``"auto"`` is measured for as ``"placement"``.
            aim: How accurate the robot is to be, and where.
            collisions: Whether poses and ways are checked for collisions.
            start: Joint values before the first pose, shape (m,), [rad] or [m]; (): any pose may be the first.
            seed: Of the candidates: the same seed proposes the same poses.
            progress: Called with the number of candidates so far, and that wanted; None: nothing is called.

        Returns:
            The session, without stops.

        Raises:
            ArgumentError: An argument of another type.
            CalibError: A cell that cannot be planned for, or no pose that can be measured.
            FileError: The folder has a session, or cannot be written.
        """
        check_path("folder", folder)
        if (Path(folder) / JOURNAL).exists():
            raise FileError(
                f"'{folder}' has a session already. Go on with it, calib.Session.open('{folder}'), or choose another "
                "folder."
            )
        check_type("aim", aim, Aim, "an Aim")
        check_flags(collisions=collisions)
        check_whole("seed", seed, 0)
        check_callable("progress", progress)
        place = Path(folder)
        known = cell_of(cell)
        arm = robot_of(robot, known)
        known = cell_of_robot(known, arm)
        at = (
            tuple(arm.columns(np.asarray(start, dtype=np.float64), "start")[0])
            if len(start)
            else ()
        )
        settings = Settings(arm, known, aim, seed, collisions, at, _name_of(robot))
        course = _course_of(settings, progress)
        try:
            place.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileError(f"'{place}' cannot be made: {error.strerror}.") from error
        if (place / TABLE).exists():
            raise FileError(f"'{place / TABLE}' exists: choose another folder for the session.")
        journal = Journal.create(place / JOURNAL)
        try:
            settings.write(place)
        except BaseException:
            journal.close()
            (place / JOURNAL).unlink(missing_ok=True)
            raise
        return cls(place, settings, journal, course)

    @classmethod
    @one_blas_thread()
    def open(cls, folder: str | Path, *, progress: Progress | None = None) -> Session:
        """Go on with the session of a folder.

        Args:
            folder: The folder.
            progress: As of `start`.

        Returns:
            The session with all stops that were added.

        Raises:
            FileError: The folder has no session, another process has it open, or a file is damaged.
        """
        check_path("folder", folder)
        place = Path(folder)
        journal = Journal.open(place / JOURNAL)
        try:
            settings = Settings.read(place)
            session = cls(place, settings, journal, _course_of(settings, progress))
            session._replay()
        except BaseException:
            journal.close()
            raise
        return session

    def __repr__(self) -> str:
        """Return one line: the folder, the robot, and how many stops there are."""
        robot = self.robot
        return (
            f"Session('{self.folder}', '{robot.name}', {robot.base} to {robot.tip}, "
            f"{len(self._course.counted)} stops)"
        )

    def __enter__(self) -> Session:
        """Return the session."""
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        """Close the session."""
        self.close()

    def close(self) -> None:
        """Give the folder free for another process; the session is over here."""
        self._journal.close()

    @property
    def robot(self) -> Robot:
        """The nominal robot."""
        return self._settings.robot

    @property
    def cell(self) -> Cell:
        """The cell, with what has moved as further targets and stations: `measurements` belong to it."""
        return self._course.cell_now

    @property
    def aim(self) -> Aim:
        """The accuracy that the robot is to have, and the region for it."""
        return self._settings.aim

    @property
    def robot_file(self) -> str:
        """The robot as `calib.calibrate` takes it: the path or the name it was started with, or the folder's copy."""
        return robot_file(self._settings, self.folder)

    @property
    def torn(self) -> str:
        """The unfinished end of the journal that a killed program left, and that was dropped; mostly empty."""
        return self._journal.torn

    @property
    def stops(self) -> tuple[Stop, ...]:
        """All stops, also those that do not count."""
        return self._course.stops

    @property
    def events(self) -> tuple[Mapping[str, Any], ...]:
        """All that happened, as the journal has it: rows, answers, undo, notes."""
        return self._journal.events

    @property
    def sights(self) -> tuple[tuple[str, str], ...]:
        """Station and target of each reading at a pose."""
        return self._course.design.sensitivity.sights

    @property
    def origin(self) -> str:
        """The origin of places, in words: the instrument, or the frame that the cell states."""
        known = "the origin of the measurement frame"
        return "the instrument" if self._settings.cell.estimate_frame else known

    @property
    def state(self) -> State:
        """The state of knowledge after the stops so far."""
        with self._lock, one_blas_thread():
            return state_of(self._course)

    @property
    def measurements(self) -> Measurements:
        """The stops that count, as a table; `cell` belongs to it.

        Raises:
            MeasurementError: There is none yet.
        """
        tables = self._course.tables_to_calibrate()
        if not tables:
            raise MeasurementError(
                "The session has no stop that counts yet: measure the next pose."
            )
        return Measurements.joined(tables)

    def next(self) -> NextPose | None:
        """Return the pose to measure next; None if no candidate is left.

        It is the same until a row is added, taken back or skipped.
        """
        with self._lock, one_blas_thread():
            if self._proposed is None:
                self._proposed = self._propose()
            return self._proposed

    def expected(self, joints: Array) -> Array:
        """Predict where each target is in the measurement frame, by what is known so far.

        Args:
            joints: Joint values, shape (m,), [rad] or [m].

        Returns:
            Shape (k, 3), in the order of `sights` [m]; before the frame is known, as the cell states it.
        """
        course = self._course
        if course.fit is None or course.fit.rows.samples.internals is not None or course.breaks:
            return np.asarray(course.design.sensitivity.expected(joints[None])[0])
        return course.fit.places(joints)

    def add(self, row: Row | Mapping[str, Any], *, key: str = "") -> Answer:
        """Add what was measured at a stop, and say what it says.

        Args:
            row: Joint values and readings. Or columns by their headers, as a table has them,
                ``{"x [mm]": 812.3, "y [mm]": ..., "joint_1 [deg]": ...}``, lists of several targets or corners: without
                joint values it was measured at the pose of `next`.
            key: Names this row: one that was added already is not added again, and its answer is returned.

        Returns:
            Whether it counts, how far it is from what was expected, what may be wrong, and the expected error.

        Raises:
            ArgumentError: Neither a Row nor columns by their headers.
            MeasurementError: Readings that do not fit the cell, or of several poses.
            FileError: It cannot be kept; nothing was added.
        """
        with self._lock, one_blas_thread():
            if key and key in self._answers:
                return self._answers[key]
            proposed = self.next()
            stop = self._row_of(row, proposed)
            event = plain(
                {
                    "event": "row",
                    "time": date_text(now()),
                    "key": key,
                    "columns": stop.readings.columns(),
                    "moves": stop.moves,
                    "proposed": None if proposed is None else proposed.joints,
                    "planned": self._planned,
                }
            )
            # As it is read again, to the last bit.
            added = self._row_event(event)
            # First what follows from it: a row that cannot be judged is not kept.
            judged = self._judged(added)
            self._journal.append(event)
            return self._added(added, judged)

    def undo(self, note: str = "") -> int | None:
        """Take the last stop back.

        Args:
            note: Why.

        Returns:
            Its number, which the next stop has again; None if there is none.
        """
        with self._lock, one_blas_thread():
            if not self._course.stops:
                return None
            number = self._course.stops[-1].number
            self._journal.append(
                {"event": "undo", "time": date_text(now()), "stop": number, "note": note}
            )
            self._course = self._course.without_last().refitted()
            self._forget(number)
            self._proposed = None
            self._write_table()
            return number

    def skip(self, note: str = "") -> None:
        """Leave out the proposed pose, which cannot be reached: another is proposed.

        Args:
            note: Why.
        """
        with self._lock, one_blas_thread():
            pose = self.next()
            if pose is None:
                return
            event = {
                "event": "skip",
                "time": date_text(now()),
                "joints": pose.joints,
                "planned": self._planned,
                "note": note,
            }
            self._journal.append(event)
            self._course = self._course.with_skipped(pose.joints, self._planned)
            self._proposed = None

    def note(self, text: str) -> None:
        """Write a note into the journal."""
        self._journal.append({"event": "note", "time": date_text(now()), "note": text})

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes, also those of stops that were taken back or skipped."""
        return tuple(str(event["note"]) for event in self._journal.events if event.get("note"))

    def calibrate(self, progress: Progress | None = None) -> Calibration:
        """Calibrate the robot by the stops that count, as `calib.calibrate` does.

        Args:
            progress: As of `calib.calibrate`.

        Returns:
            The calibration, with its verdict.

        Raises:
            CalibError: As of `calib.calibrate`.
        """
        return calibrate(self.robot, self.measurements, cell=self.cell, progress=progress)

    # Inside

    @property
    def _planned(self) -> tuple[int, ...] | None:
        """The design by which the next pose was proposed; None: none was, or it repeats a stop."""
        if self._proposed is None or self._proposed.why != "information":
            return None
        choice = self._course.choice
        return None if choice is None else choice.design

    def _propose(self) -> NextPose | None:
        """Return the next pose."""
        course = self._course
        sensitivity = course.design.sensitivity
        last = course.stops[-1].row.joints if course.stops else None
        if last is None and self._settings.start:
            last = np.array(self._settings.start)
        again = course.repeated
        if again is not None:
            q, via, why, error = again.row.joints, _via(again.row), "again", None
            number: int | None = again.number
        else:
            choice = course.choice
            if choice is None:
                return None
            candidate = choice.design[0]
            moves = course.design.moves
            q = course.design.joints[candidate]
            via = None if moves is None else rounded(self.robot, q - moves[candidate])
            why, number = "information", None
            error = None if course.expected is None else choice.after_next.high
        return NextPose(
            joints=q,
            via=via,
            expected=self.expected(q),
            targets=tuple(target for _, target in sensitivity.sights),
            error=error,
            why=why,  # type: ignore[arg-type]
            stop=number,
            travel=0.0 if last is None else float(np.abs(q - last).max()),
        )

    def _row_of(self, row: Row | Mapping[str, Any], pose: NextPose | None) -> Row:
        """Return a row as the session keeps it: columns in the robot's order, the proposed pose if none is given."""
        names = self.robot.joint_names
        moves = None
        headers = tuple(headers_of(self._settings.cell.kind or "point", "mm"))
        if isinstance(row, Row):
            readings, moves = row.readings, row.moves
            columns: Mapping[str, Any] = readings.columns()
            if len(readings.joint_names) == 0 or readings.joint_names != names:
                columns = {**_joint_columns(self.robot, row.joints, len(readings)), **columns}
        elif not isinstance(row, Mapping) or not all(isinstance(name, str) for name in row):
            named = f"the columns {quoted(headers)}" if headers else "columns of corners"
            raise wrong_type("row", row, f"a mapping from {named} to numbers, or a Row")
        else:
            columns = {
                name: value if isinstance(value, (list, tuple)) else [value]
                for name, value in row.items()
            }
            count = max((len(value) for value in columns.values()), default=0)
            has_joints = any(name.split(" [")[0] in names for name in columns)
            if not has_joints:
                if pose is None:
                    raise MeasurementError(
                        "No pose was proposed: give the joint values of the row."
                    )
                columns = {**_joint_columns(self.robot, pose.joints, count), **columns}
        columns = {name: values for name, values in columns.items() if name not in ("row", "set")}
        try:
            table = self._table_of(columns)
        except MeasurementError as error:
            fault = None
            if headers and not isinstance(row, Row):
                joints = [*_joint_columns(self.robot, np.zeros(len(names)), 1)]
                fault = column_fault(row, headers, joints, self.origin)
            if fault is None:
                raise
            raise MeasurementError(fault) from error
        if table.images and any(table.images):
            number = len(self._course.stops) + 1
            table = replace(table, images=tuple(f"{number:03d} {image}" for image in table.images))
        self._check_names(table)
        q = table.joints[0]
        if moves is None and pose is not None and pose.via is not None:
            # Elsewhere it is not known where the robot came from.
            is_there = np.all(np.abs(q - pose.joints) < np.abs(pose.joints - pose.via))
            moves = q - pose.via if is_there else None
        return Row(q, table, moves)

    def _table_of(self, columns: Mapping[str, Any]) -> Measurements:
        """Return the readings of a stop by their columns, with joint values in the order of the robot's."""
        names = self.robot.joint_names
        table = Measurements.of(
            columns,
            names,
            self.robot.joint_types,
            kind=None if "kind" in columns else self._settings.cell.kind,
            needs_all_joints=not self.robot.branches,
        )
        q = table.joints_for(names)[0]
        joints = np.tile(q, (len(table), 1))
        return replace(table, joint_names=names, joints=joints, moves=None, source="", sha256="")

    def _check_names(self, table: Measurements) -> None:
        """Refuse readings that the cell does not let expect: of another target, station or kind."""
        sensitivity = self._course.design.sensitivity
        setup = sensitivity.setup
        kinds = {view.instrument.kind.name for view in sensitivity.views}
        if set(table.kinds) - kinds:
            raise MeasurementError(
                f"The reading is of the kind '{table.kinds[0]}', and the session measures '{min(kinds)}': give the "
                "columns of that."
            )
        if len(setup.targets) > 1 and set(table.targets) - set(setup.targets):
            name = min(set(table.targets) - set(setup.targets))
            raise MeasurementError(
                f"The reading is of the target '{name}'; those of the cell are {', '.join(setup.targets)}."
            )

    def _judged(self, added: _Added) -> tuple[Course, Answer]:
        """Return the course with a row, and the answer to it."""
        return self._course.with_row(added.row, added.proposed, added.planned)

    def _added(self, added: _Added, judged: tuple[Course, Answer]) -> Answer:
        """Add a row that the journal has, and keep what is said of it."""
        course, answer = judged
        self._course = course
        self._proposed = None
        if added.key:
            self._answers[added.key] = answer
        # Without it, on a full disk, the row is judged again when the session is opened.
        with contextlib.suppress(FileError):
            self._journal.append(_answer_event(course, answer))
        self._write_table()
        return answer

    def _write_table(self) -> None:
        """Write the table of the stops that count and its cell file, if it can be: the journal has all in any case."""
        tables = self._course.tables_to_calibrate()
        try:
            if not tables:
                (self.folder / TABLE).unlink(missing_ok=True)
            else:
                Measurements.joined(tables).write(self.folder / TABLE, overwrite=True)
                sliding = [j.name for j in self.robot.urdf.joints if j.type == "prismatic"]
                text = _CELL_HEAD + self.cell.to_toml(sliding)
                write_atomically(self.folder / CELL, text.encode(), overwrite=True)
        except (FileError, OSError) as error:
            self.behind = str(error)
        else:
            self.behind = ""

    def _row_event(self, event: Mapping[str, Any]) -> _Added:
        """Return the row of an event of the journal."""
        table = self._table_of(event["columns"])
        moves = None if event["moves"] is None else np.array(event["moves"])
        proposed = [] if event["proposed"] is None else [np.array(event["proposed"])]
        row = Row(table.joints[0], table, moves)
        return _Added(row, str(event["key"]), proposed, _design_of(event))

    def _replay(self) -> None:
        """Make the course of the journal: answers that it has are taken, rows without one are judged."""
        pending: _Added | None = None
        events = self._journal.events
        for event in events:
            kind = event["event"]
            if kind == "answer" and pending is not None:
                self._course, answer = _answered(self._course, pending, event)
                if pending.key:
                    self._answers[pending.key] = answer
                pending = None
                continue
            if kind in ("row", "undo", "skip") and pending is not None:
                self._course, answer = self._course.refitted().with_row(
                    pending.row, pending.proposed, pending.planned
                )
                if pending.key:
                    self._answers[pending.key] = answer
                pending = None
            if kind == "row":
                pending = self._row_event(event)
            elif kind == "undo":
                self._course = self._course.without_last()
                self._forget(event["stop"])
            elif kind == "skip":
                self._course = self._course.with_skipped(
                    np.array(event["joints"]), _design_of(event)
                )
        self._course = self._course.refitted()
        if pending is not None:
            self._added(pending, self._judged(pending))
        else:
            self._write_table()

    def _forget(self, number: int) -> None:
        """Forget the answer to a stop that was taken back: its key may be added again."""
        self._answers = {key: each for key, each in self._answers.items() if each.stop != number}

    @property
    def pictures(self) -> Path:
        """Folder in which pictures of the session are kept."""
        return self.folder / PICTURES


def _name_of(robot: RobotInput) -> str:
    """Return how a robot was named: an absolute path, or a name; empty if it was given in memory."""
    if isinstance(robot, Robot):
        path = robot.urdf.path
        return "" if path is None else str(path.resolve())
    path = Path(robot)
    return str(path.resolve()) if path.is_file() else str(robot)


def _course_of(settings: Settings, progress: Progress | None) -> Course:
    """Draw the candidates of a session, and return its course without stops."""
    robot, cell = settings.robot, settings.cell
    check_placed(cell)
    sensitivity = Sensitivity.of(robot, cell)
    is_image = bool(sensitivity.instrument.VIEWPOINT_NUMBERS)
    depends = sensitivity.kinematics.model.depends_on_moves
    request = PlanRequest(
        candidates=None if is_image else _CANDIDATES,
        seed=settings.seed,
        approach="both" if depends else "straight",
    ).complete(sensitivity.instrument)
    check = CollisionCheck() if settings.collisions else None
    ground = reachable(sensitivity, request, settings.aim.region, check, progress)
    design = Design.of(sensitivity, ground)
    return Course(
        robot=robot,
        cell=cell,
        design=design,
        error=settings.aim.error,
        reference=_reference(design, settings.aim.poses, settings.seed),
    )


def _reference(design: Design, count: int, seed: int) -> Array:
    """Return the information of random candidates, the median of several draws by their expected error, (p, p)."""
    rng = np.random.default_rng([seed, 2])
    pool, sensitivity = design.ground.pool, design.sensitivity
    if len(pool.q) < count:
        raise ModelError(
            f"The aim is that of {count} poses at random, and there are {len(pool.q)} that can be measured: give fewer."
        )
    draws = []
    prior = np.diag(sensitivity.precision)
    for _ in range(_DRAWS):
        chosen = rng.choice(len(pool.q), count, replace=False)
        seen = None if pool.seen is None else pool.seen[chosen]
        total = information(sensitivity.measured(pool.q[chosen], None, seen))
        draws.append((design.expected(total + prior, np.inf).error, total))
    draws.sort(key=lambda draw: draw[0])
    return draws[_DRAWS // 2][1]


def _joint_columns(robot: Robot, q: Array, count: int) -> dict[str, list[float]]:
    """Return joint values (m,) [rad] or [m] as columns of a table of so many rows, in degrees and millimetres."""
    columns = {}
    for name, value in zip(robot.joint_names, q.tolist(), strict=True):
        if robot.joint_types[name] == "prismatic":
            columns[f"{name} [m]"] = [value] * count
        else:
            columns[f"{name} [rad]"] = [value] * count
    return columns


def _via(row: Row) -> Array | None:
    """Return where the robot drove by before a stop, if it did."""
    return None if row.moves is None else np.asarray(row.joints - row.moves)


def _answer_event(course: Course, answer: Answer) -> dict[str, Any]:
    """Return the event with what was said of the last stop, and what follows from it for the others."""
    # None while no error is expected, as when it is not known what has moved.
    point = next((each for each in course.curve[-1:] if each.stop == answer.stop), None)
    return {
        "event": "answer",
        "time": date_text(now()),
        "stop": answer.stop,
        "outcome": answer.outcome,
        "residual": answer.residual,
        "usual": answer.usual,
        "square": answer.square,
        "numbers": answer.numbers,
        "findings": [
            {"code": f.code, "stops": f.stops, "values": f.values, "name": f.name}
            for f in answer.findings
        ],
        "before_m": answer.before,
        "after_m": answer.after,
        "counted": [stop.number for stop in course.counted],
        "breaks": [
            [b.stop, b.target, b.station, b.T_tip_target, b.T_frame_base] for b in course.breaks
        ],
        "curve_m": None
        if point is None
        else [point.stop, point.stops, point.error, point.low, point.high],
    }


def _design_of(event: Mapping[str, Any]) -> tuple[int, ...] | None:
    """Return the design by which a pose was proposed, as an event of the journal has it; None: by none."""
    return None if event["planned"] is None else tuple(event["planned"])


def _answered(course: Course, added: _Added, event: Mapping[str, Any]) -> tuple[Course, Answer]:
    """Return the course with a row and the answer that the journal has of it, not fitted; and the answer."""
    answer = Answer(
        stop=event["stop"],
        outcome=event["outcome"],
        residual=event["residual"],
        usual=event["usual"],
        square=np.nan if event["square"] is None else event["square"],
        numbers=event["numbers"],
        findings=tuple(
            Finding(f["code"], tuple(f["stops"]), f["values"], f["name"]) for f in event["findings"]
        ),
        before=event["before_m"],
        after=event["after_m"],
    )
    counted = set(event["counted"])
    stops = [replace(stop, counts=stop.number in counted) for stop in course.stops]
    stop = Stop(answer.stop, added.row, answer, answer.stop in counted)
    curve = course.curve
    if event["curve_m"] is not None:
        curve = (*curve, CurvePoint(*event["curve_m"]))
    return replace(
        course.followed_by(stop, stops, added.planned),
        breaks=tuple(_break_of(*broken) for broken in event["breaks"]),
        curve=curve,
    ), answer


def _break_of(
    stop: int,
    target: str | None,
    station: str | None,
    T_tip_target: Any,  # noqa: ANN401  any JSON
    T_frame_base: Any,  # noqa: ANN401
) -> Break:
    """Return a break from its entries in the journal."""
    poses = [None if T is None else read_only(np.array(T)) for T in (T_tip_target, T_frame_base)]
    return Break(stop, target, station, *poses)
