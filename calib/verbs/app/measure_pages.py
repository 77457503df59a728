"""The pages of sessions: a robot is set up, measured stop by stop, and calibrated."""

from __future__ import annotations

import hashlib
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import BaseRoute, Route

from calib.basics.files import read_bytes, write_atomically
from calib.basics.units import parse_point
from calib.data.cell import Cell
from calib.data.cell_chains import robot_of_cell
from calib.errors import CalibError
from calib.robot.urdf import known_robots, read_urdf
from calib.show.lines import mm
from calib.verbs.app.choices import check_no_plugins, choices_of
from calib.verbs.app.commands import cell_text, parse_length, session_commands
from calib.verbs.app.desk import title_of
from calib.verbs.app.fields import Looked
from calib.verbs.app.guesses import look_for_session, named_robot
from calib.verbs.app.job import CELL, Job, Kind
from calib.verbs.app.site import Site, check_robot_name
from calib.verbs.app.sitting import (
    SESSION,
    PausedError,
    Sitting,
    check_devices,
    is_begun,
    is_paused,
)
from calib.verbs.app.sitting_page import (
    advice_texts,
    answer_view,
    curve_of,
    ghost_page,
    open_text,
    pose_view,
    stop_lines,
    unreached_text,
)
from calib.verbs.app.uploads import (
    Received,
    UploadError,
    incoming,
    is_picture,
    receive_form,
    receive_upload,
)
from calib.verbs.measure.aim import Aim
from calib.verbs.measure.session import Session
from calib.verbs.measure.settings import CELL as SESSION_CELL, TABLE
from calib.verbs.measure.state import NextPose

#: Stops that a calibration needs at least.
_FEWEST = 5

#: Policy of the 3-D page, which runs its own script alone.
_GHOST = {
    "content-security-policy": "sandbox allow-scripts; frame-ancestors 'self'",
    "x-frame-options": "SAMEORIGIN",
}

#: Choices of a session that its calibration gets too; the session's cell has the others.
_KEPT = ("robot", "robot_name", "xacro")

#: Name of the session's cell among the inputs of its calibration.
_CELL = "session-cell.toml"

#: A number as it is typed, its comma a point.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)


#: Devices of a session that is rehearsed.
_REHEARSAL = {"reader": "virtual:1", "controller": "virtual"}


class NotAddedError(CalibError):
    """A reading was not added; the text is in the reader's language."""


