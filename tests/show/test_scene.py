"""The picture: where robots, camera and floor are, and what a browser shows of it."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np
import pytest
import umsgpack
from PIL import Image

from calib import data
from calib.errors import FileError
from calib.model.robot import Robot
from calib.model.urdf import Urdf
from calib.show.cloud import cloud_of
from calib.show.palette import CALIBRATED, NOMINAL, OUTLIER, VALIDATION
from calib.show.scene import view_page, write_view
from calib.show.view import View
from tests.show.calibrations import made

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


@pytest.mark.parametrize("name", ["panda", "gantry", "head_and_arm", "fingers"])
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


@pytest.mark.parametrize("scale", [0.1, 10.0])
def test_camera_and_floor_follow_the_robot_s_size(gantry, scale):
    def scaled(match: re.Match) -> str:
        return 'xyz="' + " ".join(repr(scale * float(v)) for v in match[1].split()) + '"'

    text = re.sub(r'(?<=<origin )xyz="([^"]*)"', scaled, gantry.urdf.data.decode())
    robot = Robot.from_urdf(Urdf.from_bytes(text.encode(), "scaled.urdf"), "rail", "tip")
    positions, squares = [], []
    for one, factor in ((gantry, 1.0), (robot, scale)):
        page = view_page(View(one, one, np.array([[0.2 * factor, 0.1 * factor, 0.5]])))
        positions.append(np.array(camera(page)))
        squares.append(re.search(rb"Floor squares ([\d.]+) (m+)", page.html).groups())
    np.testing.assert_allclose(positions[1], scale * positions[0], rtol=1e-9)
    assert squares[0] != squares[1]


def test_a_robot_with_a_hostile_name_and_a_missing_mesh(disturb):
    text = data.paper_urdf().read_text(encoding="utf-8")
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
    q = rng.uniform(-1, 1, (20_000, 6))
    view = View(ur3, ur3, q, measured=ur3.poses(q)[:, :3, 3] + 0.001)
    page = view_page(view)
    assert len(page.html) < 7_000_000
    assert b"400 of 20,000 rows are shown" in page.html


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


def test_the_same_view_is_the_same_file(ur3_view, ur3_page):
    assert view_page(ur3_view).html == ur3_page.html


def test_no_socket_no_process_and_nothing_printed(tmp_path):
    program = f"""
import os, sys
seen = []
sys.addaudithook(lambda event, _: seen.append(event))
import numpy as np
from calib import data
from calib.model.robot import Robot
from calib.show.scene import View, write_view
robot = Robot.load(data.paper_urdf(), base="base", tip="tool0")
write_view(View(robot, robot, np.full((1, 6), 0.3)), {str(tmp_path / "view.html")!r})
bad = {{e for e in seen if e.startswith(("socket.bind", "socket.connect", "subprocess.", "os.posix_spawn", "os.fork"))}}
assert not bad, bad
if os.path.isdir("/proc/self/fd"):
    links = []
    for fd in os.listdir("/proc/self/fd"):
        try:
            links.append(os.readlink(f"/proc/self/fd/{{fd}}"))
        except OSError:
            pass
    assert not [link for link in links[3:] if link.startswith("socket:")], links
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert (tmp_path / "view.html").stat().st_size > 1_000_000


def test_an_existing_file_is_kept_unless_asked(ur3_view, ur3_page, tmp_path):
    path = tmp_path / "view.html"
    assert write_view(ur3_view, path) == path
    assert path.read_bytes() == ur3_page.html
    path.write_text("mine")
    with pytest.raises(FileError, match="exists already"):
        ur3_page.write(path)
    assert path.read_text() == "mine"
    ur3_page.write(path, overwrite=True)
    assert path.read_bytes() == ur3_page.html


def near(picture: np.ndarray, colour: str, tolerance: float = 0.10) -> np.ndarray:
    """Which pixels have the hue of a colour, lit or in the shade, shape (H, W)."""
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    pixels = picture / 255.0
    bright = np.linalg.norm(pixels, axis=-1)
    chroma = pixels.max(axis=-1) - pixels.min(axis=-1)
    along = (pixels @ wanted) / np.maximum(bright, 1e-9) / np.linalg.norm(wanted)
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


def printed(pdf: bytes, folder: Path) -> np.ndarray | None:
    """The first page of a PDF, shape (H, W, 3); None where poppler is not installed."""
    program = shutil.which("pdftoppm")
    if program is None:
        return None
    (folder / "page.pdf").write_bytes(pdf)
    command = [program, "-r", "40", "-png", "-singlefile", "page.pdf", "page"]
    subprocess.run(command, cwd=folder, check=True)
    with Image.open(folder / "page.png") as image:
        return np.asarray(image.convert("RGB"))


@pytest.fixture(scope="module")
def demo_page(tmp_path_factory):
    """The page of the paper's calibration, as the demo writes it."""
    from calib.show.pictures import view_of

    folder = tmp_path_factory.mktemp("demo")
    return write_view(view_of(made("paper")), folder / "view.html")


