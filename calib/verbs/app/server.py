"""The server: the pages behind the guard, on loopback, until Ctrl-C."""

from __future__ import annotations

import socket
import threading
import webbrowser
from collections.abc import Callable
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp

from calib.errors import CalibError
from calib.verbs.app.desk import Desk
from calib.verbs.app.guard import TOKEN, Guard
from calib.verbs.app.pages import Pages
from calib.verbs.app.site import Site

#: The only address that the server listens at.
ADDRESS = "127.0.0.1"

#: The port, unless another is asked for or this one is taken.
PORT = 8717

#: Connections that wait at most.
_BACKLOG = 128

#: Time that open requests have to end after Ctrl-C [s].
_GRACE = 1


def bind(port: int | None) -> socket.socket:
    """Return a socket that listens on loopback.

    Args:
        port: The port, 0 for any that is free; None: `PORT`, or any if that is taken.

    Raises:
        CalibError: The port is taken, or cannot be used.
    """
    for wanted in [port] if port is not None else [PORT, 0]:
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((ADDRESS, wanted))
            listening.listen(_BACKLOG)
        except OSError as error:
            listening.close()
            if port is not None:
                raise CalibError(
                    f"Port {port} of {ADDRESS} cannot be used: {error.strerror or error}. Name another one with "
                    "--port, or leave it out."
                ) from error
        else:
            return listening
    raise CalibError(f"No port of {ADDRESS} is free.")


def application(site: Site, port: int, token: str) -> ASGIApp:
    """Return the application: the pages behind the guard.

    Args:
        site: What is served.
        port: The port that it is asked for at.
        token: The token of its address.
    """
    handlers = {HTTPException: site.failed, CalibError: site.failed, Exception: site.failed}
    inner = Starlette(routes=Pages(site).routes, exception_handlers=handlers)
    return Guard(inner, port, token)


def server_of(app: ASGIApp) -> uvicorn.Server:
    """Return the server of an application: it prints nothing, and says nothing of itself."""
    config = uvicorn.Config(
        app,
        log_level="critical",
        access_log=False,
        lifespan="off",
        server_header=False,
        date_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=_GRACE,
        ws="none",
    )
    return uvicorn.Server(config)


def serve(
    folder: Path,
    port: int | None = None,
    language: str | None = None,
    *,
    opens: bool = True,
    say: Callable[[str], None],
) -> None:
    """Serve the pages of a folder until Ctrl-C.

    Args:
        folder: The folder of the jobs, which is made if it does not exist.
        port: As of `bind`.
        language: Code of the language of the pages; None: as each browser prefers.
        opens: Whether the address is opened in a browser.
        say: Called with the address.

    Raises:
        CalibError: The port is taken.
        FileError: The folder cannot be made or written.
    """
    site = Site(Desk(folder), language)
    token = site.desk.token()
    listening = bind(port)
    number = listening.getsockname()[1]
    address = f"http://{ADDRESS}:{number}/?{TOKEN}={token}"
    server = server_of(application(site, number, token))
    say(address)
    if opens:
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    try:
        server.run(sockets=[listening])
    finally:
        site.close()
        listening.close()
