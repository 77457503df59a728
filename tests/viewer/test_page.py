from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser

import numpy as np
import pytest
import umsgpack
from markupsafe import escape

from calib import example
from calib.errors import FileError
from calib.report.label_rows import CALIBRATED, NOMINAL
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.viewer import page
from calib.viewer.page import (
    FACTORS,
    Key,
    Layout,
    filled_page,
    magnification,
    puppets,
    single_page,
    view_page,
)
from calib.viewer.scene import round_length
from calib.viewer.shapes import packed, read_visuals
from calib.viewer.view import MOST_POSES, Cloud, View, thinned, translated

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
    assert "MeshCat" in reader.scripts[3]
    for holder in ("Robin Deits", "mrdoob", "Google Inc.", "Permission is hereby granted"):
        assert holder in reader.scripts[0]
    assert "connect-src" not in policy


def test_a_live_page_may_talk_to_this_computer_and_to_nobody_else():
    reader = Reader(make(live=True))
    (policy,) = [a["content"] for tag, a in reader.tags if "http-equiv" in a]
    (sources,) = re.findall(r"connect-src ([^;]*)", policy)
    assert sources.split() == ["'self'", "ws://127.0.0.1:*", "ws://localhost:*"]
    assert [a for tag, a in reader.tags if tag == "body"] == [{"data-live": None}]
    assert [a for tag, a in Reader(make()).tags if tag == "body"] == [{}]


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


HOSTILE = "<script>document.title='owned'</script>\"'& é漢"


def scene_of(page) -> dict:
    """The scene's message in a page."""
    text = re.search(rb'id="scene">([^<]*)<', page.html).group(1)
    return umsgpack.unpackb(base64.b64decode(text))


def transforms(scene: dict) -> dict[str, np.ndarray]:
    """The transform of each node that has one, shape (4, 4)."""
    return {
        c["path"]: np.array(c["matrix"]).reshape(4, 4).T
        for c in scene["commands"]
        if c["type"] == "set_transform"
    }


def world_points(scene: dict, group: str) -> np.ndarray:
    """The origins of a robot's objects in the scene, through every transform above them."""
    known = transforms(scene)
    points = []
    for command in scene["commands"]:
        path = command["path"]
        if command["type"] == "set_object" and path.startswith(f"/robots/{group}/"):
            T = np.eye(4)
            for i in range(2, len(path.split("/")) + 1):
                T = T @ known.get("/".join(path.split("/")[:i]), np.eye(4))
            points.append(T[:3, 3])
    return np.array(points)


def camera(page) -> list[float]:
    (position,) = [
        c["value"]
        for c in scene_of(page)["commands"]
        if c["path"] == "/Cameras/default/rotated/<object>"
    ]
    return position


def test_the_ur3_is_drawn_twice_from_one_copy_of_its_meshes(ur3_page):
    assert ur3_page.warnings == ()
    assert len(ur3_page.html) < 7_000_000
    scene = scene_of(ur3_page)
    meshes = [
        g
        for g in scene["geometries"].values()
        if "normal" in g.get("data", {}).get("attributes", {})
    ]
    assert len(meshes) == 7
    for who, colour in (("nominal", NOMINAL), ("calibrated", CALIBRATED)):
        path = rf"/robots/{who}/robot/links/\d+/\d+"
        drawn = [
            c
            for c in scene["commands"]
            if c["type"] == "set_object" and re.fullmatch(path, c["path"])
        ]
        assert len(drawn) == 7
        assert {c["object"]["materials"][0]["color"] for c in drawn} == {int(colour[1:], 16)}


def test_targets_are_drawn_where_the_robots_put_them(ur3_view, ur3_page):
    known = transforms(scene_of(ur3_page))
    for who, wanted in zip(("nominal", "calibrated"), ur3_view.predicted[:, 30], strict=True):
        balls = [
            c["path"]
            for c in scene_of(ur3_page)["commands"]
            if c["type"] == "set_object"
            and re.fullmatch(rf"/robots/{who}/robot/links/\d+/ball", c["path"])
        ]
        (ball,) = balls
        np.testing.assert_allclose(known[ball.rsplit("/", 1)[0]][:3, 3], wanted, atol=1e-12)


