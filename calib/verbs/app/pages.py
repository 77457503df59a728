"""The pages of the app: what each shows and does. Whatever changes something leads to a page by a redirection.

State is on disk (`calib.verbs.app.desk`), so that a page may be loaded again at any time, and by several browsers. A
form that makes something carries a key, by which a form that is sent twice is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any
from urllib.parse import quote

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Route

from calib.basics.files import read_bytes, write_atomically
from calib.basics.progress import Stage
from calib.basics.tables import Table
from calib.errors import CalibError
from calib.example import paper_measurements, paper_urdf
from calib.result.calibration import Calibration
from calib.robot.urdf import known_robots
from calib.verbs.app.checked import checked_of
from calib.verbs.app.choices import check_no_plugins, choices_of
from calib.verbs.app.commands import calibration_commands, cell_text, check_commands, poses_commands
from calib.verbs.app.desk import title_of
from calib.verbs.app.guesses import look
from calib.verbs.app.job import (
    CELL,
    CHECKED,
    PICTURES,
    POSES,
    RESULT,
    Command,
    Job,
    Kind,
    command_text,
)
from calib.verbs.app.lookup import line_of, robots_of, stored_results
from calib.verbs.app.measure_pages import MeasurePages
from calib.verbs.app.outcome import MOST_OUTLIERS, Outcome, read_outcome
from calib.verbs.app.runs import StageDone, State, messages, printed, stages_of, state_of
from calib.verbs.app.sentences import Sentences, languages
from calib.verbs.app.site import LANGUAGE, PAGES, THEME, THEMES, Site, check_robot_name
from calib.verbs.app.uploads import (
    Received,
    UploadError,
    incoming,
    is_picture,
    receive_form,
    receive_upload,
)
from calib.verbs.history.history import history
from calib.verbs.inspect.folder import What, look_into

#: How long a browser keeps language and brightness [s]: a year.
_KEPT = 31_536_000

#: Files of the app itself.
_STATIC: Mapping[str, str] = {"app.css": "text/css", "app.js": "text/javascript"}

#: Pages that commands write, which are shown; each runs at most its own script, and is no page of the app's.
_SHOWN: Mapping[str, str] = {
    "view.html": "sandbox allow-scripts; frame-ancestors 'self'",
    "report.html": "sandbox; frame-ancestors 'self'",
    "corners.html": "sandbox; frame-ancestors 'self'",
}

#: Stages of each kind of job, in order; those of a check are not told.
_STAGES: Mapping[Kind, tuple[Stage, ...]] = {
    Kind.CALIBRATE: (
        *(Stage.READING, Stage.MISTAKES, Stage.MODELS),
        *(Stage.FOLDS, Stage.VERDICT, Stage.WRITING),
    ),
    Kind.CHECK: (),
    Kind.POSES: (),
    Kind.MEASURE: (),
}

#: Name of the table beside pictures that are checked.
_JOINTS = "joints.csv"

#: Results that are kept in memory, the latest ones.
_MOST_KEPT = 8


class Pages:
    """The pages over a folder."""

    def __init__(self, site: Site) -> None:
        """Show the pages of a site."""
        self._site, self._desk, self._runs = site, site.desk, site.runs
        self._sessions = MeasurePages(site)
        self._outcomes: dict[tuple[Path, int], Outcome] = {}

    @property
    def routes(self) -> list[BaseRoute]:
        """The addresses of the pages."""
        return [
            Route("/", self._home),
            Route("/open", self._open, methods=["GET"]),
            Route("/open", self._take, methods=["POST"]),
            Route("/example", self._example, methods=["POST"]),
            Route("/jobs/{job}", self._job),
            Route("/jobs/{job}/choose", self._choose, methods=["POST"]),
            Route("/jobs/{job}/files", self._add, methods=["POST"]),
            Route("/jobs/{job}/drop", self._drop, methods=["POST"]),
            Route("/jobs/{job}/progress", self._progress),
            Route("/jobs/{job}/cancel", self._cancel, methods=["POST"]),
            Route("/jobs/{job}/again", self._again, methods=["POST"]),
            Route("/jobs/{job}/remove", self._remove, methods=["POST"]),
            Route("/jobs/{job}/files/{file:path}", self._file),
            *self._sessions.routes,
            Route("/check", self._check, methods=["GET"]),
            Route("/check", self._start_check, methods=["POST"]),
            Route("/check/poses", self._start_poses, methods=["POST"]),
            Route("/history", self._history),
            Route("/history/{run}/{file}", self._of_history),
            Route("/preferences", self._prefer, methods=["POST"]),
            Route("/static/{file}", self._static),
        ]

    async def _home(self, request: Request) -> Response:  # noqa: ARG002
        """Lead to the first page."""
        return RedirectResponse("/open", 303)

    async def _prefer(self, request: Request) -> Response:
        """Keep language and brightness in the browser."""
        form = await receive_form(request)
        to = form.get("to", "/")
        known = [path for _, path in PAGES]
        if to not in known and not (to.startswith("/jobs/") and to.count("/") == 2):
            to = "/open"
        answer = RedirectResponse(quote(to), 303)
        for cookie, value, allowed in (
            (LANGUAGE, form.get("language", ""), tuple(languages())),
            (THEME, form.get("theme", ""), THEMES),
        ):
            if value in allowed:
                answer.set_cookie(cookie, value, max_age=_KEPT, httponly=True, samesite="lax")
        return answer

    async def _static(self, request: Request) -> Response:
        """Send a file of the app itself."""
        name = request.path_params["file"]
        if name not in _STATIC:
            raise HTTPException(404)
        headers = {"cache-control": "no-cache"}
        path = Path(__file__).parent / "static" / name
        return FileResponse(path, media_type=_STATIC[name], headers=headers)

    # Open

    async def _open(self, request: Request) -> Response:
        """Show where files are dropped, and the jobs so far."""

        def read() -> Mapping[str, Any]:
            """Read the jobs."""
            return {"jobs": self._site.listed(), "robots": known_robots()}

        return self._site.draw(request, "open.html.j2", "open", **await run_in_threadpool(read))

    async def _take(self, request: Request) -> Response:
        """Make a job of the files that were sent, or of a robot's name."""
        with incoming(self._desk.folder) as folder:
            received = await receive_upload(request, folder)
            robot = received.fields.get("robot_name", "").strip()

            def make() -> Job:
                """Make the job."""
                check_robot_name(robot)
                check_no_plugins(received)
                if not received.files and not robot:
                    raise UploadError("No file was chosen; choose the robot and its measurements.")
                title = title_of(received.files, robot)
                key = received.fields.get("key", "")
                choices = {"robot_name": robot} if robot else {}
                return self._desk.make(Kind.CALIBRATE, title, key, received, choices)

            return self._site.to(await run_in_threadpool(make))

    async def _example(self, request: Request) -> Response:
        """Make a job of the paper's UR3."""
        form = await receive_form(request)

        def make() -> Job:
            """Copy the files, and make the job."""
            with incoming(self._desk.folder) as folder:
                for path in (paper_urdf(), paper_measurements()):
                    (folder / path.name).write_bytes(read_bytes(path, "The example"))
                names = (paper_urdf().name, paper_measurements().name)
                received = Received(folder, {}, names)
                return self._desk.make(Kind.CALIBRATE, "ur3-example", form.get("key", ""), received)

        return self._site.to(await run_in_threadpool(make))

    async def _add(self, request: Request) -> Response:
        """Add files to a job that was not started."""
        job = self._site.job_of(request)
        with incoming(self._desk.folder) as folder:
            received = await receive_upload(request, folder)

            def add() -> None:
                """Add them."""
                check_no_plugins(received)
                if state_of(job) is State.DRAFT:
                    self._desk.add(job, received)

            await run_in_threadpool(add)
        return self._site.to(job)

    async def _drop(self, request: Request) -> Response:
        """Remove a file of a job that was not started."""
        job = self._site.job_of(request)
        form = await receive_form(request)
        if state_of(job) is State.DRAFT:
            await run_in_threadpool(self._desk.drop, job, form.get("name", ""))
        return self._site.to(job)

    async def _choose(self, request: Request) -> Response:
        """Keep what was chosen, and calibrate if that was asked for."""
        job = self._site.job_of(request)
        form = await receive_form(request)
        if job.kind is Kind.MEASURE:
            return await self._sessions.choose(request, job, form)

        def choose() -> Response | None:
            """Keep the choices; start the job if it is ready."""
            if state_of(job) is not State.DRAFT:
                return None
            check_robot_name(form.get("robot_name", "").strip())
            chosen = job.with_choices(choices_of(job, form)).write()
            if form.get("action") != "calibrate":
                return None
            looked = look(chosen)
            if not looked.is_ready:
                return None  # the page says why
            text = cell_text(looked)
            commands = calibration_commands(chosen, looked)
            if text and not looked.value("cell"):
                write_atomically(chosen.folder / CELL, text.encode(), overwrite=True)
            self._runs.start(chosen, commands)
            return None

        await run_in_threadpool(choose)
        return self._site.to(job)

    # A job

    async def _job(self, request: Request) -> Response:
        """Show a job: how its files are read, how far it is, or what came out."""
        job = self._site.job_of(request)
        if job.kind is Kind.MEASURE:
            return await self._sessions.page(request, job)
        state = state_of(job)
        page = "open" if job.kind is Kind.CALIBRATE else "check"
        t = self._site.sentences(request)
        if state is State.DRAFT and job.kind is Kind.CALIBRATE:
            words = await run_in_threadpool(self._draft_words, job)
            return self._site.draw(request, "draft.html.j2", page, job=job, **words)
        cell = _cell_of(job)
        if state is State.RUNNING:
            stages = _shown_stages(job, t)
            return self._site.draw(request, "run.html.j2", page, job=job, stages=stages, cell=cell)
        if state is not State.DONE:
            return self._site.draw(
                request,
                "ended.html.j2",
                page,
                job=job,
                state=state,
                messages=messages(job),
                cell=cell,
            )
        words = {"job": job, "cell": cell, "printed": printed(job)}
        if job.kind is Kind.CALIBRATE:
            outcome = await run_in_threadpool(self._outcome, job.folder / RESULT)
            return self._site.draw(
                request, "result.html.j2", page, outcome=outcome, most=MOST_OUTLIERS, **words
            )
        if job.kind is Kind.CHECK:
            path, date = await run_in_threadpool(self._checked_result, job)
            result = await run_in_threadpool(self._outcome, path)
            check = checked_of(job.folder / CHECKED, result.result, date, t)
            return self._site.draw(request, "checked.html.j2", page, check=check, **words)
        table = await run_in_threadpool(Table.read, job.folder / POSES)
        chosen = job.choices.get("result", "")
        return self._site.draw(
            request,
            "poses.html.j2",
            page,
            header=table.header,
            rows=table.cells,
            chosen=chosen,
            **words,
        )

    def _draft_words(self, job: Job) -> Mapping[str, Any]:
        """Look at the files of a job, for its page."""
        looked = look(job)
        commands: list[str] = []
        cell = error = ""
        try:
            if looked.is_ready:
                commands = [command_text(words) for words in calibration_commands(job, looked)]
                cell = "" if looked.value("cell") else cell_text(looked)
        except CalibError as fault:
            error = str(fault)
        return {
            "looked": looked,
            "doubts": sum(bool(one.doubt) for one in looked.fields.values()),
            "shown": [file for file in looked.files if not is_picture(file.name)],
            "pictures": sum(is_picture(file.name) for file in looked.files),
            "commands": commands,
            "cell": cell,
            "error": error,
        }

    def _outcome(self, path: Path) -> Outcome:
        """Return a result for its page; the latest ones are kept."""
        key = (path, path.stat().st_mtime_ns)
        if key not in self._outcomes:
            while len(self._outcomes) >= _MOST_KEPT:
                self._outcomes.pop(next(iter(self._outcomes)))
            self._outcomes[key] = read_outcome(path)
        return self._outcomes[key]

    def _checked_result(self, job: Job) -> tuple[Path, str]:
        """Return the file and the date of the result that a job checks; CalibError if it is no longer there."""
        for one in stored_results(self._desk.folder):
            if one.path == job.choices.get("result"):
                return self._desk.folder / one.path, one.date.strftime("%Y-%m-%d")
        raise CalibError("The calibration that was checked is no longer in the folder.")

    async def _progress(self, request: Request) -> Response:
        """Send how far a job is, as a part of its page, and its state."""
        job = self._site.job_of(request)
        stages = _shown_stages(job, self._site.sentences(request))
        answer = self._site.draw(request, "progress.html.j2", "", job=job, stages=stages)
        answer.headers["x-state"] = state_of(job).value
        return answer

    async def _cancel(self, request: Request) -> Response:
        """Break off a job."""
        job = self._site.job_of(request)
        await receive_form(request)
        await run_in_threadpool(self._runs.cancel, job)
        return self._site.to(job)

    async def _again(self, request: Request) -> Response:
        """Make a job of the same files, to change how they are read."""
        job = self._site.job_of(request)
        form = await receive_form(request)
        if job.kind is not Kind.CALIBRATE:
            return RedirectResponse("/measure" if job.kind is Kind.MEASURE else "/check", 303)
        return self._site.to(await run_in_threadpool(self._desk.again, job, form.get("key", "")))

    async def _remove(self, request: Request) -> Response:
        """Remove a job with its files."""
        job = self._site.job_of(request)
        await receive_form(request)

        def remove() -> None:
            """Break it off, and remove its folder."""
            self._site.sittings.close(job)
            self._runs.cancel(job)
            self._desk.remove(job)

        await run_in_threadpool(remove)
        return RedirectResponse("/open", 303)

    async def _file(self, request: Request) -> Response:
        """Send a file of a job, by a name that the job knows: its pages to be shown, all others to be kept."""
        job = self._site.job_of(request)
        name = request.path_params["file"]
        path = job.files.get(name)
        if path is None:
            raise HTTPException(404)
        if name in _SHOWN and "download" not in request.query_params:
            headers = {"content-security-policy": _SHOWN[name], "x-frame-options": "SAMEORIGIN"}
            return FileResponse(path, media_type="text/html", headers=headers)
        headers = {"content-security-policy": "sandbox; default-src 'none'"}
        return FileResponse(
            path, media_type="application/octet-stream", filename=path.name, headers=headers
        )

    # Check

    async def _check(self, request: Request, error: str = "") -> Response:
        """Show where fresh rows are dropped."""
        found = await run_in_threadpool(stored_results, self._desk.folder)
        chosen = request.query_params.get("result", "")
        return self._site.draw(
            request,
            "check.html.j2",
            "check",
            status=400 if error else 200,
            found=found,
            chosen=chosen,
            error=error,
        )

    def _result_of(self, name: str) -> Path:
        """Return the file of a stored result, by a name that the folder knows; CalibError if there is none."""
        for one in stored_results(self._desk.folder):
            if one.path == name:
                return self._desk.folder / one.path
        raise CalibError("There is no such calibration in the folder; choose one from the list.")

    def _begin(self, job: Job, commands: tuple[Command, ...]) -> Job:
        """Start a job that was just made; it is removed if it cannot start, and the error raised."""
        try:
            return self._runs.start(job, commands)
        except CalibError:
            self._desk.remove(job)
            raise

    async def _start_check(self, request: Request) -> Response:
        """Check a stored result by the rows that were sent."""
        with incoming(self._desk.folder) as folder:
            received = await receive_upload(request, folder)

            def start() -> Job:
                """Make the job and start it."""
                check_no_plugins(received)
                name = received.fields.get("result", "")
                path = self._result_of(name)
                called = Calibration.read_json(path)
                table, points = _fresh_rows(received)
                places = {}
                if any(map(is_picture, received.files)):
                    table, points, places = PICTURES, "", {table: f"{PICTURES}/{_JOINTS}"}
                job = self._desk.make(
                    Kind.CHECK,
                    f"check-{called.nominal.name}",
                    received.fields.get("key", ""),
                    received,
                    {"result": name},
                    places,
                )
                tolerance = received.fields.get("tolerance", "").strip()
                return self._begin(job, check_commands(job, path, called, table, points, tolerance))

            try:
                return self._site.to(await run_in_threadpool(start))
            except CalibError as error:
                return await self._check(request, str(error))

    async def _start_poses(self, request: Request) -> Response:
        """Choose poses at which to check a stored result."""
        form = await receive_form(request)

        def start() -> Job:
            """Make the job and start it."""
            name = form.get("result", "")
            path = self._result_of(name)
            text = form.get("count", "3").strip()
            count = int(text) if text.isdecimal() and len(text) < 3 else 0
            if not 1 <= count <= 20:
                raise CalibError(f"'{text}' poses: choose 1 to 20; three tell what has moved.")
            job = self._desk.make(
                Kind.POSES, "poses", form.get("key", ""), choices={"result": name}
            )
            return self._begin(job, poses_commands(job, path, count))

        try:
            return self._site.to(await run_in_threadpool(start))
        except CalibError as error:
            return await self._check(request, str(error))

    # History

    async def _history(self, request: Request) -> Response:
        """Show which calibration of each robot is valid."""

        def read() -> Mapping[str, Any]:
            """Read the folder."""
            found = history(self._desk.folder)
            of_robots = {e.result.path for entries in found.robots.values() for e in entries}
            without = [
                line_of(self._desk.folder, one)
                for one in stored_results(self._desk.folder)
                if one.path not in of_robots and not one.serial
            ]
            return {
                "robots": list(robots_of(found, datetime.now(timezone.utc))),
                "without": without,
                "summary": found.summary() if found.notes else "",
            }

        return self._site.draw(
            request, "history.html.j2", "history", **await run_in_threadpool(read)
        )

    async def _of_history(self, request: Request) -> Response:
        """Send the result of a run, or its corrected URDF, by the beginning of a run that the folder knows."""
        run, name = request.path_params["run"], request.path_params["file"]
        found = await run_in_threadpool(stored_results, self._desk.folder)
        one = next((one for one in found if line_of(self._desk.folder, one).run == run), None)
        if one is None or name not in ("result.json", "corrected.urdf"):
            raise HTTPException(404)
        path = self._desk.folder / one.path
        headers = {"content-security-policy": "sandbox; default-src 'none'"}
        if name == "result.json":
            kind = "application/octet-stream"
            return FileResponse(path, media_type=kind, filename=name, headers=headers)
        if not line_of(self._desk.folder, one).has_urdf:
            raise HTTPException(404)

        def urdf() -> bytes:
            """Write the URDF of the result again, in memory."""
            return Calibration.read_json(path).checked_urdf().data

        headers["content-disposition"] = f'attachment; filename="{name}"'
        data = await run_in_threadpool(urdf)
        return Response(data, media_type="application/octet-stream", headers=headers)


