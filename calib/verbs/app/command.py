"""``calib app``: calibrate, check and look up in a browser."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from calib.cli.interrupt import left_to_the_program
from calib.cli.verb import verb
from calib.errors import CalibError, choices

#: Libraries of the extra.
_NEEDED = ("starlette", "uvicorn", "python_multipart")

#: Variables that are set on a Linux computer with a graphical browser.
_BROWSER_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


@verb("""Calibrate, check and look up in a browser, on this computer alone.

\b
Examples:
  calib app
  calib app robots --language de
  calib app --port 8800 --no-browser

Pages in the browser take the robot's URDF and the measurements, show how they are read, calibrate, and say what came
out; they check with a few fresh rows whether anything has moved, and show which calibration is valid. The server
listens on loopback only, and nothing leaves the computer. All files are kept in FOLDER, a folder for each job, with the
command that makes the same result. Ctrl-C ends it; what was done is there at the next start. See docs/app.md.
""")
def app(
    folder: Annotated[
        Path, typer.Argument(metavar="[FOLDER]", help="Folder of the jobs; it is made if missing.")
    ] = Path("calib-app"),
    *,
    port: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=0,
            max=65535,
            help="Port of 127.0.0.1; 0: any. Default: 8717, or any if it is taken.",
        ),
    ] = None,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the browser.")
    ] = True,
    language: Annotated[
        str | None,
        typer.Option(
            metavar="CODE", help="Language of the pages: en or de. Default: as the browser prefers."
        ),
    ] = None,
) -> None:
    """Check what is needed, and serve until Ctrl-C."""
    try:
        from calib.verbs.app.sentences import languages
        from calib.verbs.app.server import serve
    except ModuleNotFoundError as error:
        if error.name not in _NEEDED:
            raise
        raise CalibError(
            f"The app needs '{error.name}', which is not installed: pip install 'robot-calib[app]'."
        ) from error

    if language is not None and language not in languages():
        raise CalibError(
            f"There are no sentences in '{language}' (--language); there are {choices(languages())}."
        )

    def say(address: str) -> None:
        """Say where the pages are."""
        typer.echo(f"calib app: {address}\nFolder: {folder.resolve()}. Ctrl-C ends it.")
        sys.stdout.flush()

    has_windows = sys.platform in ("win32", "darwin")
    opens = browser and (has_windows or any(os.environ.get(name) for name in _BROWSER_VARIABLES))
    with left_to_the_program(), suppress(KeyboardInterrupt):  # which is how it is meant to end
        serve(folder, port, language, opens=opens, say=say)
    typer.echo("calib app: ended. What was done is in the folder.")
