"""The server of a page: whom it answers and whom not, what windows are told, and what is left when it stops."""

from __future__ import annotations

import asyncio
import http.client
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from calib.errors import CalibError
from calib.show.server import PageServer
from tests.listening import listening

PAGE = "<!DOCTYPE html><title>é漢</title>".encode()

on_linux = pytest.mark.skipif(
    not Path("/proc/net/tcp").exists(), reason="the socket table is not at /proc: not Linux"
)


@pytest.fixture
def server():
    with PageServer(PAGE) as server:
        yield server


def ask(server: PageServer, path: str = "/", method: str = "GET", **headers: str):
    """Status, headers and body of an answer."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    try:
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        connection.close()


async def window(server: PageServer, **headers: str) -> WebSocketClientConnection:
    """A window of the page."""
    said = {"Origin": server.url.rstrip("/"), **headers}
    return await websocket_connect(HTTPRequest(f"ws://127.0.0.1:{server.port}/live", headers=said))


@contextmanager
def silent_window(server: PageServer) -> Iterator[None]:
    """A window that reads nothing and answers nothing."""
    key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
    with socket.create_connection(("127.0.0.1", server.port)) as connection:
        connection.sendall(
            f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nOrigin: {server.url[:-1]}\r\n"
            f"Upgrade: websocket\r\nConnection: Upgrade\r\n{key}\r\n".encode()
        )
        assert connection.recv(12) == b"HTTP/1.1 101"
        while not server.windows:
            time.sleep(0.001)
        yield


def test_the_page_is_at_its_address(server):
    status, headers, body = ask(server)
    assert (status, body) == (200, PAGE)
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    assert headers["Cache-Control"] == "no-store"
    assert server.url == f"http://127.0.0.1:{server.port}/"
    assert repr(server) == f"<PageServer {server.url}>"
    assert ask(server, Host=f"LOCALHOST:{server.port}")[0] == 200


@pytest.mark.parametrize(
    ("path", "method", "status"),
    [
        ("/index.html", "GET", 404),
        ("/favicon.ico", "GET", 404),
        ("//", "GET", 404),
        ("/../etc/passwd", "GET", 404),
        ("/x", "POST", 404),
        ("/", "POST", 405),
        ("/live", "GET", 403),
    ],
)
def test_there_is_nothing_else(server, path, method, status):
    found, _, body = ask(server, path, method)
    assert found == status
    assert PAGE not in body


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:80", "localhost:1", ""])
@pytest.mark.parametrize("path", ["/", "/live", "/x"])
def test_another_host_s_name_is_refused(server, host, path):
    status, _, body = ask(server, path, Host=host, Origin=server.url[:-1])
    assert status in (400, 403)
    assert PAGE not in body
    if status == 403:
        assert server.url.encode() in body
        assert f"ssh -L {server.port}:127.0.0.1:{server.port}".encode() in body


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1", ""])
def test_another_origin_is_refused(server, origin):
    assert ask(server, Origin=origin)[0] == 403

    async def connect() -> None:
        await window(server, Origin=origin)

    with pytest.raises(HTTPClientError, match="403"):
        asyncio.run(connect())
    assert server.windows == 0


def test_windows_are_told_first_what_is_and_then_what_comes():
    said: list[bytes | str] = [b"\x00scene", '{"pose": 1}']

    async def listen(server: PageServer) -> None:
        one, other = await window(server), await window(server)
        for each in (one, other):
            assert [await each.read_message() for _ in said] == said
        while server.windows < 2:
            await asyncio.sleep(0.001)
        await one.write_message("windows have nothing to say")
        big = bytes(range(256)) * 2**12
        for message in (b"bytes", "té漢t", big):
            server.send(message)
            assert await one.read_message() == message
            assert await other.read_message() == message
        other.close()
        while server.windows > 1:
            await asyncio.sleep(0.001)
        server.send("last")
        assert await one.read_message() == "last"
        await asyncio.to_thread(server.close)
        assert await one.read_message() is None
        one.close()

    with PageServer(PAGE, welcome=lambda: said) as server:
        asyncio.run(asyncio.wait_for(listen(server), 20))
    assert server.windows == 0


def test_messages_of_many_threads_arrive_whole_and_each_thread_s_in_order(server):
    async def listen() -> list[str]:
        one = await window(server)
        while not server.windows:
            await asyncio.sleep(0.001)
        threads = [
            threading.Thread(target=lambda i=i: [server.send(f"{i} {n}") for n in range(200)])
            for i in range(4)
        ]
        for thread in threads:
            thread.start()
        came = [str(await one.read_message()) for _ in range(800)]
        one.close()
        assert await one.read_message() is None
        return came

    came = asyncio.run(asyncio.wait_for(listen(), 20))
    for i in range(4):
        assert [line for line in came if line.startswith(f"{i} ")] == [
            f"{i} {n}" for n in range(200)
        ]


def test_a_window_that_does_not_follow_is_given_up(server, monkeypatch):
    monkeypatch.setattr("calib.show.server._FARTHEST_BEHIND", 2**20)
    with silent_window(server):
        end = time.monotonic() + 20
        while server.windows and time.monotonic() < end:
            server.send(bytes(2**18))
            time.sleep(0.001)
        assert server.windows == 0
    assert ask(server)[0] == 200


@on_linux
def test_it_listens_on_127_0_0_1_only_and_on_nothing_once_closed():
    before = listening(os.getpid())
    with PageServer(PAGE) as one, PageServer(PAGE) as other:
        now = set(listening(os.getpid())) - set(before)
        assert now == {("127.0.0.1", one.port), ("127.0.0.1", other.port)}
        assert one.port != other.port
    assert listening(os.getpid()) == before
    names = {thread.name for thread in threading.enumerate()}
    assert not names & {f"calib {one.url}", f"calib {other.url}"}


def test_its_port_is_free_at_once_and_a_port_in_use_is_refused(server):
    with pytest.raises(
        CalibError, match=rf"Port {server.port} .* in use .* 0 \(--port 0\) for any"
    ):
        PageServer(PAGE, port=server.port)
    connection = http.client.HTTPConnection("127.0.0.1", server.port)
    connection.request("GET", "/")
    assert connection.getresponse().read() == PAGE  # and stays connected
    server.close()
    server.close()
    with PageServer(PAGE, port=server.port) as again:
        assert again.port == server.port
        assert ask(again)[2] == PAGE
    connection.close()
    assert repr(server) == "<PageServer closed>"


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_is_none(port):
    with pytest.raises(CalibError, match=f"port was given as {port}; give a number from 1024"):
        PageServer(PAGE, port=port)


def test_a_closed_server_takes_no_message(server):
    server.close()
    with pytest.raises(CalibError, match=rf"{server.url} was closed, .* open a new one"):
        server.send("text")


def test_a_window_that_never_answers_does_not_keep_it_open(server):
    with silent_window(server):
        start = time.monotonic()
        server.close()
        assert time.monotonic() - start < 2.0


def test_wait_ends_when_it_is_closed(server):
    threading.Timer(0.05, server.close).start()
    server.wait()
    assert server.closed


@pytest.mark.parametrize("ending", ["server.wait()", "pass"])
def test_a_program_that_ends_leaves_nothing_and_prints_nothing(ending):
    program = f"""
