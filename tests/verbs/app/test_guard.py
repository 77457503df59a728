"""Who may talk to the server, by requests of every other kind over a real socket."""

from __future__ import annotations

import pytest

from tests.verbs.app.served import Client

OTHER_HOSTS = (
    "example.org",
    "example.org:{port}",
    "127.0.0.1",
    "127.0.0.1:1",
    "127.0.0.1.example.org:{port}",
    "localhost.example.org:{port}",
    "0.0.0.0:{port}",
    "127.0.0.1:{port}@example.org",
    "",
)

OTHER_ORIGINS = (
    "http://example.org",
    "https://127.0.0.1:{port}",
    "http://127.0.0.1:1",
    "http://127.0.0.1",
    "http://localhost:{port}.example.org",
    "null",
    "",
)


@pytest.mark.parametrize("host", OTHER_HOSTS)
def test_another_host_is_refused(client: Client, host: str):
    """Also the name of another that points at this computer: the cookie would be sent to it."""
    answer = client.get("/open", Host=host.format(port=client.port))
    assert answer.status in (400, 403)
    assert b"<html" not in answer.body


@pytest.mark.parametrize("host", ["127.0.0.1:{port}", "localhost:{port}", "[::1]:{port}"])
def test_its_own_hosts_are_not(client: Client, host: str):
    assert client.get("/open", Host=host.format(port=client.port)).status == 200


@pytest.mark.parametrize("origin", OTHER_ORIGINS)
def test_a_form_of_another_page_is_refused(client: Client, origin: str):
    headers = {"Origin": origin.format(port=client.port), "Sec-Fetch-Site": "same-origin"}
    answer = client.ask("POST", "/example", b"key=1", headers)
    assert answer.status == 403
    assert not list(client.folder.glob("0*"))


def test_a_form_without_an_origin_needs_the_browser_s_word(client: Client):
    kind = {"Content-Type": "application/x-www-form-urlencoded"}
    silent = {"Origin": None, **kind}
    assert client.ask("POST", "/example", b"key=1", silent).status == 403
    for site, status in (
        ("cross-site", 403),
        ("same-site", 403),
        ("none", 403),
        ("same-origin", 303),
    ):
        answer = client.ask("POST", "/example", b"key=1", {**silent, "Sec-Fetch-Site": site})
        assert answer.status == status, site


def test_pages_of_others_may_not_read(client: Client):
    """A page at another port of this computer is of the same site, and its cookies are these."""
    for site in ("cross-site", "same-site"):
        headers = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "no-cors"}
        assert client.get("/open", **headers).status == 403
        # A link that leads here is followed.
        assert client.get("/open", **{**headers, "Sec-Fetch-Mode": "navigate"}).status == 200


def test_without_the_token_nothing_is_shown(client: Client):
    stranger = Client(client.port, client.token, client.folder)
    for path in (
        "/",
        "/open",
        "/history",
        "/static/app.css",
        "/jobs/0001-x",
        "/open?token=",
        "/open?token=x",
    ):
        answer = stranger.get(path)
        assert answer.status == 403, path
        assert b"terminal" in answer.body
    assert stranger.post("/example", key="1").status == 403
    stranger.cookies[f"calib_app_{client.port}"] = "x" * 32
    assert stranger.get("/open").status == 403
    stranger.cookies = {f"calib_app_{client.port + 1}": client.token}
    assert stranger.get("/open").status == 403


def test_the_printed_address_opens_any_page_and_loses_the_token(client: Client):
    stranger = Client(client.port, client.token, client.folder)
    answer = stranger.get(f"/history?token={client.token}&a=1%262")
    assert (answer.status, answer.to) == (303, "/history?a=1%262")
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=lax" in cookie
    # Two slashes would lead to another host.
    assert stranger.get(f"//example.org/?token={client.token}").to == "/example.org/"


def test_every_answer_keeps_others_out(client: Client):
    for path in ("/open", "/nowhere", "/static/app.js"):
        headers = client.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["x-frame-options"] == "DENY"
        assert headers["cross-origin-resource-policy"] == "same-origin"
        assert headers["referrer-policy"] == "same-origin"
        assert "server" not in headers


def test_other_methods_and_sockets_are_refused(client: Client):
    assert client.ask("PUT", "/open", b"").status == 403  # no origin
    own = {"Origin": f"http://{client.host}"}
    assert client.ask("PUT", "/open", b"", own).status == 405
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    }
    assert client.get("/open", **upgrade).status != 101
