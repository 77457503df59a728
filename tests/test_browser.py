"""The browser of the tests sees what a page does wrong: a check that it passes means something."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.browser import CHROMIUM, Browser, BrowserError, Tab

pytestmark = pytest.mark.slow

STRICT = "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src 'sha256-AAAA'\">"


@pytest.fixture
def look(browser: Browser, tmp_path: Path):
    """A function that opens a page of some text and says what became of it."""

    def looked(text: str) -> Tab:
        page = tmp_path / "page.html"
        page.write_text(f"<!DOCTYPE html><meta charset=utf-8><title>given</title>{text}", "utf-8")
        with browser.open(page.as_uri(), (320, 200)) as tab:
            tab.settle()
            assert tab.evaluate("document.title") == "given"
            assert tab.screenshot().shape == (200, 320, 3)
            _ = tab.complaints
            _ = tab.elsewhere
            return tab

    return looked


def test_it_sees_what_a_policy_refuses(look):
    tab = look(
        f"""{STRICT}<img src="https://example.org/x.png"><link rel="stylesheet" href="https://example.org/x.css">
        <script>document.title = "owned"</script>"""
    )
    said = [line for line in tab.console if "Content Security Policy" in line.text]
    assert {line.source for line in said} == {"security"}
    assert len(said) == 3
    assert len(tab.refused) == 2


def test_it_sees_requests_errors_and_exceptions_and_lets_nothing_out(look):
    tab = look(
        """<img src="https://example.org/x.png"><img src="data:image/gif;base64,AAAA">
        <script>console.warn("é漢", 1); console.log("fine"); fetch("http://example.com/a").catch(() => 0);
        new WebSocket("ws://example.net/x"); throw new Error("boo");</script>"""
    )
    requests = {"https://example.org/x.png", "http://example.com/a", "ws://example.net/x"}
    assert requests <= set(tab.requests)
    assert all("ERR_NAME_NOT_RESOLVED" in why for why in tab.refused)
    assert len(tab.refused) == 2
    (exception,) = tab.exceptions
    assert exception.startswith("Error: boo")
    said = [(line.level, line.text) for line in tab.console if line.source == "console-api"]
    assert said == [("warning", "é漢 1"), ("log", "fine")]


def test_a_page_s_own_file_is_not_elsewhere(browser: Browser, tmp_path: Path):
    (tmp_path / "a b.html").write_text('<link rel="icon" href="data:,"><a href="#x">x</a>')
    with browser.open((tmp_path / "a b.html").as_uri()) as tab:
        assert tab.elsewhere == []
        assert len(tab.requests) >= 1
        with pytest.raises(BrowserError, match="boo"):
            tab.evaluate("(() => { throw new Error('boo') })()")
        assert tab.evaluate("Promise.resolve([1, 'é'])") == [1, "é"]
        with pytest.raises(BrowserError, match=r"waited 0\.1 s for: 0 > 1"):
            tab.wait_for("0 > 1", 0.1)
        with pytest.raises(BrowserError, match="ERR_FILE_NOT_FOUND"):
            tab.open((tmp_path / "none.html").as_uri())


def test_the_browser_is_found_where_it_is():
    """On a machine with Chromium at its usual place, no test of a page is skipped."""
    if os.path.exists("/usr/bin/chromium"):  # noqa: PTH110
        assert CHROMIUM is not None