class MeasurePages:
    """The pages of sessions."""

    def __init__(self, site: Site) -> None:
        """Show the sessions of a site."""
        self._site = site

    @property
    def routes(self) -> list[BaseRoute]:
        """The addresses of the pages."""
        of_job = "/jobs/{job}"
        return [
            Route("/measure", self._measure, methods=["GET"]),
            Route("/measure", self._take, methods=["POST"]),
            Route(f"{of_job}/live", self._live),
            Route(f"{of_job}/ghost", self._ghost),
            Route(f"{of_job}/reading", self._reading, methods=["POST"]),
            Route(f"{of_job}/go", self._go, methods=["POST"]),
            Route(f"{of_job}/undo", self._undo, methods=["POST"]),
            Route(f"{of_job}/skip", self._skip, methods=["POST"]),
            Route(f"{of_job}/note", self._note, methods=["POST"]),
            Route(f"{of_job}/pause", self._pause, methods=["POST"]),
            Route(f"{of_job}/finish", self._finish, methods=["POST"]),
        ]

    async def _measure(self, request: Request) -> Response:
        """Show the sessions, and where one is begun."""

        def read() -> Mapping[str, Any]:
            """Read the sessions."""
            jobs = [pair for pair in self._site.listed() if pair[0].kind is Kind.MEASURE]
            return {"jobs": jobs, "robots": known_robots()}

        return self._site.draw(
            request, "measure.html.j2", "measure", **await run_in_threadpool(read)
        )

    async def _take(self, request: Request) -> Response:
        """Make a session of a robot that was sent or named, not yet begun."""
        with incoming(self._site.desk.folder) as folder:
            received = await receive_upload(request, folder)
            robot = received.fields.get("robot_name", "").strip()

            def make() -> Job:
                """Make the job."""
                check_robot_name(robot)
                check_no_plugins(received)
                if not received.files and not robot:
                    raise UploadError("No robot was chosen; send its file, or name it.")
                title = f"session-{title_of(received.files, robot)}"
                choices = {"robot_name": robot} if robot else {}
                key = received.fields.get("key", "")
                return self._site.desk.make(Kind.MEASURE, title, key, received, choices)

            return self._site.to(await run_in_threadpool(make))

    # Setup

    async def page(self, request: Request, job: Job) -> Response:
        """Show a session, or its setup before it is begun."""
        if is_begun(job):
            return await self._show(request, job)
        return await self._setup(request, job)

    def _show_paused(self, request: Request, job: Job, said: str = "", error: str = "") -> Response:
        """Show a session that pauses: it is closed, and goes on here or elsewhere."""
        return self._site.draw(
            request,
            "paused.html.j2",
            "measure",
            status=409 if said or error else 200,
            job=job,
            said=said,
            error=error,
            command=[shlex.join(["calib", "measure", str(job.folder / SESSION)])],
        )

    async def _setup(
        self,
        request: Request,
        job: Job,
        error: str = "",
        faults: Mapping[str, str] | None = None,
        typed: Mapping[str, str] | None = None,
    ) -> Response:
        """Show the setup of a session, with the faults of its fields, and what was typed where it is not kept."""
        looked = await run_in_threadpool(look_for_session, job)
        return self._site.draw(
            request,
            "setup.html.j2",
            "measure",
            status=400 if error or faults else 200,
            job=job,
            looked=looked,
            error=error,
            faults=faults or {},
            typed=typed or {},
            shown=[file for file in looked.files if not is_picture(file.name)],
            pictures=0,
        )

    async def choose(self, request: Request, job: Job, form: Mapping[str, str]) -> Response:
        """Keep what was chosen in the setup, and begin the session if that was asked for."""

        def choose() -> tuple[Job, str, dict[str, str], dict[str, str]]:
            """Keep the choices, and begin; return what keeps it from that, and what was typed and is not kept."""
            if is_begun(job):
                return job, "", {}, {}
            faults, typed, kept = {}, {}, dict(form)
            name = form.get("robot_name", "").strip()
            try:
                check_robot_name(name)
            except CalibError as error:
                faults, typed = {"robot_name": str(error)}, {"robot_name": name}
                kept["robot_name"] = form.get("was:robot_name", "")
            choices = choices_of(job, kept)
            chosen = job.with_choices(choices).write()
            is_rehearsal = form.get("action") == "rehearse"
            if is_rehearsal:
                chosen = job.with_choices(choices | _REHEARSAL).write()
            if (is_rehearsal or form.get("action") == "measure") and not faults:
                faults = dict(_faults(look_for_session(chosen)))
                try:
                    if not faults:
                        self._site.sittings.start(chosen, self._begin(chosen))
                except CalibError as error:
                    return chosen, str(error).replace(f"{job.folder}/", ""), {}, {}
            return chosen, "", faults, typed

        chosen, error, faults, typed = await run_in_threadpool(choose)
        if error or faults:
            return await self._setup(request, chosen, error, faults, typed)
        return self._site.to(chosen)

    def _begin(self, job: Job) -> Callable[[Path], Session]:
        """Return what starts the session of a job in a folder; it raises `CalibError`."""

        def begin(folder: Path) -> Session:
            """Start it as its setup says."""
            looked = look_for_session(job)
            if not looked.is_ready:
                raise CalibError(looked.fault or "The robot is missing.")
            aim = _aim(looked)
            cell_file = looked.value("cell")
            if not cell_file:
                cell_file = CELL
                write_atomically(job.folder / CELL, cell_text(looked).encode(), overwrite=True)
            cell = Cell.read(job.folder / cell_file)
            arm = robot_of_cell(read_urdf(named_robot(job, looked)), cell)
            return Session.start(
                folder,
                arm,
                cell,
                aim,
                collisions=looked.value("collisions") == "yes",
            )

        return begin

    # Measuring

    def _sitting(self, job: Job) -> Sitting:
        """Return the open session of a job; raises `CalibError`."""
        return self._site.sittings.start(job, self._begin(job))

    async def _show(
        self,
        request: Request,
        job: Job,
        said: str = "",
        error: str = "",
        typed: Mapping[str, str] | None = None,
    ) -> Response:
        """Show a session: the next pose, and what was said of the last stop."""

        def words() -> dict[str, Any]:
            """Ask the session."""
            return self._words(request, self._sitting(job))

        try:
            shown = await run_in_threadpool(words)
        except PausedError:
            return self._show_paused(request, job, said, error)
        return self._site.draw(
            request,
            "sitting.html.j2",
            "measure",
            status=409 if said or error else 200,
            said=said,
            error=error,
            typed=typed or {},
            **shown,
        )

    def _words(self, request: Request, sitting: Sitting) -> dict[str, Any]:
        """Return what the page of a session shows."""
        t = self._site.sentences(request)
        session = sitting.session
        version = sitting.version  # what comes after it is shown the next time
        pose, state, stops = session.next(), session.state, session.stops
        sizes = {
            name: "" if value is None else mm(value)
            for name, value in (
                *(("error", state.error), ("high", state.high)),
                *(("aim", state.aim), ("nominal", state.nominal)),
            )
        }
        is_placed = state.error is not None or not session.cell.estimate_frame
        job = Job.read(sitting.folder)
        return {
            "job": job,
            "live": version,
            "done": t(sitting.done[0], **sitting.done[1]) if sitting.done[0] else "",
            "fault": sitting.fault,
            "answer": answer_view(stops[-1].answer, session.robot, t) if stops else None,
            "pose": None if pose is None else pose_view(session, pose, is_placed=is_placed),
            "pose_id": _pose_id(session, pose),
            "state": state,
            "sizes": sizes,
            "unreached": unreached_text(state, t),
            "curve": curve_of(state.curve, state.aim),
            "open": [open_text(finding, session.robot, t) for finding in state.findings],
            "advice": list(advice_texts(state, t)),
            "stops": list(stop_lines(stops, session.robot, t)),
            "notes": [note for note in session.notes if note not in ("pause", "resume")],
            "targets": sitting.targets,
            "asks": sitting.asks,
            "waits": sitting.waits_for_go,
            "holds": sitting.holds,
            "headers": sitting.headers,
            "reader": job.choices.get("reader", ""),
        }

    async def _live(self, request: Request) -> Response:
        """Send what changes of a session's page, if it has changed since a version."""
        job = self._site.job_of(request)

        def words() -> dict[str, Any] | None:
            """Ask the session; None if the page is up to date."""
            sitting = self._sitting(job)
            if sitting.version == request.query_params.get("v"):
                return None
            return self._words(request, sitting)

        try:
            shown = await run_in_threadpool(words)
        except PausedError:
            is_known = request.query_params.get("v") == "paused"
            return Response(status_code=204 if is_known else 200, headers={"x-paused": "true"})
        if shown is None:
            return Response(status_code=204)
        answer = self._site.draw(request, "live.html.j2", "", **shown)
        answer.headers["x-version"] = shown["live"]
        answer.headers["x-form"] = str(bool(shown["pose"])).lower()
        return answer

    async def _ghost(self, request: Request) -> Response:
        """Send the 3-D page of the next pose."""
        job = self._site.job_of(request)
        t = self._site.sentences(request)

        def page() -> bytes:
            """Draw it."""
            session = self._sitting(job).session
            pose = session.next()
            if pose is None:
                return b""
            return ghost_page(session, pose, (t("robot_now"), t("robot_next")))

        return HTMLResponse(await run_in_threadpool(page), headers=_GHOST)

    async def _reading(self, request: Request) -> Response:
        """Add a reading that was typed."""
        job = self._site.job_of(request)
        form = await receive_form(request)
        t = self._site.sentences(request)

        def add() -> None:
            """Add it, unless its form was sent before or is about another pose."""
            sitting = self._sitting(job)
            key = form.get("key", "")

            def act() -> None:
                """Add it."""
                pose = sitting.session.next()
                if form.get("pose") != _pose_id(sitting.session, pose):
                    raise NotAddedError(t("reading_pose_changed"))
                rows = _typed_rows(form, sitting, lambda text: t("reading_numbers", text=text))
                sitting.add(rows, form.get("joints", "").strip(), key)

            sitting.once(key, act)

        try:
            await run_in_threadpool(add)
        except PausedError:
            return self._show_paused(request, job, said=t("paused"))
        except NotAddedError as error:
            return await self._show(request, job, said=str(error), typed=form)
        except CalibError as error:
            return await self._show(request, job, error=str(error), typed=form)
        return self._site.to(job)

    async def _act(
        self, request: Request, act: Callable[[Sitting, Mapping[str, str]], object]
    ) -> Response:
        """Do something with a session, once for each form."""
        job = self._site.job_of(request)
        form = await receive_form(request)

        def run() -> None:
            """Do it."""
            sitting = self._sitting(job)
            sitting.once(form.get("key", ""), lambda: act(sitting, form))

        with suppress(PausedError):  # which the page says
            await run_in_threadpool(run)
        return self._site.to(job)

    async def _go(self, request: Request) -> Response:
        """Let an instrument measure that waits for a word."""
        return await self._act(request, lambda sitting, _: sitting.go())

    async def _undo(self, request: Request) -> Response:
        """Take the last stop back."""

        def undo(sitting: Sitting, _: Mapping[str, str]) -> None:
            """Take it back."""
            number = sitting.session.undo()
            key = "done_no_undo" if number is None else "done_undo"
            sitting.done = (key, {"stop": str(number)})

        return await self._act(request, undo)

    async def _skip(self, request: Request) -> Response:
        """Leave out the pose that was shown, if it is still the next."""

        def skip(sitting: Sitting, form: Mapping[str, str]) -> None:
            """Leave it out."""
            session = sitting.session
            if form.get("pose") == _pose_id(session, session.next()):
                session.skip()
                sitting.done = ("done_skip", {})

        return await self._act(request, skip)

    async def _note(self, request: Request) -> Response:
        """Write a note down."""

        def note(sitting: Sitting, form: Mapping[str, str]) -> None:
            """Write it."""
            if text := form.get("note", "").strip():
                sitting.session.note(text)
                sitting.done = ("done_note", {"text": text})

        return await self._act(request, note)

    async def _pause(self, request: Request) -> Response:
        """Pause and close the session, or open it and go on."""
        job = self._site.job_of(request)
        form = await receive_form(request)
        pauses, key = form.get("to") == "pause", form.get("key", "")

        def run() -> None:
            """Do it."""
            sittings = self._site.sittings
            sitting = sittings.start(job, self._begin(job), resumes=not pauses)
            sitting.once(key, lambda: sitting.pause(pauses=pauses))
            if is_paused(job):
                sittings.close(job)

        try:
            await run_in_threadpool(run)
        except PausedError:
            pass
        except CalibError as error:  # such as a session that another process has
            return self._show_paused(request, job, error=str(error))
        return self._site.to(job)

    async def _finish(self, request: Request) -> Response:
        """Calibrate by the stops that count: a job of its own, with the command that makes it."""
        job = self._site.job_of(request)
        form = await receive_form(request)
        t = self._site.sentences(request)

        def finish() -> Job | None:
            """Make the job and start it; None if there are too few stops."""
            session = self._sitting(job).session
            if session.state.stops < _FEWEST:
                return None
            made = self._calibration(job, form.get("key", ""))
            looked = look_for_session(job)
            robot = looked.value("robot_name") or looked.value("robot")
            commands = session_commands(made, robot, looked.value("xacro"), TABLE, _CELL)
            return self._site.runs.start(made, commands)

        try:
            made = await run_in_threadpool(finish)
        except PausedError:
            return self._site.to(job)
        if made is None:
            return await self._show(request, job, said=t("session_needs_more"))
        return self._site.to(made)

    def _calibration(self, job: Job, key: str) -> Job:
        """Make the job that calibrates by a session's files: its robot, its table and its cell."""
        desk, folder_of_session = self._site.desk, job.folder / SESSION
        choices = {name: value for name, value in job.choices.items() if name in _KEPT}
        choices |= {"table": TABLE, "cell": _CELL}
        with incoming(desk.folder) as folder:
            robots = [name for name in job.inputs if not name.lower().endswith(".toml")]
            files = {name: job.folder / name for name in robots}
            files |= {TABLE: folder_of_session / TABLE, _CELL: folder_of_session / SESSION_CELL}
            for name, path in files.items():
                (folder / name).write_bytes(read_bytes(path, "The file"))
            received = Received(folder, {}, tuple(files))
            return desk.make(Kind.CALIBRATE, job.name.partition("-")[2], key, received, choices)


