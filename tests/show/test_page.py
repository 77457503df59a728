import base64
import hashlib
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from calib.show.camera import round_length
from calib.show.page import Key, filled_page, single_page

NASTY = "</script><script>alert(1)</script> \"'&<!-- é漢字 \udcff"


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
        "keys": [Key("arm", "#123456", "arm")],
        "grid": 0.1,
        "table": {"labels": ["row 1"]},
        "scripts": ("words.js", "controls.js"),
    }
    return filled_page("page.html", b"scene", **{**arguments, **changes})


def test_names_are_text_whatever_they_hold():
    page = make(
        title=NASTY,
        text=NASTY,
        warnings=[NASTY] * 2,
        keys=[Key(NASTY, "#1", "x")],
        table={"labels": [NASTY]},
    )
    reader, plain = Reader(page), Reader(make(warnings=["a", "b"], keys=[Key("a", "#1", "x")]))
    assert reader.tags == plain.tags  # no tag and no attribute more than with harmless names
    assert len(reader.scripts) == len(plain.scripts)
    shown = NASTY.replace("\udcff", "?")
    assert reader.text.count(shown) == 6  # <title>, heading, text, legend and two warnings
    assert json.loads(reader.scripts[2]) == {"labels": [NASTY]}


def test_it_loads_nothing():
    page = make()
    reader = Reader(page)
    # Without a picture of its own a browser would ask a live page's server for one.
    icon = ("link", {"rel": "icon", "href": "data:,"})
    assert reader.tags.count(icon) == 1
    for tag, attributes in (one for one in reader.tags if one != icon):
        assert tag not in {"link", "img", "iframe", "object", "embed", "base", "form"}
        assert not {"src", "href", "srcset", "data", "action", "style"} & set(attributes) - (
            {"style"} if tag == "i" else set()
        )
        assert not [name for name in attributes if name.startswith("on")]
    # The notices name their authors' sites; otherwise there are the names of XHTML and SVG, no addresses to call.
    rest = page.decode().replace(reader.scripts[0], "")
    names = {"http://www.w3.org/1999/xhtml", "http://www.w3.org/2000/svg"}
    assert set(re.findall(r"(?:https?|wss?)://[\w./-]+", rest)) <= names


def test_the_policy_lets_only_these_three_scripts_run_and_nothing_load():
    reader = Reader(make())
    (policy,) = [a["content"] for tag, a in reader.tags if "http-equiv" in a]
    assert policy.startswith("default-src 'none';")
    types = [a.get("type") for tag, a in reader.tags if tag == "script"]
    assert types == ["text/plain", "application/octet-stream", "application/json", None, None, None]
    for script in reader.scripts[3:]:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert policy.count("sha256-") == 3
    assert base64.b64decode(reader.scripts[1]) == b"scene"
    assert "connect-src" not in policy


def test_a_page_without_a_table_has_two_scripts():
    reader = Reader(make(table=None, scripts=()))
    types = [a.get("type") for tag, a in reader.tags if tag == "script"]
    assert types == ["text/plain", "application/octet-stream", None, None]


def test_a_live_page_may_talk_to_this_computer_and_to_nobody_else():
    reader = Reader(make(live=True))
    (policy,) = [a["content"] for tag, a in reader.tags if "http-equiv" in a]
    (sources,) = re.findall(r"connect-src ([^;]*)", policy)
    assert sources.split() == ["'self'", "ws://127.0.0.1:*", "ws://localhost:*"]
    assert [a for tag, a in reader.tags if tag == "body"] == [{"data-live": None}]
    assert [a for tag, a in Reader(make()).tags if tag == "body"] == [{}]


def test_a_key_says_what_it_shows_and_whether_it_does_at_first():
    keys = [Key("a<b", "#123456", "x y"), Key("c", "", "z", "dot", on=False)]
    page = make(keys=keys).decode()
    assert 'checked data-show="x y"' in page
    assert "a&lt;b" in page
    assert '<input type="checkbox" data-show="z"><i class="dot"' in page
    assert "Floor squares 0.1 m" in page
    assert "Floor squares 20 mm" in make(grid=0.02).decode()


def test_a_page_of_one_robot_holds_it_and_what_is_drawn(gantry):
    sizes = []

    def draw(scene, size):
        sizes.append(size)
        scene["ball"].set_transform(np.eye(4))
        return [Key("a ball", "#112233", "ball")]

    for points in (np.zeros((0, 3)), np.array([[9.0, 0.0, 0.0]])):
        words = {"title": "A <title>", "text": "1 < 2", "legend": "an arm"}
        html = single_page(gantry, np.zeros(3), points, draw, **words).html.decode()
    assert sizes[1] > 8.0 > sizes[0]
    assert "A &lt;title&gt;" in html
    assert "<p>1 &lt; 2</p>" in html
    assert re.findall('data-show="(.*?)"', html) == ["nominal", "ball"]


@pytest.mark.parametrize(
    ("length", "rounded"), [(0.1, 0.1), (0.199, 0.1), (0.2, 0.2), (0.6, 0.5), (7, 5), (1e-7, 1e-7)]
)
def test_round_lengths(length, rounded):
    assert round_length(length) == pytest.approx(rounded)
