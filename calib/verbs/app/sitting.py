"""Sessions that are open: one for each folder, shared by all browsers, with its instrument and its robot, if any.

What a session knows is in its folder. Beside it stand two hidden files: the keys of forms that were taken, by which a
form that is sent twice is known, and a mark while the session pauses. An instrument is read by a thread of its own; a
reading is added at the pose that is proposed, or at that of the robot if one is connected.
"""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from calib.data.kinds import get as kind_of
from calib.errors import CalibError, MeasurementError
from calib.verbs.app.job import Job
from calib.verbs.measure.devices.controllers import CONTROLLERS
from calib.verbs.measure.devices.readers import READERS
from calib.verbs.measure.session import Session
from calib.verbs.measure.state import NextPose
from calib.verbs.measure.station import TYPED, Station
from calib.verbs.measure.stop import Answer

#: Folder of the session in that of its job.
SESSION = "session"

#: Hidden files: keys of forms, and the mark of a pause.
_KEYS, _PAUSE = ".keys", ".paused"

#: Time for which an instrument is waited for at once, and between two times, when others have their turn [s].
_WAIT, _BETWEEN = 0.2, 0.02

#: The controller of a rehearsal, which says at once that the robot is there.
_VIRTUAL = "virtual"

#: Longest time that an instrument has to give way at the end [s].
_LONGEST = 10.0


class PausedError(CalibError):
    """The session pauses."""


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
        #: What was done last that is no reading: the key of its sentence, and its words; cleared by the next reading
        self.done: tuple[str, dict[str, str]] = ("", {})
        self._station = station = Station(session, reader or TYPED, controller)
        is_rehearsed = not station.has_robot or controller.partition(":")[0] == _VIRTUAL
        #: True if the instrument measures when it is asked, and nothing but a person says when the robot stands there.
        self.waits_for_go = station.is_told or (station.is_asked and is_rehearsed)
        #: True once a person said so at this pose; True once a person said to go on after the aim
        self._may_ask = self._goes_on = False
        #: Number of events by which it was looked up whether the aim is reached, and whether it is
        self._reached = (-1, False)
        self._thread: threading.Thread | None = None
        if self._station.has_instrument:
            self._thread = threading.Thread(target=self._listen, daemon=True)
            self._thread.start()

    @property
    def headers(self) -> tuple[str, ...]:
        """Headers of what is typed of one target, with the units in which people read it; none of pictures."""
        is_image = kind_of(self.session.cell.kind or "point").is_image
        return () if is_image else self._station.headers

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets that are measured at each pose."""
        return tuple(dict.fromkeys(target for _, target in self.session.sights))

    @property
    def asks(self) -> bool:
        """True if a person can say that the robot stands there, so that the instrument measures."""
        return self.waits_for_go or self._station.is_asked

    @property
    def holds(self) -> bool:
        """True while an instrument that comes by itself is not read, as the aim is reached and nobody said to go on."""
        if self._thread is None or self.waits_for_go or self._goes_on:
            return False
        count = len(self.session.events)
        if self._reached[0] != count:
            self._reached = (count, self.session.state.reached)
        return self._reached[1]

    @property
    def is_paused(self) -> bool:
        """True while the session pauses: nothing is added."""
        return (self.folder / _PAUSE).exists()

    @property
    def version(self) -> str:
        """A text that changes whenever the page does."""
        return f"{len(self.session.events)}-{int(self.holds)}-{self._heard}"

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
        """Pause the session, or go on with it; one that pauses is to be closed, so that others can have it."""
        if pauses == self.is_paused:
            return
        self.session.note("pause" if pauses else "resume")
        if pauses:
            (self.folder / _PAUSE).touch()
        else:
            (self.folder / _PAUSE).unlink(missing_ok=True)

    def add(self, rows: Sequence[tuple[str, Sequence[str]]], joints: str, key: str) -> Answer:
        """Add what was typed, at the pose that is proposed or where the robot stands; raises `CalibError`.

        Args:
            rows: Of each target its name, empty for the only one, and its values in the order of `headers`.
            joints: Joint values where the robot stands, as typed; empty: as proposed, or as the robot says.
            key: Names the reading; the same one is added once.
        """
        with self._lock:
            station = self._station
            station.propose()
            if joints:
                station.stands_at(joints)
            named = ["target"] if len(self.targets) > 1 else []
            station.enter(";".join([*named, *station.headers]))
            row = None
            for target, values in rows:
                station.enter(";".join([target, *values] if named else values))
                row = station.read(0.0)
            row = row or station.enough()
            if row is None:
                raise MeasurementError("Nothing was typed that is a reading.")
            answer = self.session.add(row, key=key)
            station.added()
            self.done = ("", {})
            return answer

    def go(self) -> None:
        """Say that the robot stands at the pose, or that the session goes on after its aim."""
        self._may_ask = True
        if not self.waits_for_go:
            self._station.go()
        self._goes_on = self._goes_on or self.holds

    def _listen(self) -> None:
        """Read the instrument until the sitting ends; what is wrong is shown on the page."""
        proposed: NextPose | None = None
        while not self._ends.wait(_BETWEEN):
            if self.is_paused or self.holds or (self.waits_for_go and not self._may_ask):
                proposed = None  # what comes meanwhile is left out
                continue
            try:
                with self._lock:
                    pose = self.session.next()
                    if pose is None:
                        continue
                    if pose is not proposed:
                        proposed = self._station.propose()
                        if self.waits_for_go:
                            self._station.go()
                    row = self._station.read(_WAIT)
                    if row is None:
                        continue
                    self.session.add(row)
                    self._station.added()
                self.fault, self.done = "", ("", {})
            except CalibError as error:
                self.fault = str(error)
            self._may_ask = False
            self._heard += 1

    def close(self) -> None:
        """End the sitting: devices are given back, and the folder is free for another process."""
        self._ends.set()
        if self._thread is not None:
            self._thread.join(_LONGEST)
        self._station.close()
        self.session.close()


class Sittings:
    """The sessions that this server has open."""

    def __init__(self) -> None:
        """Begin without any."""
        self._open: dict[Path, Sitting] = {}
        self._opening = threading.Lock()

    def start(self, job: Job, make: Callable[[Path], Session], *, resumes: bool = False) -> Sitting:
        """Start the session of a job, or go on with it if it was started before; raises `CalibError`.

        Args:
            job: The job.
            make: Starts a session in a folder.
            resumes: Whether a session that pauses is opened; it is refused with a `PausedError` otherwise.
        """
        with self._opening:
            if is_paused(job) and not resumes:
                raise PausedError("The session pauses; go on with it on its page.")
            if job.folder not in self._open:
                folder = job.folder / SESSION
                is_begun = (folder / "session.json").exists()
                session = Session.open(folder) if is_begun else make(folder)
                try:
                    device = (job.choices.get("reader", ""), job.choices.get("controller", ""))
                    self._open[job.folder] = Sitting(job.folder, session, *device)
                except BaseException:
                    session.close()
                    if not is_begun:  # its setup can still be changed
                        shutil.rmtree(folder)
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


def is_paused(job: Job) -> bool:
    """Return True if the session of a job pauses: it is closed, and another process may have it."""
    return (job.folder / _PAUSE).exists()


def check_devices(reader: str, controller: str) -> None:
    """Refuse names of devices that there are none of, before a session is started; raises `CalibError`."""
    for text, known, option in (
        (reader, READERS, "reader"),
        (controller, CONTROLLERS, "controller"),
    ):
        name = text.partition(":")[0]
        if text and name not in known:
            raise CalibError(f"There is no {option} '{name}'; there are {', '.join(known)}.")