@pytest.mark.parametrize("name", ["gantry", "head_and_arm"])
def test_the_two_robots_do_not_touch(request, disturb, name):
    robot = request.getfixturevalue(name)
    q = np.full((1, len(robot.joint_names)), 0.3)
    page = view_page(View(robot, disturb(robot), q))
    assert page.warnings == ()
    scene = scene_of(page)
    groups = [world_points(scene, group) for group in ("nominal", "calibrated")]
    row = groups[1].mean(axis=0) - groups[0].mean(axis=0)
    row /= np.linalg.norm(row)
    assert (groups[0] @ row).max() < (groups[1] @ row).min()


def test_a_robot_with_a_hostile_name_and_a_missing_mesh(disturb):
    text = example.paper_urdf().read_text(encoding="utf-8")
    text = text.replace('robot name="ur3"', f'robot name="{escape(HOSTILE)}"')
    text = text.replace("visual/wrist1.dae", f"visual/{escape(HOSTILE)}.dae")
    robot = Robot.from_urdf(Urdf.from_bytes(text.encode(), HOSTILE), "base", "tool0")
    page = view_page(View(robot, disturb(robot), np.full((1, 6), 0.4), labels=(HOSTILE,)))
    assert HOSTILE.encode() not in page.html
    assert f"<h1>{escape(HOSTILE)}: nominal and calibrated</h1>".encode() in page.html
    (warning,) = page.warnings
    assert warning.startswith("link 'wrist_1_link': the mesh 'package://example-robot-data/")
    assert escape(warning).encode() in page.html
    drawn = world_points(scene_of(page), "nominal")
    assert len(drawn) == 6 + 2 + 2  # meshes, stick, target and the rod to it


def test_a_wild_measurement_does_not_move_the_camera_and_many_rows_stay_small(ur3, ur3_view):
    wild = np.array(ur3_view.measured)
    wild[3] = 1e4
    assert camera(view_page(replace(ur3_view, measured=wild))) == camera(view_page(ur3_view))
    rng = np.random.default_rng(1)
    q = rng.uniform(-1, 1, (2_000, 6))
    view = View(ur3, ur3, q, measured=ur3.poses(q)[:, :3, 3] + 0.001)
    page = view_page(view)
    assert len(page.html) < 7_000_000
    assert b"400 of 2,000 rows are shown" in page.html


def test_one_robot_alone_has_no_second_one_and_nothing_to_compare(ur3):
    page = view_page(View(ur3, None, np.zeros((2, 6)), title="just me"))
    scene = scene_of(page)
    assert len(world_points(scene, "nominal"))
    assert not len(world_points(scene, "calibrated"))
    body = page.html.decode().split("<body>")[1].split("<script")[0]
    assert "just me" in body
    for word in ("data-mode", "Calibrated", "arrows", 'id="inset"'):
        assert word not in body
    assert 'id="row"' in body


def test_an_existing_file_is_kept_unless_asked(ur3_view, ur3_page, tmp_path):
    path = tmp_path / "view.html"
    assert view_page(ur3_view).write(path) == path
    assert path.read_bytes() == ur3_page.html
    path.write_text("mine")
    with pytest.raises(FileError, match="exists already"):
        ur3_page.write(path)
    assert path.read_text() == "mine"
    ur3_page.write(path, overwrite=True)
    assert path.read_bytes() == ur3_page.html


def floats(text: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype="<f4").reshape(shape)


@cache
def visuals_of(robot):
    return read_visuals(robot.urdf)[0]