def test_chromium_shows_two_robots_with_arrows_and_calls_nobody(browser, demo_page):
    with browser.open(demo_page.as_uri(), size=(1280, 720)) as tab:
        picture = tab.screenshot()
        left, right = amounts(picture, NOMINAL)
        assert left > 0.06
        assert right < 0.004
        left, right = amounts(picture, CALIBRATED)
        assert left < 0.004
        assert right > 0.06
        assert sum(amounts(picture, VALIDATION)) > 1e-4  # balls of rows held back
        assert sum(amounts(picture, OUTLIER)) > 2e-5  # and of flagged ones
        legend = tab.evaluate("document.querySelector('footer').innerText")
        for word in (
            "nominal",
            "calibrated",
            "measured, fitted (28)",
            "held back (5)",
            "flagged (2)",
        ):
            assert word in legend
        said = tab.evaluate("document.querySelector('header').innerText")
        assert "Verdict: use." in said
        assert "Arrows from predicted towards measured, × 50. Robots true to scale." in said
        assert "row 35, held back" in said
        assert "nominal 3.61 mm" in said

        # Without the arrows there is less of the dark blue that only they have.
        tab.evaluate("document.querySelector('[data-show*=arrows]').click()")
        without = tab.screenshot()
        assert np.mean(np.any(picture != without, axis=-1)) > 0.002
        tab.evaluate("document.querySelector('[data-show*=arrows]').click()")
        np.testing.assert_array_equal(tab.screenshot(), picture)
        # On paper both robots stand too.
        paper = printed(tab.pdf(), demo_page.parent)
        if paper is not None:
            assert near(paper, NOMINAL).mean() > 0.01
            assert near(paper, CALIBRATED).mean() > 0.01
        assert tab.complaints == []  # no error, and nothing that the page's policy refused to load
        assert tab.elsewhere == []


def choose(tab, name: str, value: int) -> None:
    tab.evaluate(
        f"(() => {{ const e = document.getElementById('{name}'); e.value = '{value}'; "
        "e.dispatchEvent(new Event('change')); e.dispatchEvent(new Event('input')); })()"
    )


def test_chromium_lays_one_robot_over_the_other_and_magnifies_the_difference(browser, demo_page):
    with browser.open(demo_page.as_uri(), size=(1280, 720)) as tab:
        tab.click("[data-mode=over]")
        one = tab.screenshot()
        assert "Overlaid" in tab.evaluate(
            "[...document.querySelectorAll('.label')].filter(e => e.style.visibility == 'visible')"
            ".map(e => e.innerText).join()"
        )
        # Laid over each other the two are one brown robot; magnified, blue and orange come apart.
        apart = [near(one, colour).mean() for colour in (NOMINAL, CALIBRATED)]
        choose(tab, "robots", 50)
        many = tab.screenshot()
        assert near(many, NOMINAL).mean() > apart[0] + 0.005
        assert near(many, CALIBRATED).mean() > apart[1] + 0.002
        said = tab.evaluate("document.getElementById('factors').innerText")
        assert said == (
            "Arrows from predicted towards measured, × 50. Differences from nominal drawn × 50."
        )
        choose(tab, "arrows", 1000)
        assert "longer than the scene are cut" in tab.evaluate(
            "document.getElementById('factors').innerText"
        )
        assert tab.complaints == []


def node_matrix(tab, *path: str) -> np.ndarray:
    """Where a node of the scene is, shape (4, 4)."""
    names = ", ".join(f"'{name}'" for name in ("robots", *path))
    script = (
        f"(() => {{ const o = viewer.scene_tree.find([{names}]).object; o.updateMatrix(); "
        "return o.matrix.toArray(); })()"
    )
    return np.array(tab.evaluate(script)).reshape(4, 4).T


