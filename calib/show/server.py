"""A page served to the browsers of this computer, and messages to its windows, from a thread of this process.

It listens on 127.0.0.1 only and on one port, for page and messages alike; no other process is started. Pages of other
web sites, which the same browser may show, reach neither: who asks for another host, or comes from another origin, is
refused.
"""

from __future__ import annotations

import asyncio
import atexit
import errno
import socket
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import TracebackType

from tornado.httpserver import HTTPServer
from tornado.web import Application, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from calib.errors import CalibError

Message = bytes | str

#: The only address listened on: other computers cannot reach it.
HOST = "127.0.0.1"

#: A window that is this far behind, in bytes, is closed: nothing else bounds what is kept for it.
_FARTHEST_BEHIND = 256 * 2**20

#: How long windows have to answer that they close, [s].
_FAREWELL = 0.5


def _nothing() -> Sequence[Message]:
    """What a new window is told if nothing else is said."""
    return ()


class PageServer:
    """One page at ``url``, and what `send` is given to all windows that show it.

    Args:
        page: The page, UTF-8. Its script connects to ``ws://${location.host}/live``.
        port: Where to listen; 0 for any port that is free.
        welcome: The messages that a window gets first, called in the server's thread when one opens. A message that
            is sent while a window opens may reach it twice, and is never lost.

    Raises:
        CalibError: The port is in use, or may not be used.
    """

    def __init__(
        self,
        page: bytes,
        *,
        port: int = 0,
        welcome: Callable[[], Sequence[Message]] = _nothing,
    ) -> None:
        self._socket = _listening(port)
        self.port: int = self._socket.getsockname()[1]
        self.url = f"http://{HOST}:{self.port}/"
        self._page = page
        self._welcome = welcome
        self._windows: set[_Window] = set()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"calib {self.url}", daemon=True)
        self._thread.start()
        self._ready.wait()
        # Otherwise the interpreter would take the thread away from under its sockets.
        atexit.register(self.close)

    @property
    def windows(self) -> int:
        """How many windows show the page now."""
        return len(self._windows)

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return not self._thread.is_alive()

    def send(self, message: Message) -> None:
        """Send to all windows, from any thread, without waiting for them.

        Args:
            message: Bytes for the viewer, text for the page's own script.

        Raises:
            CalibError: The server is closed.
        """
        try:
            self._loop.call_soon_threadsafe(self._broadcast, message)
        except RuntimeError as error:
            text = f"{self.url} was closed, and shows nothing any more; open a new one."
            raise CalibError(text) from error

    def close(self) -> None:
        """Close the windows' connections, free the port and end the thread; once closed, it does nothing."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()
        atexit.unregister(self.close)

    def wait(self) -> None:
        """Wait for Ctrl-C, or for another thread to close the server; it is closed afterwards."""
        try:
            while self._thread.is_alive():
                # A join without end cannot be interrupted on every system.
                self._thread.join(0.5)
        except KeyboardInterrupt:
            pass
        finally:
            self.close()

    def __enter__(self) -> PageServer:
        """The server, to be closed at the end of the block."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close it."""
        self.close()

    def __repr__(self) -> str:
        """Where it is, and whether it still is."""
        return f"<PageServer {'closed' if self.closed else self.url}>"

    def _run(self) -> None:
        """The thread."""
        try:
            asyncio.run(self._serve())
        finally:
            self._socket.close()
            self._ready.set()

    async def _serve(self) -> None:
        """Answer until asked to stop, then leave nothing open."""
        self._loop = asyncio.get_running_loop()
        self._stop = asyncio.Event()
        application = Application(
            [("/", _Page, {"server": self}), ("/live", _Window, {"server": self})],
            default_handler_class=_Elsewhere,
            default_handler_args={"server": self},
            # A program that prints its own results must not have requests among them.
            log_function=_say_nothing,
            # Windows have nothing to tell.
            websocket_max_message_size=2**10,
        )
        http = HTTPServer(application, max_body_size=2**10)
        http.add_socket(self._socket)
        self._ready.set()
        await self._stop.wait()
        http.stop()
        for window in tuple(self._windows):
            window.close(1001, "closed")
        end = self._loop.time() + _FAREWELL
        while self._windows and self._loop.time() < end:
            await asyncio.sleep(0.005)
        for window in tuple(self._windows):
            window.abort()
        await http.close_all_connections()

    def _broadcast(self, message: Message) -> None:
        """Send to all windows; in the server's thread."""
        for window in tuple(self._windows):
            window.take(message)