def _aim(looked: Looked) -> Aim:
    """Return the aim of a setup; CalibError if there is none of this kind."""
    if aim := looked.value("aim"):
        return Aim(parse_length(aim, "aim", "0.1 mm"))
    return Aim(poses=_poses(looked))


def _poses(looked: Looked) -> int:
    """Return the number of poses at random of a setup; CalibError if it is none."""
    poses = looked.value("poses")
    if not (poses.isdecimal() and len(poses) < 5):
        raise CalibError(f"'{poses}' is no number of poses; give one such as 40.")
    return Aim(poses=int(poses)).poses


def _faults(looked: Looked) -> Iterator[tuple[str, str]]:
    """Yield the fields of a setup whose values are wrong, with what is wrong."""
    value = looked.value
    checks: Mapping[str, Callable[[], object]] = {
        "aim": lambda: value("aim") and _aim(looked),
        "poses": lambda: value("aim") or _poses(looked),
        "noise": lambda: value("noise") and parse_length(value("noise"), "noise", "0.03 mm"),
        "target": lambda: value("target") and parse_point(value("target"), "target"),
        "reader": lambda: check_devices(value("reader"), ""),
        "controller": lambda: check_devices("", value("controller")),
    }
    yield from ((name, fault) for name, check in checks.items() if (fault := _fault(check)))


def _fault(check: Callable[[], object]) -> str:
    """Return what a check finds wrong; empty for nothing."""
    try:
        check()
    except CalibError as error:
        return str(error)
    return ""


def _pose_id(session: Session, pose: NextPose | None) -> str:
    """Return what tells a proposed pose from another one, and from the same one at another stop."""
    if pose is None:
        return ""
    data = f"{len(session.stops)} {[round(value, 9) for value in pose.joints.tolist()]}"
    return hashlib.sha256(data.encode()).hexdigest()[:16]


def _typed_rows(
    form: Mapping[str, str], sitting: Sitting, fault: Callable[[str], str]
) -> list[tuple[str, list[str]]]:
    """Return what was typed of each target, with decimal points; NotAddedError for what is no number, or lacks."""
    rows = []
    for target in sitting.targets:
        texts = [form.get(f"value:{target}:{header}", "").strip() for header in sitting.headers]
        if not any(texts):
            continue
        values = [text.replace(",", ".") for text in texts]
        for text, value in zip(texts, values, strict=True):
            if not _NUMBER.fullmatch(value):
                raise NotAddedError(fault(text))
        rows.append((target, values))
    if not rows:
        raise NotAddedError(fault(""))
    return rows
