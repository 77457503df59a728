"""Pages hold a view's content, load nothing, and let no name be more than text; so in a real browser too."""

from __future__ import annotations

import base64
import json
import re
import sys
import webbrowser
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.errors import FileError
from calib.show.look import CALIBRATED, NOMINAL, OUTLIER, SURE_TO_UNSURE, VALIDATION
from calib.show.scene.posed_robot import packed, read_visuals, translation
from calib.show.uncertainty_map import UncertaintyMap
from calib.verbs.view.robots_page import (
    FACTORS,
    magnification,
    pose_robots,
    script_table,
    view_page,
)
from calib.verbs.view.view import Measured, View, view_of
from tests.hard_cases import made
from tests.show.scene.test_html_page import Reader
from tests.view_fixtures import registered, scene_of, with_points

NASTY = "</script><script>alert(1)</script> \"'&<!-- é漢字 \udcff"


#: A name that would run as a script.
HOSTILE = "<script>document.title='owned'</script>\"'& é漢"


def table_of(page) -> dict:
    """The values for the script of a page."""
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
    return with_points(plain, plain.predicted[1] + rng.normal(0, 1e-4, (35, 3)))


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
    shown = pose_robots(
        view, {name: read_visuals(robot.urdf)[0] for name, robot in view.robots.items()}
    )
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
    gap = np.array(view.points)
    gap[3] = np.nan
    errors = np.linalg.norm(gap - view.predicted, axis=2)
    view = replace(view, measured=Measured(gap, {"m": errors}), start=30)
    shown = pose_robots(
        view, {name: read_visuals(robot.urdf)[0] for name, robot in view.robots.items()}
    )
    table = script_table(view, shown)
    json.dumps(table, allow_nan=False)  # plain numbers only
    for who, robot in shown.items():
        count = robot.poses.shape[1]
        assert table["robots"][who]["movers"] == count
        poses = floats(table["robots"][who]["poses"], 35, count, 7)
        np.testing.assert_array_equal(poses, packed(robot.poses))
    np.testing.assert_allclose(floats(table["measured"], 35, 3), gap, atol=1e-7)
    (unit,) = table["errors"]
    assert (unit["factor"], unit["mark"]) == (pytest.approx(1e3), " mm")
    sent = [floats(values, 35) for values in unit["robots"]]
    np.testing.assert_allclose(sent, errors, rtol=1e-6)
    assert (table["start"], table["kinds"][30]) == (30, "validation")
    assert (table["instruments"], table["bases"], table["numbers"]) == ([], "", {})
    T = translation([0.001, 0.002, -0.003])
    apart = script_table(registered(view, T), shown)
    np.testing.assert_allclose(
        floats(apart["bases"], 35, 7), [[0.001, 0.002, -0.003, 0, 0, 0, 1]] * 35, rtol=1e-6
    )
    stations = translation([3.0, 1.0, 0.5])[None]
    tracked = script_table(replace(view, measured=replace(view.measured, stations=stations)), shown)
    np.testing.assert_allclose(tracked["instruments"], [[3.0, 1.0, 0.5, 0.0, 0.0, 0.0, 1.0]])


def test_typical_arrows_are_well_visible(ur3, ur3_view):
    factor = magnification(ur3_view, 1.0)
    assert factor in FACTORS
    assert 0.04 < factor * float(np.median(ur3_view.measured.errors["m"][0])) < 0.13
    # A wild row that was flagged changes nothing.
    wild = np.array(ur3_view.points)
    wild[:15] += 100.0
    kinds = ("flagged",) * 15 + ur3_view.kinds[15:]
    assert magnification(replace(with_points(ur3_view, wild), kinds=kinds), 1.0) == factor
    assert magnification(View(ur3, ur3, np.zeros((2, 6))), 1.0) == 1