def _cell_of(job: Job) -> str:
    """Return the text of a job's cell file; empty without one."""
    try:
        return (job.folder / CELL).read_text(encoding="utf-8")
    except OSError:
        return ""


def _fresh_rows(received: Received) -> tuple[str, str]:
    """Return the table of fresh rows among files that were sent, and the list of points, empty for none.

    Raises CalibError if there is no table.
    """
    entries = look_into(received.folder).entries
    tables = [entry.path.name for entry in entries if entry.what is What.TABLE]
    lists = [entry.path.name for entry in entries if entry.what is What.POINTS]
    faulty = [entry.said for entry in entries if entry.what is What.FAULTY]
    if not tables:
        raise CalibError(
            faulty[0].replace(f"{received.folder}/", "")
            if faulty
            else "There is no table among the files; send the fresh rows, with a header like that of the calibration."
        )
    return tables[0], lists[0] if lists else ""


def _shown_stages(job: Job, t: Sentences) -> list[dict[str, Any]]:
    """Return the stages of a job, those that are over, the one at work, and those to come."""
    done = [stage for stage in stages_of(job) if stage.stage or not job.commands]
    expected: list[str] = []
    if len(job.commands) > 1:
        expected.append("corners")
    expected += [stage.value for stage in _STAGES[job.kind]]
    return [*_begun(job, done, t), *_to_come(expected, done)]


