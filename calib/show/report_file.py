"""Reports as files: a page in HTML, or the same page as PDF, which an installed browser prints.

calib lays out pages for a browser, and no other library prints them as a browser does. So a PDF needs one: Chromium,
Chrome or Edge, without a window, without the network, and with a profile of its own.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from calib.errors import CalibError, FileError
from calib.show.as_html import page_bytes
from calib.show.blocks import Page

#: Endings of names, in lower case.
_HTML = (".html", ".htm")
_PDF = ".pdf"

#: Programs of browsers that print.
_BROWSERS = (
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome"),
    *("microsoft-edge", "microsoft-edge-stable", "msedge"),
)

#: Where macOS and Windows have them, which no PATH names.
_MACOS = ("Google Chrome", "Chromium", "Microsoft Edge")
_WINDOWS = ("Google/Chrome/Application/chrome.exe", "Microsoft/Edge/Application/msedge.exe")

#: A page is printed within a few seconds [s].
_LONGEST = 180.0

_INSTEAD = "or let the name end in .html, and print the page from a browser"


def check_report(path: str | Path) -> None:
    """Refuse the name of a report that cannot be written, before the work begins.

    Raises:
        FileError: The name ends neither in .html or .htm nor in .pdf.
        CalibError: It ends in .pdf, and no browser is installed.
    """
    suffix = Path(path).suffix.lower()
    if suffix == _PDF:
        _browser()
    elif suffix not in _HTML:
        raise FileError(
            f"'{path}': a report is a page or a PDF; let the name end in .html or .pdf. The summary is its text."
        )


def report_bytes(page: Page, path: str | Path) -> bytes:
    """Return a page as a file of its name holds it: HTML, or a PDF that a browser prints.

    Args:
        page: The page.
        path: The file; a name that ends in .pdf is that of a PDF.

    Raises:
        CalibError: It has a figure, and matplotlib is not installed; or no browser is installed for a PDF, or the
            browser does not print.
    """
    html = page_bytes(page)
    return _printed(html) if Path(path).suffix.lower() == _PDF else html


def find_browser() -> str | None:
    """Return the program of a browser that can print; None if none is installed."""
    for name in _BROWSERS:
        found = shutil.which(name)
        if found is not None:
            return found
    places = [Path(f"/Applications/{name}.app/Contents/MacOS/{name}") for name in _MACOS]
    if sys.platform == "win32":
        folders = [
            os.environ.get(name) for name in ("PROGRAMFILES", "PROGRAMFILES(X86)", "LOCALAPPDATA")
        ]
        places = [Path(folder) / place for folder in folders if folder for place in _WINDOWS]
    return next((str(place) for place in places if place.is_file()), None)


def _browser() -> str:
    """Return the program of a browser; CalibError if none is installed."""
    program = find_browser()
    if program is None:
        raise CalibError(
            "A report as PDF is printed by a browser, and no Chromium, Chrome or Edge is installed. Install one "
            f"(Debian, Ubuntu: apt install chromium), {_INSTEAD}."
        )
    return program


def _printed(html: bytes) -> bytes:
    """Return a page as PDF; CalibError if there is no browser, or it does not print."""
    program = _browser()
    with TemporaryDirectory(prefix="calib-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        page, pdf = folder / "page.html", folder / "page.pdf"
        page.write_bytes(html)
        flags = [
            *("--headless", "--disable-gpu", "--no-first-run", "--disable-dev-shm-usage"),
            *("--no-pdf-header-footer", "--print-to-pdf-no-header"),
            # Nobody is called, by the page or by the browser.
            *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
            "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={folder / 'profile'}",
        ]
        if hasattr(os, "geteuid") and os.geteuid() == 0:  # it does not start for root otherwise
            flags.append("--no-sandbox")
        command = [program, *flags, f"--print-to-pdf={pdf}", page.as_uri()]
        try:
            subprocess.run(command, capture_output=True, timeout=_LONGEST, check=False)
            data = pdf.read_bytes()
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CalibError(
                f"The browser {program} did not print the report as PDF. Install another one, {_INSTEAD}."
            ) from error
    if not data.startswith(b"%PDF"):
        raise CalibError(f"The browser {program} printed no PDF. Install another one, {_INSTEAD}.")
    return data