def test_the_slider_takes_both_robots_through_the_measured_poses(browser, demo_page):
    """The tips and targets in the browser are where the robots' own forward kinematics put them, at every factor."""
    from calib.show.pictures import view_of

    view = view_of(made("paper"), cloud=False)
    with browser.open(demo_page.as_uri(), size=(640, 360)) as tab:
        movers = tab.evaluate(
            "JSON.parse(document.getElementById('table').textContent).robots.nominal.movers"
        )
        target = f"{movers - 1:03d}"
        for row in (0, 17):
            choose(tab, "row", row)
            for factor in (1, 20):
                choose(tab, "robots", factor)
                nominal, calibrated = view.predicted[:, row]
                wanted = {
                    "nominal": nominal,
                    "calibrated": nominal + factor * (calibrated - nominal),
                }
                for who, place in wanted.items():
                    at = node_matrix(tab, who, "robot", "links", target)[:3, 3]
                    np.testing.assert_allclose(at, place, atol=2e-7 * factor)
                if factor == 1:  # the links too, their turns included
                    T = view.calibrated.poses(view.q[row])[0]
                    wrist = node_matrix(tab, "calibrated", "robot", "links", target)
                    np.testing.assert_allclose(wrist[:3, :3], T[:3, :3], atol=1e-6)
        assert tab.evaluate("document.getElementById('which').value") == "row 18, fitted"
        tab.evaluate("document.activeElement.blur()")
        tab.key("ArrowLeft")
        assert tab.evaluate("document.getElementById('which').value") == "row 17, fitted"
        # Near a mark the mouse is told its row, and a click goes there.
        x, y = tab.evaluate(
            "(() => { const T = MeshCat.THREE, t = JSON.parse(document.getElementById('table').textContent);"
            "const m = new Float32Array(Uint8Array.from(atob(t.measured), (c) => c.charCodeAt(0)).buffer);"
            "const at = new T.Vector3().fromArray(m, 3 * 33);"
            "viewer.scene_tree.find(['robots', 'nominal']).object.localToWorld(at).project(viewer.camera);"
            "return [(0.5 + 0.5 * at.x) * innerWidth, (0.5 - 0.5 * at.y) * innerHeight]; })()"
        )
        tab.mouse(x, y)
        assert tab.evaluate("document.getElementById('hint').textContent") == (
            "row 34, held back: 3.49 mm → 0.266 mm"
        )
        tab.mouse(x, y, click=True)
        assert tab.evaluate("document.getElementById('which').value") == "row 34, held back"
        choose(tab, "row", 16)
        tab.click("#play")
        tab.wait_for("document.getElementById('which').value.startsWith('row 18')")
        assert tab.complaints == []


def test_chromium_keeps_hostile_names_as_text(browser, tmp_path):
    """Whatever robot, joints, rows and files are called, nothing of it runs, and it is read whole."""
    from calib.show.pictures import view_of

    view = view_of(made("hostile_names"))
    labels = tuple(f"{HOSTILE} {label}" for label in view.labels)
    page = write_view(
        replace(view, labels=labels, note=HOSTILE, title=HOSTILE * 5), tmp_path / "v.html"
    )
    with browser.open(page.as_uri()) as tab:
        assert tab.evaluate("document.title") == HOSTILE * 5
        said = tab.evaluate("document.querySelector('header').innerText")
        assert said.count(HOSTILE) == 5 + 1 + 1
        assert HOSTILE in tab.evaluate("document.getElementById('which').value")
        assert tab.complaints == []
        assert tab.elsewhere == []


def test_chromium_would_report_what_the_policy_refuses(browser, ur3_page, tmp_path):
    page = tmp_path / "view.html"
    added = (
        b'<img src="https://example.org/x.png">'
        b"<script>fetch('https://example.org/x')</script>"
        b"<script>document.title = 'owned'</script>"
        b'<link rel="stylesheet" href="https://example.org/x.css">'
    )
    page.write_bytes(ur3_page.html.replace(b"</body>", added + b"</body>"))
    with browser.open(page.as_uri(), size=(320, 180)) as tab:
        tab.settle()
        said = [line.text for line in tab.complaints if "Content Security Policy" in line.text]
        assert tab.evaluate("document.title") == "ur3: nominal and calibrated"
    assert sum("inline script" in line for line in said) == 2
    assert any("x.png" in line for line in said)
    assert any("x.css" in line for line in said)


def test_the_address_says_what_is_shown_at_first(browser, demo_page):
    address = demo_page.as_uri() + "#row=99&mode=%3Cb%3E&robots=3&arrows=x"
    with browser.open(address, size=(320, 180)) as tab:
        said = tab.evaluate("document.querySelector('header').innerText")
        assert "row 35, held back." in said
        assert "Arrows from predicted towards measured, × 50. Robots true to scale." in said
        tab.evaluate("location.hash = 'row=12&mode=over&robots=20&arrows=5'")
        tab.wait_for("document.body.dataset.mode == 'over'")
        said = tab.evaluate("document.querySelector('header').innerText")
        assert "row 12, fitted." in said
        assert "measured, × 5. Differences from nominal drawn × 20." in said
        assert tab.complaints == []


def test_the_cloud_is_shown_on_request(browser, tmp_path):
    view = view_of_two_joints()
    page = write_view(view, tmp_path / "view.html")
    with browser.open(page.as_uri(), size=(640, 360)) as tab:
        before = tab.screenshot()
        tab.evaluate(
            "document.querySelector('[data-show=\"calibrated/cloud-everywhere\"]').click()"
        )
        left, right = parts(np.any(tab.screenshot() != before, axis=-1).astype(float))
        assert right.mean() > 0.01
        assert left.mean() < right.mean() / 5
        assert tab.complaints == []


def view_of_two_joints() -> View:
    """A planar arm with its cloud."""
    from calib.show.pictures import view_of

    result = made("two_joints")
    assert len(cloud_of(result).std) > 1000
    return view_of(result)