import sys, time
from calib.show.server import PageServer
server = PageServer(b"page")
print(server.port, flush=True)
{ending}
assert server.closed == ({ending!r} != "pass")
"""
    command = [sys.executable, "-X", "dev", "-W", "error", "-c", program]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        port = int(process.stdout.readline())
        if ending != "pass":
            assert ask(type("At", (), {"port": port}))[2] == b"page"
            time.sleep(0.3)  # it has printed before it waits
            process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
    assert (process.returncode, out, err) == (0, "", "")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port))


def test_another_page_in_the_same_browser_reaches_neither_page_nor_messages(server, browser):
    stranger = f"""<!DOCTYPE html><link rel="icon" href="data:,"><title>stranger</title><script>
      const read = (how) => fetch("{server.url}", how).then((r) => r.text()).catch(() => "");
      const socket = new WebSocket("{server.url.replace("http", "ws")}live");
      const heard = new Promise((done) => {{
        socket.onmessage = ({{ data }}) => done(data);
        socket.onclose = () => done("");
      }});
      const frame = document.createElement("iframe");
      const framed = new Promise((done) => {{
        frame.onload = () => {{
          try {{ done(frame.contentDocument.body.textContent); }} catch {{ done(""); }}
        }};
        frame.src = "{server.url}";
        document.documentElement.append(frame);
      }});
    </script>"""
    with PageServer(stranger.encode()) as other, browser.open(other.url, (320, 200)) as tab:
        got = tab.evaluate('Promise.all([read(), read({ mode: "no-cors" }), heard, framed])')
        assert got == ["", "", "", ""]
        assert server.windows == 0
        assert sum(url.startswith(server.url) for url in tab.requests) >= 2  # it has tried
        assert any("403" in line.text for line in tab.console)
        assert any("X-Frame-Options" in line.text for line in tab.console)
