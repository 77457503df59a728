"""A page runs its own scripts only, loads nothing, and holds the licences of the viewer."""

from __future__ import annotations

import base64
import hashlib
from html.parser import HTMLParser

from calib.show.scene.html_page import LegendEntry, fill_page


class Reader(HTMLParser):
    """The tags of a page, its visible text and its scripts."""

    def __init__(self, page: bytes) -> None:
        super().__init__()
        self.tags, self.text, self.scripts = [], "", []
        self._inside = ""
        self.feed(page.decode("utf-8"))
        self.close()

    def handle_starttag(self, tag, attrs):
        self._inside = tag
        self.tags.append((tag, dict(attrs)))
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag):  # noqa: ARG002
        self._inside = ""

    def handle_data(self, data):
        if self._inside == "script":
            self.scripts[-1] += data
        elif self._inside != "style":
            self.text += data


def make(**changes):
    arguments = {
        "title": "UR3",
        "text": "a fact",
        "warnings": (),
        "keys": [LegendEntry("arm", "#123456", "arm")],
        "grid": 0.1,
        "table": {"labels": ["row 1"]},
    }
    return fill_page("page.html", b"scene", **{**arguments, **changes})


def test_only_the_page_s_three_scripts_run_and_nothing_loads():
    reader = Reader(make())
    urls = [
        a for _, a in reader.tags for key in ("src", "href") if (key in a) and a[key] != "data:,"
    ]
    assert urls == []
    (policy,) = [a["content"] for _, a in reader.tags if "http-equiv" in a]
    assert policy.startswith("default-src 'none';")
    types = [a.get("type") for tag, a in reader.tags if tag == "script"]
    assert types == ["text/plain", "application/octet-stream", "application/json", None, None, None]
    for script in reader.scripts[3:]:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert policy.count("sha256-") == 3
    assert base64.b64decode(reader.scripts[1]) == b"scene"
    for holder in ("Robin Deits", "mrdoob", "Permission is hereby granted"):
        assert holder in reader.scripts[0]
    assert "connect-src" not in policy
