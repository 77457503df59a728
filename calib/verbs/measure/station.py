"""A station: a session with its instrument and its robot, which make a row of each stop.

It tells both the pose that is next, collects a reading of each target there, finds the corners of boards in pictures,
and asks where the robot stands.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

import numpy as np

import calib.basics.plugins as plugins
import calib.data.kinds as kinds
from calib.basics.arrays import Array
from calib.basics.files import make_folder, read_bytes, write_atomically
from calib.basics.units import find_unit
from calib.data.columns import name_columns
from calib.data.forms.column_options import ColumnOptions
from calib.errors import CalibError, DeviceError, MeasurementError, choices
from calib.verbs.detect.one_picture import find_corners
from calib.verbs.measure.devices.controllers import (
    CONTROLLERS,
    JointSource,
    joints_at_rest,
    open_controller,
)
from calib.verbs.measure.devices.lines import LineRows
from calib.verbs.measure.devices.readers import READERS, Instrument, open_reader
from calib.verbs.measure.devices.reading import Cells, Context, Reading
from calib.verbs.measure.devices.typed import TypedController
from calib.verbs.measure.headers import headers_of, misread_place
from calib.verbs.measure.session import Session
from calib.verbs.measure.state import NextPose
from calib.verbs.measure.stop import Row

#: The reader of rows that are typed, which needs no instrument.
TYPED = "stdin"

#: Time that a robot has to come to rest after a reading [s].
_TO_REST = 5.0

#: A robot whose joints are all this near to the proposed pose has arrived there [rad or m].
_ARRIVED = 1e-2

#: Longest time between two looks [s].
_LOOK = 0.2


@dataclass(slots=True)
class _Stop:
    """The readings so far of the pose that is measured."""

    pose: NextPose
    #: Rows by station and target, and what they came from.
    rows: dict[tuple[str, str], list[Cells]] = field(default_factory=dict)
    sources: list[str] = field(default_factory=list)
    #: True if an instrument was asked by itself when the robot arrived; what it gave is not asked for twice.
    was_asked: bool = False


class Station:
    """A session with its instrument and its robot.

    For example:

        with Station(session, "tcp:192.168.0.20:5000") as station:
            while station.propose() is not None:
                answer = session.add(station.read())
                station.added()
                print(answer.summary())
    """

    def __init__(
        self,
        session: Session,
        reader: str = TYPED,
        controller: str = "",
        *,
        columns: ColumnOptions | None = None,
        unit: str = "mm",
    ) -> None:
        """Connect a session with its devices.

        Args:
            session: The session, which stays open when the station is closed.
            reader: The instrument, as ``--reader`` names it; `TYPED`: there is none, and rows are given to `enter`.
            controller: The robot, as ``--controller`` names it; empty: it is driven to the proposed poses by hand.
            columns: What is said of the columns of rows with a header.
            unit: Unit of lengths that come without a header, such as ``"mm"``.

        Raises:
            DeviceError: There is no such reader or controller, or it cannot be opened.
            CalibError: The unit is not one of length.
        """
        check_devices(reader, controller, unit)
        self.session = session
        self._columns = columns
        self._unit = unit
        robot, cell = session.robot, session.cell
        self.headers = tuple(headers_of(cell.kind or "point", unit, columns))
        targets = dict.fromkeys(target for _, target in session.sights)
        self._wanted = tuple(dict.fromkeys(session.sights))
        self.context = Context(
            joint_names=robot.joint_names,
            joint_types=robot.joint_types,
            kind=cell.kind,
            targets=tuple(targets),
            columns=self.headers,
            points_unit=unit,
            folder=session.folder,
            robot=robot,
            cell=cell,
        )
        #: Number of readings that came before the pose was proposed, and are left out.
        self.late = 0
        self._typed = LineRows("what you typed", self.context)
        self._ready: deque[Reading | CalibError] = deque()
        self._stop: _Stop | None = None
        self._repeated: NextPose | None = None
        self._may_ask = False
        name = reader.partition(":")[0]
        self._controller: JointSource | None = None
        if controller:
            self._controller = open_controller(controller, self.context)
        self._instrument: Instrument | None = None
        if reader != TYPED:
            try:
                self._instrument = open_reader(reader, self.context)
            except BaseException:
                self.close()
                raise
        #: True if the instrument measures when it is asked, as a camera: `go` says that the robot stands at the pose.
        self.is_asked = name in READERS and READERS[name].is_asked

    def __enter__(self) -> Station:
        """Return the station."""
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        """Give the devices back."""
        self.close()

    def close(self) -> None:
        """Give the devices back; the session stays open."""
        for device in (self._instrument, self._controller):
            if device is not None:
                with suppress(CalibError, OSError):
                    device.close()

    @property
    def has_instrument(self) -> bool:
        """True if rows come from an instrument; False if they are typed."""
        return self._instrument is not None

    @property
    def has_robot(self) -> bool:
        """True if a robot is connected that says where it stands."""
        return not isinstance(self._controller, TypedController | None)

    @property
    def is_told(self) -> bool:
        """True if the instrument is told each pose, and measures there by itself."""
        return hasattr(self._instrument, "propose")

    @property
    def waits_for_go(self) -> bool:
        """True if the instrument is asked when `go` says that the robot stands at the pose."""
        return self.is_asked and not self._may_ask

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the targets, of pictures those of the cameras, that are not measured at this pose yet."""
        collected = {} if self._stop is None else self._stop.rows
        is_image = kinds.get(self.session.cell.kind or "point").is_image
        left = [sight for sight in self._wanted if sight not in collected]
        return tuple(dict.fromkeys(group if is_image else target for group, target in left))

    def propose(self) -> NextPose | None:
        """Return the pose to measure, and tell the devices; what they gave before is left out.

        Returns:
            The pose that the session proposes, or the last one if it is measured `again`; None: no candidate is left.
        """
        pose = self._repeated or self.session.next()
        self.late = self._drain()
        self._may_ask = False
        self._stop = None if pose is None else _Stop(pose)
        for device in (self._instrument, self._controller):
            propose = getattr(device, "propose", None)
            if pose is not None and propose is not None:
                propose(pose.joints)
        return pose

    def again(self) -> int | None:
        """Take the last stop back; its pose is proposed once more.

        Returns:
            Its number; None if there is none.
        """
        if not self.session.stops:
            return None
        row = self.session.stops[-1].row
        number = self.session.undo("measured again")
        sights = self.session.sights
        self._repeated = NextPose(
            joints=row.joints,
            via=None if row.moves is None else row.joints - row.moves,
            expected=self.session.expected(row.joints),
            targets=tuple(target for _, target in sights),
            error=None,
            why="again",
            stop=number,
            travel=0.0,
        )
        return number

    def enter(self, line: str) -> None:
        """Take a row as it is typed: numbers in the order of `headers`, or below a header that was typed before.

        Args:
            line: Such as ``"812.3 5.1 420.9"``.

        Raises:
            MeasurementError: It is no row.
        """
        for entry in self._typed.feed(f"{line}\n".encode()):
            if isinstance(entry, CalibError):
                raise MeasurementError(
                    str(entry).replace("measure this point again", "type it again")
                )
            self._ready.append(entry)

    def stands_at(self, text: str) -> None:
        """Take the joint values at which the robot stands, other than the proposed ones, as typed.

        Args:
            text: Degrees, or millimetres of joints that slide, in the order of the robot's joints.

        Raises:
            MeasurementError: These are not as many numbers as the robot has joints.
        """
        if not isinstance(self._controller, TypedController | None):
            raise MeasurementError(
                "The controller says where the robot stands, so that 'at' is not needed: drive the robot to where "
                "it is to be measured, and measure there."
            )
        if self._controller is None:
            self._controller = TypedController("", self.context)
        try:
            self._controller.enter(text)
        except MeasurementError as error:
            names = ", ".join(self._controller.headers)
            raise MeasurementError(
                f"'{text.strip()}' is not where the robot stands: type the values of {names}."
            ) from error

    def go(self) -> None:
        """Say that the robot stands at the pose, so that an instrument that waits for that is asked."""
        self._may_ask = True

    def read(self, timeout: float | None = None) -> Row | None:
        """Return what is measured at the pose, when each target has a reading.

        Args:
            timeout: How long to wait for it [s]; None: until it is there.

        Returns:
            The row, to be added to the session; None if it is not complete. What was collected so far stays.

        Raises:
            MeasurementError: Something came that is no reading of this pose; it is left out.
            DeviceError: The instrument or the robot does not answer, or there is nothing more to come.
        """
        if self._stop is None:
            self.propose()
        stop = self._stop
        if stop is None:
            raise MeasurementError("No pose is proposed: no candidate is left.")
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            left = _LOOK if deadline is None else min(deadline - time.monotonic(), _LOOK)
            reading = self._next_reading(stop, max(left, 0.0))
            if reading is not None:
                self._collect(stop, reading)
                if not self.missing:
                    return self._row(stop)
            is_over = deadline is not None and time.monotonic() >= deadline
            if is_over and not self._ready:
                return None

    def enough(self) -> Row | None:
        """Return what was collected at the pose, though a target is missing; None if there is nothing."""
        if self._stop is None or not self._stop.rows:
            return None
        return self._row(self._stop)

    def added(self) -> None:
        """Say that the row was added: the pose is done."""
        self._stop = self._repeated = None

    # Inside

    def _drain(self) -> int:
        """Leave out what an instrument that is not asked gave for earlier poses, and count it.

        One that is told its pose measures nothing else: to read it would be to measure the pose before.
        """
        if self._instrument is None or self.is_asked or self.is_told:
            return 0
        count = 0
        while True:
            try:
                if self._instrument.read(0.0) is None:
                    return count
            except DeviceError as error:  # such as the end of a connection, which is to be said
                self._ready.append(error)
                return count
            except CalibError:
                pass
            count += 1

    def _next_reading(self, stop: _Stop, seconds: float) -> Reading | None:
        """Return the next reading that was typed or that the instrument gives; None if there is none within a time."""
        if self._ready:
            entry = self._ready.popleft()
            if isinstance(entry, CalibError):
                raise entry
            return entry
        if self._instrument is None:
            time.sleep(min(seconds, 0.02))
            return None
        if self.is_asked:
            if not self._may_ask and not self._has_arrived(stop):
                time.sleep(seconds)
                return None
            self._may_ask = False
        return self._instrument.read(seconds)

    def _has_arrived(self, stop: _Stop) -> bool:
        """Return True once: when the robot stands still at the pose that was proposed, if it says where it stands."""
        if stop.was_asked or not self.has_robot:
            return False
        assert self._controller is not None
        q = joints_at_rest(self._controller, 0.0)
        stop.was_asked = q is not None and bool(np.abs(q - stop.pose.joints).max() < _ARRIVED)
        return stop.was_asked

    def _collect(self, stop: _Stop, reading: Reading) -> None:
        """Keep the rows of a reading by station and target; MeasurementError if they cannot be."""
        rows = [*reading.rows]
        for picture in reading.pictures:
            rows += self._rows_of_picture(picture)
        found: dict[tuple[str, str], list[Cells]] = {}
        for row in rows:
            misread = (
                misread_place(row, self.session.origin) if row.keys() >= {*self.headers} else None
            )
            if misread is not None:
                fault, unit = misread
                raise MeasurementError(
                    f"{fault} Give it in {self._unit}, or choose --unit {unit}; it is left out."
                )
            cells = {name: value for name, value in row.items() if name != "point"}
            sight = self._sight(cells, {*stop.rows, *found})
            if sight[1] and len({target for _, target in self._wanted}) > 1:
                cells["target"] = sight[1]
            found.setdefault(sight, []).append(cells)
        stop.rows.update(found)
        stop.sources.append(reading.source)

    def _sight(self, cells: Cells, collected: set[tuple[str, str]]) -> tuple[str, str]:
        """Return the station and the target of a row; one without a name is of the next target that is missing."""
        group, target = str(cells.get("group", "")), str(cells.get("target", ""))
        if target and group:
            return group, target
        names = {name for _, name in self._wanted}
        if target and target not in names and (len(names) > 1 or self.session.cell.targets):
            known = choices(sorted(names))
            raise MeasurementError(
                f"The reading is of the target '{target}'; those of the cell are {known}. It is left out."
            )
        fitting = [
            sight
            for sight in self._wanted
            if group in ("", sight[0]) and (target in ("", sight[1]) or target not in names)
        ]
        if not fitting:  # of a station that the session does not know, which it says
            return group, target
        return next((sight for sight in fitting if sight not in collected), fitting[-1])

    def _row(self, stop: _Stop) -> Row:
        """Return the row of a stop, with where the robot stood."""
        rows = tuple(row for sight in self._in_order(stop) for row in stop.rows[sight])
        reading = Reading(rows, source=", ".join(dict.fromkeys(filter(None, stop.sources))))
        stop.rows, stop.sources = {}, []
        pose, names = stop.pose, self.context.joint_names
        q: Array | None = pose.joints
        if self.has_robot or getattr(self._controller, "is_typed", False):
            assert self._controller is not None
            q = self._controller.joints() if not self.has_robot else self._at_rest()
        elif {*names} & {*name_columns(reading.table(), names, self._columns)[0]}:
            q = None  # the reading has them
        table = reading.measurements(self.context, q, self._columns)
        if q is None:
            q = table.joints_for(names)[0]
        moves = None if pose.via is None else pose.joints - pose.via
        return Row(q, table, moves)

    def _in_order(self, stop: _Stop) -> Iterator[tuple[str, str]]:
        """Yield the stations and targets that were collected: those of the cell in its order, then others."""
        yield from (sight for sight in self._wanted if sight in stop.rows)
        yield from (sight for sight in stop.rows if sight not in self._wanted)

    def _at_rest(self) -> Array:
        """Return where the robot stands; MeasurementError if it does not come to rest."""
        assert self._controller is not None
        q = joints_at_rest(self._controller, _TO_REST)
        if q is None:
            raise MeasurementError(
                "The robot was moving when the reading came, which is left out: measure again when it stands still."
            )
        return q

    def _rows_of_picture(self, path: Path) -> Iterator[Mapping[str, str | float]]:
        """Yield a row for each corner of a board in a picture, which is kept; MeasurementError if there is none."""
        cell = self.session.cell
        if not cell.boards:
            raise MeasurementError(
                f"'{path.name}' is a picture, and the cell has no board: start a session with --camera and --board."
            )
        boards = list(cell.boards.values())
        camera = self._camera_of(path)
        picture = find_corners(path, boards, camera)
        described = cell.cameras.get(camera) or next(iter(cell.cameras.values()))
        if picture.size != (described.width, described.height):
            raise MeasurementError(
                f"The picture '{path.name}' has {picture.size[0]} x {picture.size[1]} pixels, and the camera's have "
                f"{described.width} x {described.height}. Take pictures of this size."
            )
        name = self._keep(path)
        corners = {board.name: board.corners for board in boards}
        named = {board.name: target for target, board in cell.boards.items()}
        for view in picture.used:
            for corner, pixel, sigma in zip(view.ids, view.pixels, view.sigma, strict=True):
                row: dict[str, str | float] = {"image": name, "corner": str(int(corner))}
                if camera:
                    row["group"] = camera
                if len(boards) > 1:
                    row["target"] = named[view.board] or view.board
                place = corners[view.board][corner]
                row |= {f"board_{axis} [m]": float(x) for axis, x in zip("xyz", place, strict=True)}
                row |= {"u [px]": float(pixel[0]), "v [px]": float(pixel[1])}
                yield row | {"sigma_image [px]": float(sigma), "kind": "pixel"}

    def _camera_of(self, path: Path) -> str:
        """Return the name of the camera of a picture, which that of the file or of its folder has; empty if it is one.

        MeasurementError if the cell has several, and the picture does not say which.
        """
        names = [name for name in self.session.cell.cameras if name]
        if len(self.session.cell.cameras) < 2:
            return names[0] if names else ""
        fitting = [n for n in names if path.parent.name == n or path.name.startswith(n)]
        if not fitting:
            raise MeasurementError(
                f"The camera of the picture '{path.name}' is not known: let its name begin with that of the camera, "
                f"{choices(names)}, or put it into a folder of that name."
            )
        return max(fitting, key=len)

    def _keep(self, path: Path) -> str:
        """Copy a picture into the session's folder, and return its name there; another picture has another one."""
        folder = self.session.pictures
        if path.parent.resolve() == folder.resolve():
            return path.name
        make_folder(folder)
        data, kept, number = read_bytes(path, "The picture"), folder / path.name, 1
        while kept.exists():
            number += 1
            kept = folder / f"{path.stem}_{number}{path.suffix}"
        write_atomically(kept, data, overwrite=False)
        return kept.name


def check_devices(reader: str, controller: str, unit: str) -> None:
    """Refuse, before a session is started, devices that `Station` would refuse by their names.

    Args:
        reader: As of `Station`.
        controller: As of `Station`.
        unit: As of `Station`.

    Raises:
        DeviceError: There is no such reader or controller.
        CalibError: The unit is not one of length.
    """
    for text, what, known in (
        (reader, "readers", READERS),
        (controller, "controllers", CONTROLLERS),
    ):
        name = text.partition(":")[0]
        if text and name not in known:
            raise DeviceError(plugins.unknown(what, name, known))
    if find_unit(unit).quantity != "length":
        raise CalibError(f"The unit '{unit}' is not one of length; give one such as 'mm'.")