def table_of(view: View) -> tuple[dict, dict]:
    shown = puppets(view, {who: visuals_of(robot) for who, robot in view.robots.items()})
    layout = Layout.of(view, shown)
    table = page._table(view, shown, layout, view.cloud, 50)
    json.dumps(table, allow_nan=False)  # plain numbers only
    return table, shown


def test_poses_points_and_numbers_are_those_of_the_view(ur3_view):
    gap = np.array(ur3_view.measured)
    gap[3] = np.nan
    errors = np.array(ur3_view.errors)
    errors[:, 3] = np.nan
    view = replace(ur3_view, measured=gap, errors=errors)
    table, shown = table_of(view)
    for who, puppet in shown.items():
        count = puppet.poses.shape[1]
        assert table["robots"][who]["movers"] == count
        np.testing.assert_array_equal(
            floats(table["robots"][who]["poses"], 35, count, 7), packed(puppet.poses)
        )
    np.testing.assert_allclose(floats(table["measured"], 35, 3), gap, atol=1e-7)
    assert table["errors"][0][3] is None
    np.testing.assert_allclose(table["errors"][1][30], errors[1, 30], rtol=1e-8)
    assert table["angles"] == [[None] * 35] * 2
    assert (table["start"], table["labels"][30], table["kinds"][30]) == (30, "row 31", "validation")
    assert table["instruments"] == []
    assert set(table["seenFrom"]) == {-1}
    assert table["cloud"] is None


def test_movers_of_the_same_link_are_paired_whatever_else_moves(ur3_view, ur3):
    """A calibrated robot with a link more, such as the one that carries the target."""
    other = replace(ur3, urdf=ur3.urdf.with_link("calib_target", "tool0", np.eye(4)))
    view = replace(ur3_view, calibrated=other)
    table, shown = table_of(view)
    same = table["robots"]["calibrated"]["same"]
    frames = ["base", "tip", "target"]
    names = {who: [*puppet.links, *frames] for who, puppet in shown.items()}
    for mine, theirs in enumerate(same):
        if theirs >= 0:
            assert names["calibrated"][mine] == names["nominal"][theirs]
        else:
            assert names["calibrated"][mine] not in names["nominal"]
    assert same[-3:] == [len(names["nominal"]) - 3 + k for k in range(3)]


def test_instruments_are_told_once_each(ur3_view):
    far, near = translated([3.0, 1.0, 0.5]), translated([-2.0, 0.0, 1.0])
    poses = np.array([far if n % 2 else near for n in range(35)])
    poses[7] = np.nan
    table, _ = table_of(replace(ur3_view, instruments=poses))
    assert len(table["instruments"]) == 2
    for n, which in enumerate(table["seenFrom"]):
        if n == 7:
            assert which == -1
        else:
            np.testing.assert_allclose(table["instruments"][which][:3], poses[n, :3, 3])


def test_the_cloud_s_colours_go_from_well_to_badly_known(ur3_view):
    cloud = Cloud(np.zeros((50, 3)), np.geomspace(1e-4, 1e-3, 50), np.arange(50) < 10)
    table, _ = table_of(replace(ur3_view, cloud=cloud))
    rgb = floats(table["cloud"]["colours"], 50, 3)
    assert rgb[0].sum() > rgb[25].sum() > rgb[49].sum()  # from pale to dark, in grey print too
    assert floats(table["cloud"]["measured"], 50).sum() == 10
    same = Cloud(np.zeros((50, 3)), np.zeros(50), np.ones(50, dtype=bool))
    assert np.isfinite(
        floats(table_of(replace(ur3_view, cloud=same))[0]["cloud"]["colours"], 50, 3)
    ).all()


