"""Who may talk to the server: only pages of its own, on this computer, with the token of the printed address.

Other pages that a browser has open may send requests to a loopback address too. A request must therefore ask for the
server by an address of its own (against names that somebody else points at 127.0.0.1), come from a page of its own if
it changes anything, and carry the token as a cookie, which the printed address sets. Cookies of one host are shared by
all its ports, so the origin counts with its port.
"""

from __future__ import annotations

import hmac
from collections.abc import Iterable, Mapping
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

#: Methods that change nothing.
_READING = ("GET", "HEAD")

#: Parameter of the printed address that holds the token.
TOKEN = "token"

#: How long a browser keeps the token [s]: a year.
_KEPT = 31_536_000

#: A page loads what the server sends, runs its one script, and is framed by nobody.
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)

#: Headers of every answer that does not set them itself.
_HEADERS: Mapping[str, str] = {
    "content-security-policy": PAGE_POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    # With "no-referrer" a browser would hide the origin of the server's own forms.
    "referrer-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}


def hosts_of(port: int) -> tuple[str, ...]:
    """Return the hosts by which the server may be asked for, with its port."""
    return tuple(f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]"))


class Guard:
    """ASGI middleware that refuses all but the server's own pages, and adds the headers that keep them apart."""

    def __init__(self, app: ASGIApp, port: int, token: str) -> None:
        """Guard an application at a port, by a token."""
        self._app = app
        self._hosts = hosts_of(port)
        self._cookie = f"calib_app_{port}"
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or let the application answer it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":  # there are no sockets
            await send({"type": "websocket.close", "code": 1008})
            return

        async def send_with_headers(message: Message) -> None:
            """Add the headers that an answer lacks."""
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        answer = self._answer(scope)
        await (answer or self._app)(scope, receive, send_with_headers)

    def _answer(self, scope: Scope) -> Response | None:
        """Return the refusal of a request, or the redirection that sets the cookie; None: the application answers."""
        headers = Headers(scope=scope)
        fault = self._fault(scope["method"], headers)
        if fault:
            return PlainTextResponse(f"{fault}\n", 403)
        query = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        given = [value for name, value in query if name == TOKEN]
        if scope["method"] in _READING and any(map(self._is_token, given)):
            rest = urlencode([pair for pair in query if pair[0] != TOKEN])
            # Two slashes at the beginning would name another host.
            path = "/" + str(scope["path"]).lstrip("/\\")
            to_page = RedirectResponse(path + (f"?{rest}" if rest else ""), 303)
            to_page.set_cookie(
                self._cookie, self._token, max_age=_KEPT, httponly=True, samesite="lax"
            )
            return to_page
        if not self._has_token(headers.getlist("cookie")):
            return PlainTextResponse(
                "calib app: this page opens with the address that the terminal shows, "
                f"http://{self._hosts[0]}/?{TOKEN}=... Copy all of it into the browser.\n",
                403,
            )
        return None

    def _fault(self, method: str, headers: Headers) -> str:
        """Say why a request is none of the server's own pages'; empty if it may be."""
        hosts = headers.getlist("host")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return f"calib app: this server answers to http://{self._hosts[0]} only."
        site = headers.get("sec-fetch-site", "")
        origins = headers.getlist("origin")
        own = [f"http://{host}" for host in self._hosts]
        if method not in _READING:
            is_own = all(origin.lower() in own for origin in origins) if origins else False
            if not is_own and (origins or site != "same-origin"):
                return "calib app: refused, as it does not come from a page of calib."
        elif site in ("cross-site", "same-site") and headers.get("sec-fetch-mode") != "navigate":
            return "calib app: refused, as another page asks for it."
        return ""

    def _has_token(self, lines: Iterable[str]) -> bool:
        """Return True if a line of cookies has the token."""
        for line in lines:
            cookies = SimpleCookie()
            try:
                cookies.load(line)
            except CookieError:
                continue
            if self._cookie in cookies and self._is_token(cookies[self._cookie].value):
                return True
        return False

    def _is_token(self, text: str) -> bool:
        """Return True if a text is the token; how long this takes tells nothing of it."""
        return hmac.compare_digest(text.encode(), self._token.encode())
