"""Sessions that are open: one for each folder, shared by all browsers, with its instrument and its robot, if any.

What a session knows is in its folder. Beside it stand two hidden files: the keys of forms that were taken, by which a
form that is sent twice is known, and a mark while the session pauses. An instrument is read by a thread of its own; a
reading is added at the pose that is proposed, or at that of the robot if one is connected.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calib.data.kinds import get as kind_of
from calib.errors import CalibError
from calib.verbs.app.job import Job
from calib.verbs.measure.devices.controllers import (
    CONTROLLERS,
    JointSource,
    joints_at_rest,
    open_controller,
)
from calib.verbs.measure.devices.readers import READERS, Instrument, open_reader
from calib.verbs.measure.devices.reading import Context, Reading
from calib.verbs.measure.session import Session
from calib.verbs.measure.stop import Answer

#: Folder of the session in that of its job.
SESSION = "session"

#: Hidden files: keys of forms, and the mark of a pause.
_KEYS, _PAUSE = ".keys", ".paused"

#: Time for which an instrument is waited for at once [s], so that it can be given back soon.
_WAIT = 0.5

#: Time that a robot has to stand still when a reading comes [s].
_STILL = 5.0


class Sitting:
    """An open session with its devices."""

    def __init__(self, folder: Path, session: Session, reader: str, controller: str) -> None:
        """Connect a session's devices; CalibError if one cannot be.

        Args:
            folder: The folder of the job.
            session: The session.
            reader: The instrument, as ``--reader`` names it; empty: readings are typed.
            controller: The robot, as ``--controller`` names it; empty: it is driven to the proposed poses.
        """
        self.folder, self.session = folder, session
        #: What an instrument said last, if that was a fault; and how often it spoke
        self.fault, self._heard = "", 0
        self._ends = threading.Event()
        self._lock = threading.RLock()
        self._controller: JointSource | None = None
        self._reader: Instrument | None = None
        context = self._context()
        if controller:
            self._controller = open_controller(controller, context)
        try:
            if reader:
                self._reader = open_reader(reader, context)
        except CalibError:
            self._close_devices()
            raise
        self._thread: threading.Thread | None = None
        if self._reader is not None:
            self._thread = threading.Thread(target=self._listen, daemon=True)
            self._thread.start()

    def _context(self) -> Context:
        """Return what devices need to know of the session."""
        robot, cell = self.session.robot, self.session.cell
        return Context(
            joint_names=robot.joint_names,
            joint_types=robot.joint_types,
            kind=cell.kind,
            targets=tuple(cell.targets),
            # Lines of three numbers are read as a list of points, which may have names too.
            columns=() if cell.kind in (None, "point") else self.headers,
            points_unit="mm",
            folder=self.session.folder,
        )

    @property
    def headers(self) -> tuple[str, ...]:
        """Headers of what is read of one target, with the units in which people read it."""
        kind = kind_of(self.session.cell.kind or "point")
        headers = ["x [mm]", "y [mm]", "z [mm]"] if kind.position else []
        if kind.orientation:
            headers += ["rx [deg]", "ry [deg]", "rz [deg]"]
        units = {"length": "mm", "angle": "deg"}
        headers += [f"{one.name} [{units[str(one.quantity)]}]" for one in kind.readings]
        return tuple(headers)

    @property
    def is_paused(self) -> bool:
        """True while the session pauses: nothing is added."""
        return (self.folder / _PAUSE).exists()

    @property
    def version(self) -> str:
        """A text that changes whenever the page does."""
        return f"{len(self.session.events)}-{int(self.is_paused)}-{self._heard}"

    def once(self, key: str, act: Callable[[], Any]) -> None:
        """Do something, unless a form with the same key has done it before."""
        with self._lock:
            path = self.folder / _KEYS
            known = path.read_text(encoding="utf-8").split() if path.exists() else []
            if key and key in known:
                return
            act()
            if key:
                with path.open("a", encoding="utf-8") as file:
                    file.write(f"{key}\n")

    def pause(self, *, pauses: bool) -> None:
        """Pause the session, or go on with it."""
        if pauses == self.is_paused:
            return
        self.session.note("pause" if pauses else "resume")
        if pauses:
            (self.folder / _PAUSE).touch()
        else:
            (self.folder / _PAUSE).unlink(missing_ok=True)

    def add(self, columns: dict[str, Any], key: str) -> Answer:
        """Add what was read, at the pose that is proposed or where the robot stands; raises `CalibError`.

        Args:
            columns: Values by their headers, a list for several targets.
            key: Names the reading; the same one is added once.
        """
        with self._lock:
            names = self.session.robot.joint_names
            typed = any(header.split(" [")[0] in names for header in columns)
            if self._controller is not None and not typed:
                q = joints_at_rest(self._controller, _STILL)
                if q is None:
                    raise CalibError(
                        "The robot moves: wait until it stands still, and send the reading again."
                    )
                count = max(len(v) if isinstance(v, list) else 1 for v in columns.values())
                context = self._context()
                at = dict(zip(context.joint_headers, q.tolist(), strict=True))
                columns = {**{name: [value] * count for name, value in at.items()}, **columns}
            return self.session.add(columns, key=key)

    def _listen(self) -> None:
        """Read the instrument until the sitting ends; what is wrong is shown on the page."""
        assert self._reader is not None
        while not self._ends.is_set():
            try:
                reading = self._reader.read(_WAIT)
                if reading is None or self.is_paused:
                    continue
                self._take(reading)
                self.fault = ""
            except CalibError as error:
                self.fault = str(error)
            self._heard += 1

    def _take(self, reading: Reading) -> None:
        """Add a reading of the instrument; CalibError if it does not fit."""
        if reading.pictures:
            raise CalibError(
                "The instrument gave pictures, which this page does not take yet: measure with calib measure."
            )
        headers = dict.fromkeys(header for row in reading.rows for header in row)
        columns = {header: [row.get(header, "") for row in reading.rows] for header in headers}
        self.add({name: values for name, values in columns.items() if name != "point"}, "")

    def close(self) -> None:
        """End the sitting: devices are given back, and the folder is free for another process."""
        self._ends.set()
        if self._thread is not None:
            self._thread.join(2.0 + _WAIT)
        self._close_devices()
        self.session.close()

    def _close_devices(self) -> None:
        """Give instrument and robot back."""
        for device in (self._reader, self._controller):
            if device is not None:
                with contextlib.suppress(CalibError, OSError):
                    device.close()


class Sittings:
    """The sessions that this server has open."""

    def __init__(self) -> None:
        """Begin without any."""
        self._open: dict[Path, Sitting] = {}
        self._opening = threading.Lock()

    def start(self, job: Job, make: Callable[[Path], Session]) -> Sitting:
        """Start the session of a job, or go on with it if it was started before; raises `CalibError`.

        Args:
            job: The job.
            make: Starts a session in a folder.
        """
        with self._opening:
            if job.folder not in self._open:
                folder = job.folder / SESSION
                is_begun = (folder / "session.json").exists()
                session = Session.open(folder) if is_begun else make(folder)
                try:
                    device = (job.choices.get("reader", ""), job.choices.get("controller", ""))
                    self._open[job.folder] = Sitting(job.folder, session, *device)
                except BaseException:
                    session.close()
                    raise
            return self._open[job.folder]

    def close(self, job: Job) -> None:
        """Close the session of a job, if it is open."""
        with self._opening:
            sitting = self._open.pop(job.folder, None)
        if sitting is not None:
            sitting.close()

    def close_all(self) -> None:
        """Close all sessions."""
        with self._opening:
            sittings, self._open = list(self._open.values()), {}
        for sitting in sittings:
            sitting.close()


def is_begun(job: Job) -> bool:
    """Return True if the session of a job was started."""
    return (job.folder / SESSION / "session.json").exists()


def check_devices(reader: str, controller: str) -> None:
    """Refuse names of devices that there are none of, before a session is started; raises `CalibError`."""
    for text, known, option in (
        (reader, READERS, "reader"),
        (controller, CONTROLLERS, "controller"),
    ):
        name = text.partition(":")[0]
        if text and name not in known:
            raise CalibError(f"There is no {option} '{name}'; there are {', '.join(known)}.")
