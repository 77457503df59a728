"""Pages say what a view holds, load nothing, and let no name be more than text."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from calib.report.figure_base import CALIBRATED, NOMINAL
from calib.viewer.page import FACTORS, magnification, puppets, script_table, view_page
from calib.viewer.scene import Key, filled_page
from calib.viewer.view import View, packed, read_visuals, translation
from tests.viewer.conftest import scene_of

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
    }
    return filled_page("page.html", b"scene", **{**arguments, **changes})


def table_of(page) -> dict:
    """What the script of a page is told."""
    return json.loads(re.search(rb'id="table">([^<]*)<', page.html).group(1))


def floats(text: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype="<f4").reshape(shape)


@pytest.fixture(scope="module")
def view(gantry, disturb):
    """A robot without meshes: its page is made at once."""
    rng = np.random.default_rng(4)
    q = rng.uniform(-0.5, 0.5, (35, 3))
    kinds = ("estimation",) * 30 + ("validation",) * 5
    plain = View(gantry, disturb(gantry), q, kinds=kinds)
    return replace(plain, measured=plain.predicted[1] + rng.normal(0, 1e-4, (35, 3)))


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
    (live,) = [a["content"] for _, a in Reader(make(live=True)).tags if "http-equiv" in a]
    (sources,) = re.findall(r"connect-src ([^;]*)", live)
    assert sources.split() == ["'self'", "ws://127.0.0.1:*", "ws://localhost:*"]


def test_names_add_no_tag_wherever_they_stand(view):
    def named(name):
        words = {"title": name, "note": name, "verdict": name, "names": ((name, name),) * 2}
        return Reader(view_page(replace(view, labels=(name,) * 35, **words)).html)

    nasty, harmless = named(NASTY), named("harmless")
    assert nasty.tags == harmless.tags
    assert len(nasty.scripts) == len(harmless.scripts)
    assert NASTY.replace("\udcff", "?") in nasty.text


def test_the_ur3_is_drawn_twice_from_one_copy_of_its_meshes(ur3_view, ur3_page):
    assert ur3_page.warnings == ()
    assert len(ur3_page.html) < 7_000_000
    commands = scene_of(ur3_page)["commands"]
    placed = {c["path"]: c["matrix"] for c in commands if c["type"] == "set_transform"}
    used = set()
    for k, (who, colour) in enumerate((("nominal", NOMINAL), ("calibrated", CALIBRATED))):
        path = rf"/robots/{who}/robot/links/\d+/(\d+|ball)"
        drawn = [c for c in commands if c["type"] == "set_object" and re.fullmatch(path, c["path"])]
        assert {c["object"]["materials"][0]["color"] for c in drawn} == {int(colour[1:], 16)}
        used |= {c["object"]["geometries"][0] for c in drawn}
        (ball,) = [c["path"] for c in drawn if c["path"].endswith("ball")]
        at = placed[ball.rsplit("/", 1)[0]][12:15]
        np.testing.assert_allclose(at, ur3_view.predicted[k, 30], atol=1e-12)
    assert len(used) == 7 + 1


def test_the_two_robots_do_not_touch(view):
    table = table_of(view_page(view))
    shown = puppets(view, {who: read_visuals(one.urdf)[0] for who, one in view.robots.items()})
    groups = [shown[who].outline() + table["places"][who] for who in shown]
    row = np.subtract(table["places"]["calibrated"], table["places"]["nominal"])
    assert (groups[0] @ row).max() < (groups[1] @ row).min()


def test_one_robot_alone_has_no_second_one_and_nothing_to_compare(gantry):
    page = view_page(View(gantry, None, np.zeros((2, 3)), title="just me"))
    assert list(table_of(page)["robots"]) == ["nominal"]
    body = page.html.decode().split("<body>")[1].split("<script")[0]
    assert "just me" in body
    for word in ("data-mode", "Calibrated", "arrows", 'id="inset"'):
        assert word not in body
    assert 'id="row"' in body


def test_poses_points_and_numbers_are_those_of_the_view(view):
    gap = np.array(view.measured)
    gap[3] = np.nan
    errors = np.linalg.norm(gap - view.predicted, axis=2)
    view = replace(view, measured=gap, errors=errors, start=30)
    shown = puppets(view, {who: read_visuals(one.urdf)[0] for who, one in view.robots.items()})
    table = script_table(view, shown)
    json.dumps(table, allow_nan=False)  # plain numbers only
    for who, puppet in shown.items():
        count = puppet.poses.shape[1]
        assert table["robots"][who]["movers"] == count
        poses = floats(table["robots"][who]["poses"], 35, count, 7)
        np.testing.assert_array_equal(poses, packed(puppet.poses))
    np.testing.assert_allclose(floats(table["measured"], 35, 3), gap, atol=1e-7)
    told = [floats(one, 35) for one in table["errors"]]
    np.testing.assert_allclose(told, errors, rtol=1e-6)
    assert np.isnan([floats(one, 35) for one in table["angles"]]).all()
    assert (table["start"], table["kinds"][30]) == (30, "validation")
    assert table["instruments"] == []
    seen = script_table(replace(view, instruments=translation([3.0, 1.0, 0.5])[None]), shown)
    np.testing.assert_allclose(seen["instruments"], [[3.0, 1.0, 0.5, 0.0, 0.0, 0.0, 1.0]])


def test_typical_arrows_are_well_visible(ur3, ur3_view):
    factor = magnification(ur3_view, 1.0)
    assert factor in FACTORS
    assert 0.04 < factor * float(np.median(ur3_view.errors[0])) < 0.13
    # A wild row that was flagged changes nothing.
    wild = np.array(ur3_view.measured)
    wild[:15] += 100.0
    kinds = ("flagged",) * 15 + ur3_view.kinds[15:]
    assert magnification(replace(ur3_view, measured=wild, kinds=kinds), 1.0) == factor
    assert magnification(View(ur3, ur3, np.zeros((2, 6))), 1.0) == 1


def test_the_legend_says_what_there_is(view):
    gap = np.array(view.measured)
    gap[0] = np.nan
    kinds = ("flagged", "flagged", *view.kinds[2:])
    page = view_page(replace(view, measured=gap, kinds=kinds, verdict="use with care", note="So."))
    text = Reader(page.html).text
    for words in ("fitted (28)", "held back (5)", "flagged (1)"):  # the other one was not seen
        assert f"measured, {words}" in text
    assert "error arrows, predicted to measured" in text
    assert "measurement frame" not in text
    assert b'<b class="verdict care">Verdict: use with care.</b> So.' in page.html