@pytest.mark.parametrize("count", [401, 5000])
def test_many_rows_are_thinned_evenly_and_flagged_ones_are_kept(ur3, count):
    rng = np.random.default_rng(5)
    kinds = np.array(["estimation"] * count, dtype=object)
    kinds[rng.permutation(count)[: count // 10]] = "validation"
    kinds[[10, 20, 390]] = "flagged"
    view = View(ur3, ur3, rng.uniform(-1, 1, (count, 6)), kinds=tuple(kinds), start=33)
    few = thinned(view)
    assert len(few.q) == MOST_POSES
    assert few.rows == count
    np.testing.assert_array_equal(few.q[few.start], view.q[33])
    assert few.kinds.count("flagged") == 3
    assert 0.5 * count // 10 / count < few.kinds.count("validation") / MOST_POSES < 1.5 / 10
    numbers = [int(label.removeprefix("pose ")) for label in few.labels]
    assert numbers == sorted(set(numbers))
    assert max(np.diff(numbers)) < 6 * count / MOST_POSES
    assert thinned(few.select(range(len(few.q)))).rows == count


def test_typical_arrows_are_well_visible(ur3_view):
    factor = magnification(ur3_view, 1.0)
    typical = float(np.median(ur3_view.distances[0]))
    assert factor in FACTORS
    assert 0.04 < factor * typical < 0.13
    # A wild row that was flagged changes nothing.
    wild = np.array(ur3_view.measured)
    wild[:15] += 100.0
    kinds = ("flagged",) * 15 + ur3_view.kinds[15:]
    assert magnification(replace(ur3_view, measured=wild, kinds=kinds), 1.0) == pytest.approx(
        factor
    )


def test_arrows_of_robots_that_agree_or_lie_far_apart_are_not_magnified(ur3, ur3_view):
    assert magnification(View(ur3, ur3, np.zeros((2, 6))), 1.0) == 1
    assert magnification(replace(ur3_view, measured=ur3_view.measured + 5.0), 1.0) == 1


@pytest.fixture(scope="module")
def view(gantry, disturb):
    """A robot without meshes: its page is made at once."""
    rng = np.random.default_rng(4)
    q = rng.uniform(-0.5, 0.5, (35, 3))
    kinds = ("estimation",) * 30 + ("validation",) * 5
    plain = View(gantry, disturb(gantry), q, kinds=kinds)
    return replace(plain, measured=plain.predicted[1] + rng.normal(0, 1e-4, (35, 3)))


def text_of(view) -> str:
    return Reader(view_page(view).html).text


def test_the_legend_counts_the_rows_of_each_kind(view):
    gap = np.array(view.measured)
    gap[0] = np.nan
    kinds = ("flagged", "flagged", *view.kinds[2:])
    text = text_of(replace(view, measured=gap, kinds=kinds))
    assert "measured, fitted (28)" in text
    assert "measured, held back (5)" in text
    assert "measured, flagged (1)" in text  # the other one was not seen
    assert "error arrows, predicted to measured" in text
    assert "beams" not in text
    assert "region measured" not in text


def test_robots_without_measurements_have_arrows_from_one_to_the_other(view):
    plain = replace(
        view,
        measured=np.zeros((0, 3)),
        names=(("Old", "of spring"), ("New <b>", "of autumn")),
        title="",
    )
    text = text_of(plain)
    assert "from old to new <b>" in text
    assert "old solid, new <b> translucent" in text
    assert "gantry: old and new <b>" in text
    assert "measured" not in text


@pytest.mark.parametrize(
    ("verdict", "kind"), [("use", "use"), ("use with care", "care"), ("do not use", "no")]
)
def test_the_verdict_has_a_colour_of_its_own(view, verdict, kind):
    page = view_page(replace(view, verdict=verdict, note="Because."))
    assert f'<b class="verdict {kind}">Verdict: {verdict}.</b> Because.'.encode() in page.html


def test_names_add_no_tag_wherever_they_stand(view):
    named = [
        replace(
            view,
            labels=(name,) * 35,
            title=name,
            note=name,
            verdict=name,
            names=((name, name), (name, name)),
        )
        for name in (NASTY, "harmless")
    ]
    nasty, harmless = (Reader(view_page(view).html) for view in named)
    assert nasty.tags == harmless.tags
    assert len(nasty.scripts) == len(harmless.scripts)