def test_the_map_of_uncertainty_is_a_dot_for_each_pose_and_off_at_first(view):
    position = np.linspace(1e-4, 5e-4, 3)
    places = np.array([[0.0, 0.1, 0.2], [0.3, 0.4, 0.5], [0.6, 0.7, 0.8]])
    shown = UncertaintyMap(np.zeros((3, 3)), places, position)
    page = view_page(replace(view, uncertainty=shown))
    scene = scene_of(page)
    (dots,) = [
        c
        for c in scene["commands"]
        if c["type"] == "set_object" and c["path"] == "/robots/calibrated/uncertainty"
    ]
    (name,) = dots["object"]["geometries"]
    attributes = scene["geometries"][name]["data"]["attributes"]
    at, colours = (
        np.frombuffer(attributes[key]["array"].data, dtype="<f4").reshape(3, 3)
        for key in ("position", "color")
    )
    np.testing.assert_allclose(at, places, atol=1e-6)
    first, last = (
        [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        for colour in (SURE_TO_UNSURE[0], SURE_TO_UNSURE[-1])
    )
    np.testing.assert_allclose(colours[[0, 2]], [first, last], atol=1e-6)
    html = page.html.decode()
    assert '<input type="checkbox" data-show="calibrated/uncertainty">' in html
    assert "0.100 to 0.492 mm: 3 poses" in html
    assert len(page.html) < len(view_page(view).html) + 2000
    assert b"calibrated/uncertainty" not in view_page(view).html


def test_the_legend_counts_the_measured_rows(view):
    gap = np.array(view.points)
    gap[0] = np.nan
    kinds = ("flagged", "flagged", *view.kinds[2:])
    shown = with_points(view, gap)
    page = view_page(replace(shown, kinds=kinds, verdict="use with care", note="So."))
    text = Reader(page.html).text
    for words in (
        "estimation (28)",
        "validation (5)",
        "flagged (1)",
    ):  # the second one has no position
        assert f"measured, {words}" in text
    assert "error arrows, predicted to measured" in text
    assert "measurement frame" not in text
    assert b'<b class="verdict care">Verdict: use with care.</b> So.' in page.html


def test_two_equal_robots_side_by_side_look_equal(view):
    """The long lens: each is seen from nearly the same side."""
    table = table_of(view_page(view))
    x, y, z = table["cameras"]["side"]  # y is up
    camera = np.array([x, -z, y])
    ways = [camera - table["places"][who] for who in ("nominal", "calibrated")]
    cosine = np.dot(*ways) / np.prod(np.linalg.norm(ways, axis=1))
    assert np.degrees(np.arccos(cosine)) < 10


def test_the_tracker_s_view_is_offered_where_frames_were_registered(view):
    T = translation([0.01, 0.0, 0.0])
    for bases, offered in ((np.eye(4), False), (T, True)):
        html = view_page(registered(view, bases)).html
        assert (b'data-anchor="tracker"' in html) is offered


# The page as a file


@pytest.fixture
def opened(monkeypatch):
    """The addresses that a browser was asked to open, on a computer that has one."""
    addresses = []
    monkeypatch.setattr(webbrowser, "open", addresses.append)
    monkeypatch.setenv("BROWSER", "some")
    return addresses


def test_view_opens_a_temporary_file(gantry, disturb, opened):
    page = calib.view(made("two_joints"))
    assert opened == [page.as_uri()]
    assert "planar: nominal and calibrated" in page.read_text(encoding="utf-8")
    text = calib.view(gantry, disturb(gantry)).read_text(encoding="utf-8")
    assert "<strong>First</strong>" in text
    assert "<strong>" not in calib.view(gantry).read_text(encoding="utf-8")


def test_without_a_graphical_browser_view_opens_nothing(gantry, opened, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert calib.view(gantry).exists()
    assert opened == []


def test_view_writes_the_named_file_alone_and_opens_nothing(gantry, opened, tmp_path):
    path = tmp_path / "view.html"
    assert calib.view(gantry, path=str(path)) == path
    first = path.read_bytes()
    with pytest.raises(FileError):
        calib.view(made("two_joints"), path=path)
    assert path.read_bytes() == first
    assert calib.view(made("two_joints"), path=path, overwrite=True) == path
    assert path.read_bytes() != first
    assert opened == []
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(FileError):
        calib.view(gantry, path=tmp_path / "none" / "view.html")


# In a real browser


def near(picture: np.ndarray, colour: str, tolerance: float = 0.10) -> np.ndarray:
    """The pixels that have the hue of a colour, lit or in the shade, shape (H, W)."""
    expected = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    pixels = picture / 255.0
    bright = np.linalg.norm(pixels, axis=-1)
    chroma = pixels.max(axis=-1) - pixels.min(axis=-1)
    along = (pixels @ expected) / np.maximum(bright, 1e-9) / np.linalg.norm(expected)
    return (np.arccos(np.clip(along, -1, 1)) < tolerance) & (chroma > 0.12)


def parts(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The left and the right half of the canvas, without the text above and below."""
    height, width = picture.shape[:2]
    middle = picture[int(0.17 * height) : int(0.78 * height)]
    return middle[:, : width // 2], middle[:, width // 2 :]


def amounts(picture: np.ndarray, colour: str) -> tuple[float, float]:
    """The share of each half that has a colour."""
    left, right = (float(near(half, colour).mean()) for half in parts(picture))
    return left, right


@pytest.fixture(scope="module")
def demo_page(tmp_path_factory):
    """The page of the paper's calibration, as the demo writes it."""
    folder = tmp_path_factory.mktemp("demo")
    return view_page(view_of(made("paper"))).write(folder / "view.html")


def choose(tab, name: str, value: int) -> None:
    tab.evaluate(
        f"(() => {{ const e = document.getElementById('{name}'); e.value = '{value}'; "
        "e.dispatchEvent(new Event('change')); e.dispatchEvent(new Event('input')); })()"
    )


def node_matrix(tab, *path: str) -> np.ndarray:
    """The transform of a node of the scene, shape (4, 4)."""
    names = ", ".join(f"'{name}'" for name in ("robots", *path))
    script = (
        f"(() => {{ const o = viewer.scene_tree.find([{names}]).object; o.updateMatrix(); "
        "return o.matrix.toArray(); })()"
    )
    return np.array(tab.evaluate(script)).reshape(4, 4).T


@pytest.mark.slow
def test_chromium_shows_two_robots_with_arrows_and_calls_nobody(browser, demo_page):
    with browser.open(demo_page.as_uri(), size=(1280, 720)) as tab:
        picture = tab.screenshot()
        left, right = amounts(picture, NOMINAL)
        assert left > 0.06
        assert right < 0.004
        left, right = amounts(picture, CALIBRATED)
        assert left < 0.004
        assert right > 0.06
        assert sum(amounts(picture, VALIDATION)) > 1e-4  # balls of validation rows
        assert sum(amounts(picture, OUTLIER)) > 2e-5  # and of flagged ones
        legend = tab.evaluate("document.querySelector('footer').innerText")
        for word in (
            "nominal",
            "calibrated",
            "measured, estimation (28)",
            "validation (5)",
            "flagged (2)",
        ):
            assert word in legend
        header = tab.evaluate("document.querySelector('header').innerText")
        assert "Verdict: use." in header
        assert "Arrows from predicted towards measured, × 50. Robots true to scale." in header
        assert "row 5, estimation" in header
        assert "nominal 2.54 mm" in header

        # The map of uncertainty comes with its box.
        tab.evaluate("document.querySelector('[data-show*=uncertainty]').click()")
        with_map = tab.screenshot()
        assert np.mean(np.any(picture != with_map, axis=-1)) > 0.005
        tab.evaluate("document.querySelector('[data-show*=uncertainty]').click()")
        np.testing.assert_array_equal(tab.screenshot(), picture)

        # Without the arrows there is less of the dark blue that only they have.
        tab.evaluate("document.querySelector('[data-show*=arrows]').click()")
        without = tab.screenshot()
        assert np.mean(np.any(picture != without, axis=-1)) > 0.002
        tab.evaluate("document.querySelector('[data-show*=arrows]').click()")
        np.testing.assert_array_equal(tab.screenshot(), picture)
        assert tab.complaints == []  # no error, and nothing that the page's policy refused to load
        assert tab.elsewhere == []


@pytest.mark.slow
def test_the_slider_takes_both_robots_through_the_measured_poses(browser, demo_page):
    """The tips and targets in the browser are where the robots' own forward kinematics put them, at every factor."""
    view = view_of(made("paper"))
    with browser.open(demo_page.as_uri(), size=(1280, 720)) as tab:
        movers = tab.evaluate(
            "JSON.parse(document.getElementById('table').textContent).robots.nominal.movers"
        )
        target = f"{movers - 1:03d}"
        for row in (0, 17):
            choose(tab, "row", row)
            for factor in (1, 20):
                # Side by side the robots are true to scale, whatever the arrows' factor.
                choose(tab, "factor", 20)
                tab.click(f"[data-mode={'side' if factor == 1 else 'over'}]")
                nominal, calibrated = view.predicted[:, row]
                expected = {
                    "nominal": nominal,
                    "calibrated": nominal + factor * (calibrated - nominal),
                }
                for who, place in expected.items():
                    at = node_matrix(tab, who, "robot", "links", target)[:3, 3]
                    np.testing.assert_allclose(at, place, atol=2e-7 * factor)
                if factor == 1:  # the links too, their turns included
                    T = view.calibrated.poses(view.q[row])[0]
                    wrist = node_matrix(tab, "calibrated", "robot", "links", target)
                    np.testing.assert_allclose(wrist[:3, :3], T[:3, :3], atol=1e-6)
        tab.click("[data-mode=side]")
        assert tab.evaluate("document.getElementById('which').value") == "row 18, estimation"
        tab.evaluate("document.activeElement.blur()")
        tab.key("ArrowLeft", 37)
        assert tab.evaluate("document.getElementById('which').value") == "row 17, estimation"
        # Where marks are drawn is known when the picture is: two frames later.
        tab.evaluate(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )
        # Near a mark the mouse is told its row, and a click goes there; on the mark furthest from all others.
        row, x, y = tab.evaluate(
            "(() => { const T = MeshCat.THREE, t = JSON.parse(document.getElementById('table').textContent);"
            "const m = new Float32Array(Uint8Array.from(atob(t.measured), (c) => c.charCodeAt(0)).buffer);"
            "const marks = []; for (const who of ['nominal', 'calibrated']) {"
            "const robot = viewer.scene_tree.find(['robots', who]).object;"
            "for (let row = 0; 3 * row < m.length; row++) {"
            "const at = robot.localToWorld(new T.Vector3().fromArray(m, 3 * row)).project(viewer.camera);"
            "marks.push([row, (0.5 + 0.5 * at.x) * innerWidth, (0.5 - 0.5 * at.y) * innerHeight]); } }"
            "const apart = ([, x, y]) => marks.map(([, u, v]) => Math.hypot(u - x, v - y)).sort((a, b) => a - b)[1];"
            "return marks.reduce((best, mark) => apart(mark) > apart(best) ? mark : best); })()"
        )
        tab.mouse(x, y)
        number = int(row) + 1
        assert tab.evaluate("document.getElementById('hint').textContent").startswith(
            f"row {number}, "
        )
        tab.mouse(x, y, click=True)
        shown = tab.evaluate("document.getElementById('which').value")
        assert shown.startswith(f"row {number}, ")
        choose(tab, "row", 16)
        tab.click("#play")
        tab.wait_for("document.getElementById('which').value.startsWith('row 18')")
        assert tab.complaints == []


def test_a_page_shows_its_robot_and_keeps_hostile_names_as_text(browser, gantry, tmp_path):
    """The one test with a browser in every run: the scripts work, nothing of a name runs, nothing is loaded."""
    q = np.array([[0.1, 0.2, 0.3], [0.3, -0.1, 1.0]])
    shown = View(gantry, gantry, q, labels=(HOSTILE, "b"), note=HOSTILE, title=HOSTILE)
    page = view_page(shown).write(tmp_path / "v.html")
    with browser.open(page.as_uri(), size=(640, 360)) as tab:
        assert tab.evaluate("document.title") == HOSTILE
        assert tab.evaluate("document.querySelector('header').innerText").count(HOSTILE) == 3
        assert (
            min(amounts(tab.screenshot(), NOMINAL)[0], amounts(tab.screenshot(), CALIBRATED)[1])
            > 0.001
        )
        tab.click("#forward")
        assert tab.evaluate("document.getElementById('which').value") == "b"
        assert tab.complaints == []
        assert tab.elsewhere == []


#: The targets in the picture: of each robot, and where the target of the row shown was measured.
SEEN = """(() => {
  const at = (...path) => viewer.scene_tree.find(['robots', ...path]).object;
  const T = JSON.parse(document.getElementById('table').textContent);
  const target = (who) => {
    const name = String(T.robots[who].movers - 1).padStart(3, '0');
    return at(who, 'robot', 'links', name).position.toArray();
  };
  const row = Number(document.getElementById('row').value);
  const matrix = new MeshCat.THREE.Matrix4(), arrow = [];
  // The arrow of the row shown: a shaft from its foot along y, and a head at its end.
  const now = at('nominal', 'arrows').children.filter((one) => one.isInstancedMesh && one.count === 1);
  for (const part of now) {
    part.getMatrixAt(0, matrix);
    const y = new MeshCat.THREE.Vector3(0, 1, 0).applyMatrix4(matrix).toArray();
    arrow.push([new MeshCat.THREE.Vector3().applyMatrix4(matrix).toArray(), y]);
  }
  return { nominal: target('nominal'), calibrated: target('calibrated'), arrow, row, mode: document.body.dataset.mode };
})()"""


@pytest.mark.slow
def test_overlaid_one_factor_holds_for_robots_targets_and_arrows(browser, view, tmp_path):
    """Each arrow connects what is seen; at the base or as registered, by old and by new addresses."""
    T = translation([0.02, -0.01, 0.005])
    apart = registered(view, T)
    page = view_page(apart).write(tmp_path / "v.html").as_uri()
    k = 11
    own = view.predicted[0, k]  # of the nominal robot in its own base
    for address, factor, base in (
        ("pose=12&mode=over&factor=20", 20, np.zeros(3)),
        ("pose=12&mode=over&robots=20&arrows=5", 20, np.zeros(3)),
        ("pose=12&mode=over&factor=5&anchor=tracker", 5, T[:3, 3]),
    ):
        with browser.open(f"{page}#{address}", size=(1280, 720)) as tab:
            seen = tab.evaluate(SEEN)
            nominal = own + base
            assert (seen["row"], seen["mode"]) == (k, "over")
            np.testing.assert_allclose(seen["nominal"], nominal, atol=1e-6)
            magnified = nominal + factor * (view.predicted[1, k] - nominal)
            np.testing.assert_allclose(seen["calibrated"], magnified, atol=1e-5)
            shaft, head = seen["arrow"]
            np.testing.assert_allclose(shaft[0], nominal, atol=1e-6)
            end = nominal + factor * (view.points[k] - nominal)
            np.testing.assert_allclose(head[1], end, atol=1e-5)
            assert tab.evaluate("document.getElementById('factor').value") == str(factor)
            assert tab.complaints == []
    # Side by side the arrow is the residual of the registered robot, in its own base.
    with browser.open(f"{page}#pose=12&mode=side&arrows=2", size=(1280, 720)) as tab:
        shaft, head = tab.evaluate(SEEN)["arrow"]
        residual = view.points[k] - (own + T[:3, 3])
        np.testing.assert_allclose(np.subtract(head[1], shaft[0]), 2 * residual, atol=1e-5)
        assert tab.evaluate("document.getElementById('anchors').hidden")


@pytest.mark.slow
@pytest.mark.parametrize(("count", "opacity"), [(40, 1.0), (41, 0.3)])
def test_arrows_of_many_rows_are_faint_but_for_the_row_shown(
    browser, gantry, disturb, tmp_path, count, opacity
):
    q = np.random.default_rng(1).uniform(-0.5, 0.5, (count, 3))
    crowd = View(gantry, disturb(gantry), q, kinds=("estimation",) * count)
    crowd = with_points(crowd, crowd.predicted[1])
    page = view_page(crowd).write(tmp_path / "v.html").as_uri()
    script = (
        "viewer.scene_tree.find(['robots', 'nominal', 'arrows']).object.children"
        ".filter((one) => one.isInstancedMesh).map((one) => [one.count, one.material.opacity])"
    )
    with browser.open(page) as tab:
        expected = [[1, 1], [1, 1], [count, opacity], [count, opacity]]
        assert sorted(tab.evaluate(script)) == expected


@pytest.mark.slow
def test_on_a_phone_the_page_is_stacked_and_fits_the_width(browser, view, tmp_path):
    apart = registered(view, translation([0.02, 0.0, 0.0]))
    apart = replace(apart, verdict="use", note="So. " * 40)
    page = view_page(apart).write(tmp_path / "v.html").as_uri()
    box = "document.querySelector('%s').getBoundingClientRect()"
    with browser.open(f"{page}#mode=over", size=(412, 860)) as tab:
        assert tab.evaluate("document.documentElement.scrollWidth") <= 412
        bottom = tab.evaluate(f"{box % '#picture'}.bottom")
        for part in (".player", ".panel", "#pose", "#inset", "#layers"):
            assert tab.evaluate(f"{box % part}.top") >= bottom
            assert tab.evaluate(f"{box % part}.right") <= 412
        assert not tab.evaluate("document.getElementById('layers').open")
        touched = "[...document.querySelectorAll('button, select, #row')]"
        heights = f"{touched}.map((one) => one.getBoundingClientRect().height)"
        assert min(tab.evaluate(heights)) >= 44
        drawn = tab.evaluate(
            "[viewer.renderer.domElement.clientWidth, viewer.renderer.domElement.clientHeight]"
        )
        assert drawn == [
            412,
            pytest.approx(bottom - tab.evaluate(f"{box % '#picture'}.top"), abs=1),
        ]
        tab.click("#forward")
        assert "pose 2" in tab.evaluate("document.getElementById('which').value")
        assert tab.complaints == []
    with browser.open(page, size=(1400, 900)) as tab:
        assert tab.evaluate("document.getElementById('layers').open")
        # On paper, A4 on its side, the whole picture.
        tab.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        scale = "document.getElementById('picture').style.getPropertyValue('--k')"
        assert float(tab.evaluate(scale)) == pytest.approx(1122 / 1400)