def _begun(job: Job, stages: list[StageDone], t: Sentences) -> list[dict[str, Any]]:
    """Return the stages that have begun."""
    shown = []
    for stage in stages:
        code = "corners" if len(job.commands) > 1 and stage.command == 0 else stage.stage
        left = None
        if stage.of and stage.done and not stage.is_over:
            left = round(stage.seconds / stage.done * (stage.of - stage.done))
        shown.append(
            {
                "code": code if t.has(f"stage_{code}") else "begin",
                "state": "done" if stage.is_over else "now",
                "seconds": round(stage.seconds, 1),
                "what": stage.what,
                "tried": stage.tried,
                "done": stage.done,
                "of": stage.of,
                "left": left,
            }
        )
    if not shown:
        shown.append(_still("begin", "now"))
    return shown


def _to_come(expected: list[str], begun: list[StageDone]) -> list[dict[str, Any]]:
    """Return the stages that have not begun."""
    reached = -1
    for stage in begun:
        code = "corners" if "corners" in expected and stage.command == 0 else stage.stage
        if code in expected:
            reached = max(reached, expected.index(code))
    return [_still(code, "later") for code in expected[reached + 1 :]]


def _still(code: str, state: str) -> dict[str, Any]:
    """Return a stage of which nothing is known yet."""
    return {
        "code": code,
        "state": state,
        "seconds": 0,
        "what": "",
        "tried": 0,
        "done": 0,
        "of": 0,
        "left": None,
    }
