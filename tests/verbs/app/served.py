"""The app as it is served: real sockets, real processes, and a client that sends what a browser sends."""

from __future__ import annotations

import html
import http.client
import re
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlencode

from calib.verbs.app.desk import Desk
from calib.verbs.app.server import ADDRESS, application, bind, server_of
from calib.verbs.app.site import Site

BOUNDARY = "----calibtest"

#: Files of an upload: field, name and content of each.
Parts = Sequence[tuple[str, str, bytes]]


@dataclass(frozen=True)
class Answer:
    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def text(self) -> str:
        """The page with its entities as characters."""
        return html.unescape(self.body.decode("utf-8"))

    @property
    def to(self) -> str:
        return self.headers.get("location", "")

    def key(self, form: int = 0) -> str:
        """The hidden key of a form."""
        return str(re.findall(r'name="key" value="([^"]+)"', self.text)[form])


@dataclass
class Client:
    """A browser: it keeps the cookie and says where its forms come from."""

    port: int
    token: str
    folder: Path
    cookies: dict[str, str] = field(default_factory=dict)

    @property
    def host(self) -> str:
        return f"{ADDRESS}:{self.port}"

    def enter(self) -> Client:
        """Open the printed address."""
        answer = self.get(f"/?token={self.token}")
        assert answer.status == 303, answer.body
        name, _, rest = answer.headers["set-cookie"].partition("=")
        self.cookies[name] = rest.partition(";")[0]
        return self

    def ask(
        self,
        method: str,
        path: str,
        body: bytes | Iterator[bytes] | None = None,
        headers: Mapping[str, str | None] | None = None,
    ) -> Answer:
        """Send a request; a header that is None is left out."""
        sent: dict[str, str | None] = {"Host": self.host}
        if self.cookies:
            sent["Cookie"] = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        if method == "POST":
            sent["Origin"] = f"http://{self.host}"
        sent |= headers or {}
        connection = http.client.HTTPConnection(ADDRESS, self.port, timeout=60)
        try:
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in sent.items():
                if value is not None:
                    connection.putheader(name, value)
            is_chunked = body is not None and not isinstance(body, bytes)
            if isinstance(body, bytes):
                connection.putheader("Content-Length", str(len(body)))
            if is_chunked and sent.get("Content-Length") is None:
                connection.putheader("Transfer-Encoding", "chunked")
            connection.endheaders(
                body, encode_chunked=is_chunked and sent.get("Content-Length") is None
            )
            answer = connection.getresponse()
            found = {name.lower(): value for name, value in answer.getheaders()}
            return Answer(answer.status, found, answer.read())
        finally:
            connection.close()

    def get(self, path: str, **headers: str) -> Answer:
        return self.ask("GET", path, headers=headers)

    def post(self, path: str, **fields: str) -> Answer:
        """Send a form."""
        kind = "application/x-www-form-urlencoded"
        return self.ask("POST", path, urlencode(fields).encode(), {"Content-Type": kind})

    def form(self, path: str, fields: Mapping[str, str]) -> Answer:
        """Send a form whose fields have any names."""
        return self.post(path, **fields)

    def upload(self, path: str, parts: Parts, **fields: str) -> Answer:
        """Send files, as a browser does."""
        return self.ask("POST", path, upload_body(parts, fields), upload_headers())

    def open(self, *files: Path | tuple[str, bytes], **fields: str) -> str:
        """Make a job of files; its address."""
        parts = [
            file if isinstance(file, tuple) else (file.name, file.read_bytes()) for file in files
        ]
        answer = self.upload("/open", [("files", *part) for part in parts], **fields)
        assert answer.status == 303, answer.text
        return answer.to

    def wait(self, job: str, timeout: float = 120.0) -> str:
        """The state of a job once it is over."""
        end = time.monotonic() + timeout
        while (state := self.get(f"{job}/progress").headers["x-state"]) == "running":
            assert time.monotonic() < end, "the job takes too long"
            time.sleep(0.1)
        return state


def upload_headers() -> dict[str, str | None]:
    return {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}


def upload_body(parts: Parts, fields: Mapping[str, str]) -> bytes:
    pieces = []
    for name, value in fields.items():
        pieces.append(
            f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n{value}\r\n'.encode()
        )
    for name, file, content in parts:
        head = (
            f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="{name}"; filename="{file}"\r\n'
            "Content-Type: application/octet-stream\r\n\r\n"
        )
        pieces += [head.encode(), content, b"\r\n"]
    return b"".join([*pieces, f"--{BOUNDARY}--\r\n".encode()])


@contextmanager
def served(folder: Path, language: str | None = None) -> Iterator[Client]:
    """The app over a folder, in a thread of this process, and a client that has not entered yet."""
    site = Site(Desk(folder), language)
    listening = bind(0)
    port = listening.getsockname()[1]
    token = site.desk.token()
    server = server_of(application(site, port, token))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
    thread.start()
    try:
        while not server.started:
            time.sleep(0.005)
        yield Client(port, token, folder)
    finally:
        server.should_exit = True
        thread.join(20)
        site.close()
        listening.close()
