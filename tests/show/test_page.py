import base64
import hashlib
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from calib.show.page import Spot, html_page, round_length

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


def make(points=None, **changes):
    points = points or {
        "nominal": np.array([0.5, 0.2, 0.3]),
        "calibrated": np.array([0.502, 0.2, 0.3]),
        "measured": np.array([0.502, 0.2001, 0.3]),
    }
    arguments = {
        "title": "UR3",
        "pose_name": "row 31",
        "points": points,
        "spots": [Spot("nominal", np.zeros(3)), Spot("both", np.ones(3))],
        "grid": 0.1,
        "warnings": (),
        "scene": b"scene",
    }
    return html_page(**{**arguments, **changes})


def test_names_are_text_whatever_they_hold():
    page = make(title=NASTY, pose_name=NASTY, warnings=[NASTY, NASTY])
    reader, plain = Reader(page), Reader(make(warnings=["a", "b"]))
    assert reader.tags == plain.tags  # no tag and no attribute more than with harmless names
    assert reader.scripts == plain.scripts
    shown = NASTY.replace("\udcff", "?")
    assert reader.text.count(shown) == 5  # <title>, heading, pose and two warnings


def test_it_loads_nothing():
    page = make()
    reader = Reader(page)
    for tag, attributes in reader.tags:
        assert tag not in {"link", "img", "iframe", "object", "embed", "base", "form"}
        assert not {"src", "href", "srcset", "data", "action", "style"} & set(attributes) - (
            {"style"} if tag == "i" else set()
        )
        assert not [name for name in attributes if name.startswith("on")]
    # The notices name their authors' sites; otherwise there is the name of XHTML, which is no address to call.
    rest = page.decode().replace(reader.scripts[0], "")
    assert set(re.findall(r"(?:https?|wss?)://[\w./-]+", rest)) <= {"http://www.w3.org/1999/xhtml"}


def test_the_policy_lets_only_these_two_scripts_run_and_nothing_load():
    reader = Reader(make())
    (policy,) = [a["content"] for tag, a in reader.tags if "http-equiv" in a]
    assert policy.startswith("default-src 'none';")
    types = [a.get("type") for tag, a in reader.tags if tag == "script"]
    assert types == ["text/plain", "application/octet-stream", None, None]
    for script in reader.scripts[2:]:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert base64.b64decode(reader.scripts[1]) == b"scene"
    assert "connect-src" not in policy


def test_the_distances_are_given_in_mm():
    text = Reader(make()).text
    assert "Pose of row 31. The two robots put the target 2.00 mm apart here" in text
    assert "nominal 2.00 mm, calibrated 0.10 mm" in text
    assert "drawn true to scale" in text
    assert "Floor squares 0.1 m." in text


def test_the_magnified_points_are_to_one_scale():
    page = make(
        points={
            "nominal": np.zeros(3),
            "calibrated": np.array([3e-3, 0, 0]),
            "measured": np.array([0, 0, 4e-3]),
        }
    ).decode()
    dots = {
        who: np.array([float(x), float(y)])
        for x, y, who in re.findall(
            r'<circle cx="([-\d.]+)" cy="([-\d.]+)" .*?var\(--(\w+)\)', page
        )
    }
    bar = float(re.search(r'd="M8 78v6h([\d.]+)v-6"', page).group(1))
    bar_mm = float(re.search(r">([\d.]+) mm</text>", page).group(1))

    def distance(one, other):
        return np.linalg.norm(dots[one] - dots[other]) / bar * bar_mm

    assert distance("nominal", "calibrated") == pytest.approx(3, rel=0.01)
    assert distance("nominal", "measured") == pytest.approx(4, rel=0.01)
    assert distance("calibrated", "measured") == pytest.approx(5, rel=0.01)


@pytest.mark.parametrize("apart", [0.0, 1e-9, 12.0])
def test_points_that_agree_or_lie_far_apart(apart):
    points = {"nominal": np.zeros(3), "calibrated": np.array([0, apart, 0])}
    text = Reader(make(points=points)).text
    assert f"{'12000' if apart == 12 else '0.00'} mm" in text
    assert "measured" not in text
    assert ("magnified" in text) == (apart > 0)
    assert "nan" not in text


@pytest.mark.parametrize(
    ("length", "rounded"), [(0.1, 0.1), (0.199, 0.1), (0.2, 0.2), (0.6, 0.5), (7, 5), (1e-7, 1e-7)]
)
def test_round_lengths(length, rounded):
    assert round_length(length) == pytest.approx(rounded)
