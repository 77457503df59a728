"""What all pages share: the folder, the language and look of a request, templates, and errors in words."""

from __future__ import annotations

import secrets
import sys
import traceback
from pathlib import Path
from typing import Any
from urllib.parse import quote

import jinja2
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from calib.errors import CalibError, did_you_mean
from calib.robot.urdf import known_robots
from calib.verbs.app.desk import Desk
from calib.verbs.app.job import Job, Kind
from calib.verbs.app.runs import Runs, State, state_of
from calib.verbs.app.sentences import Sentences, accepted, languages, sentences_for
from calib.verbs.app.sitting import Sittings, is_begun
from calib.verbs.app.uploads import MOST_BYTES, MOST_OF_A_PICTURE, UploadError
from calib.version import __version__

#: The pages of the navigation, by the keys of their names.
PAGES = (("open", "/open"), ("measure", "/measure"), ("check", "/check"), ("history", "/history"))

#: Cookies of language and brightness.
LANGUAGE, THEME = "calib_language", "calib_theme"
THEMES = ("auto", "light", "dark")


class Site:
    """The folder that is served, and how its pages are drawn."""

    def __init__(self, desk: Desk, language: str | None) -> None:
        """Serve the jobs of a desk.

        Args:
            desk: The folder with the jobs.
            language: Code of the language of browsers that did not choose one; None: as each prefers.
        """
        self.desk, self.runs, self.sittings = desk, Runs(), Sittings()
        self._language = language
        self._jinja = jinja2.Environment(
            loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
            autoescape=True,
            trim_blocks=True,
            undefined=jinja2.StrictUndefined,
        )
        self._jinja.tests["search_column"] = lambda name: str(name).startswith("column:")

    def close(self) -> None:
        """End the runs, and close the sessions."""
        self.sittings.close_all()
        self.runs.close()

    def sentences(self, request: Request) -> Sentences:
        """Return the sentences of a request: as switched on the page, as started, or as the browser prefers."""
        wanted = accepted(request.headers.get("accept-language", ""))
        return sentences_for(request.cookies.get(LANGUAGE), self._language, *wanted)

    def draw(
        self,
        request: Request,
        template: str,
        page: str,
        *,
        status: int = 200,
        **words: Any,  # noqa: ANN401
    ) -> HTMLResponse:
        """Fill in a template.

        Args:
            request: The request.
            template: Name of the template.
            page: Key of the page that the navigation marks; empty: none.
            status: Status of the answer.
            words: Further words of the template.
        """
        theme = request.cookies.get(THEME, THEMES[0])
        html = self._jinja.get_template(template).render(
            t=self.sentences(request),
            theme=theme if theme in THEMES else THEMES[0],
            languages=languages(),
            pages=PAGES,
            page=page,
            here=request.url.path if request.method == "GET" else "/",
            folder=str(self.desk.folder),
            version=__version__,
            key=secrets.token_hex(12),
            limits={"table": MOST_BYTES, "picture": MOST_OF_A_PICTURE},
            **words,
        )
        return HTMLResponse(html, status)

    async def failed(self, request: Request, error: Exception) -> Response:
        """Answer a request that ended with an error: what was wrong and how to mend it, never a traceback."""
        t = self.sentences(request)
        back = "/open"
        if isinstance(error, HTTPException):
            text = t("not_found") if error.status_code == 404 else str(error.detail)
            return self.draw(
                request,
                "error.html.j2",
                "",
                status=error.status_code,
                text=text,
                said="",
                back=back,
            )
        if isinstance(error, CalibError):
            status = error.status if isinstance(error, UploadError) else 400
            return self.draw(
                request, "error.html.j2", "", status=status, text="", said=str(error), back=back
            )
        traceback.print_exception(error, file=sys.stderr)  # on the terminal
        text = t("internal", error=type(error).__name__)
        return self.draw(request, "error.html.j2", "", status=500, text=text, said="", back=back)

    def job_of(self, request: Request) -> Job:
        """Return the job that an address names; HTTPException if there is none."""
        try:
            return self.desk.job(request.path_params["job"])
        except CalibError as error:
            raise HTTPException(404) from error

    def listed(self) -> list[tuple[Job, State]]:
        """Return the jobs with their states, the latest first; a session that was begun goes on."""
        return [
            (job, State.RUNNING if job.kind is Kind.MEASURE and is_begun(job) else state_of(job))
            for job in self.desk.jobs()
        ]

    @staticmethod
    def to(job: Job) -> Response:
        """Lead to the page of a job."""
        return RedirectResponse(f"/jobs/{quote(job.name)}", 303)


def check_robot_name(name: str) -> None:
    """Refuse the name of a robot that calib does not know: a path is none, as files are sent."""
    known = known_robots()
    if name and name.casefold() not in {one.casefold() for one in known}:
        raise CalibError(
            f"There is no robot '{name}' that calib knows by its name{did_you_mean(name, known)}. Send its URDF, "
            "xacro or DH rows as a file."
        )