class _Guarded(RequestHandler):
    """Answers those that mean this server, and are of its own page."""

    def initialize(self, server: PageServer) -> None:
        """Keep the server; called by tornado."""
        self.server = server

    def set_default_headers(self) -> None:
        """Nothing of it is kept, guessed at, or shown within other pages."""
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("X-Frame-Options", "SAMEORIGIN")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("Referrer-Policy", "no-referrer")

    def prepare(self) -> None:
        """Refuse another host's name and another page's origin.

        A web site may let its own name point to 127.0.0.1; the browser then takes this server for a part of it.
        """
        port = self.server.port
        allowed = {f"{HOST}:{port}", f"localhost:{port}"}
        if port == 80:
            allowed |= {HOST, "localhost"}
        if self.request.host.lower() not in allowed:
            self._refuse(
                f"This page is at {self.server.url} only. To see it from another computer, forward the same port "
                f"there: ssh -L {port}:{HOST}:{port}."
            )
            return
        origin = self.request.headers.get("Origin")
        needed = self.request.path == "/live"
        if (origin is not None or needed) and origin != f"http://{self.request.host}":
            self._refuse("Other pages have no access.")

    def _refuse(self, reason: str) -> None:
        """Answer 403 with a reason."""
        self.set_status(403)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(reason + "\n")


class _Page(_Guarded):
    """The page."""

    def get(self) -> None:
        """The page itself."""
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(self.server._page)


class _Elsewhere(_Guarded):
    """Every other address."""

    def prepare(self) -> None:
        """Answer 404, whatever was asked."""
        super().prepare()
        if not self._finished:
            self.set_status(404)
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            self.finish("There is nothing here.\n")


class _Window(_Guarded, WebSocketHandler):
    """A window that shows the page."""

    _behind = 0

    def open(self, *_args: str, **_kwargs: str) -> None:
        """Say what a new window is told first, and go on with what all are told."""
        for message in self.server._welcome():
            self.take(message)
        self.server._windows.add(self)

    def on_message(self, message: Message) -> None:
        """Windows have nothing to tell."""

    def on_close(self) -> None:
        """Forget it."""
        self.server._windows.discard(self)

    def take(self, message: Message) -> None:
        """Send to this window, or give it up if it does not follow."""
        size = len(message)
        if self._behind and self._behind + size > _FARTHEST_BEHIND:
            self.abort()
            return
        try:
            sent = self.write_message(message, binary=isinstance(message, bytes))
        except WebSocketClosedError:
            return
        self._behind += size

        def done(future: asyncio.Future[None]) -> None:
            """It is sent, or the window has gone."""
            self._behind -= size
            if not future.cancelled():
                future.exception()

        sent.add_done_callback(done)

    def abort(self) -> None:
        """Close the connection without waiting for an answer."""
        self.server._windows.discard(self)
        if self.ws_connection is not None and self.ws_connection.stream is not None:
            self.ws_connection.stream.close()


def _say_nothing(_handler: RequestHandler) -> None:
    """Requests are not logged."""


def _listening(port: int) -> socket.socket:
    """A socket that listens.

    Raises:
        CalibError: It cannot.
    """
    if not 0 <= port <= 65535:
        message = f"The port was given as {port}; give a number from 1024 to 65535, or 0 for any that is free."
        raise CalibError(message)
    try:
        listener = socket.create_server((HOST, port))
    except OSError as error:
        reasons = {
            errno.EADDRINUSE: "is in use by another program",
            errno.EACCES: "needs the rights of an administrator",
        }
        why = reasons.get(error.errno or 0, f"cannot be listened on ({error.strerror})")
        message = f"Port {port} of {HOST} {why}; give another number, or 0 (--port 0) for any that is free."
        raise CalibError(message) from error
    listener.setblocking(False)
    return listener
