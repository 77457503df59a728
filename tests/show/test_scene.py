import base64
import os
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
from calib.errors import FileError, ModelError
from calib.model.robot import Robot
from calib.model.urdf import Urdf
from calib.show.scene import View, view_page, write_view

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1280,720",
    "--virtual-time-budget=4000",
    "--enable-logging=stderr",
    "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND",  # Chromium's own services are not called either
]
HOSTILE = "<script>document.title='owned'</script>\"'& é漢"


def scene_of(page) -> dict:
    """The scene's message in a page."""
    text = re.search(rb'id="scene">([^<]*)<', page.html).group(1)
    return umsgpack.unpackb(base64.b64decode(text))


def world_points(scene: dict, group: str) -> np.ndarray:
    """The origins of a group's objects in the scene, through every transform above them."""
    transforms = {
        c["path"]: np.array(c["matrix"]).reshape(4, 4).T
        for c in scene["commands"]
        if c["type"] == "set_transform"
    }
    points = []
    for command in scene["commands"]:
        path = command["path"]
        if command["type"] == "set_object" and path.startswith(f"/robots/{group}/"):
            T = np.eye(4)
            for i in range(2, len(path.split("/")) + 1):
                T = T @ transforms.get("/".join(path.split("/")[:i]), np.eye(4))
            points.append(T[:3, 3])
    return np.array(points)


def test_the_ur3_is_drawn_four_times_from_one_copy_of_its_meshes(ur3_page):
    assert ur3_page.warnings == ()
    assert len(ur3_page.html) < 7_000_000
    scene = scene_of(ur3_page)
    meshes = [
        g
        for g in scene["geometries"].values()
        if "normal" in g.get("data", {}).get("attributes", {})
    ]
    assert len(meshes) == 7
    for group in ("nominal/nominal", "calibrated/calibrated", "both/nominal", "both/calibrated"):
        drawn = [
            c
            for c in scene["commands"]
            if c["type"] == "set_object" and re.fullmatch(f"/robots/{group}/\\d+", c["path"])
        ]
        assert len(drawn) == 7
        material = drawn[0]["object"]["materials"][0]
        assert material["transparent"] == (group == "both/calibrated")


def test_targets_are_drawn_where_the_robots_put_them(ur3_view, ur3_page):
    scene = scene_of(ur3_page)
    transforms = {
        c["path"]: np.array(c["matrix"]).reshape(4, 4).T
        for c in scene["commands"]
        if c["type"] == "set_transform"
    }
    for who, robot in (("nominal", ur3_view.nominal), ("calibrated", ur3_view.calibrated)):
        T = robot.poses(ur3_view.q)[0]
        point = T[:3, :3] @ ur3_view.nominal_target + T[:3, 3]
        for group in (who, "both"):
            drawn = transforms[f"/robots/{group}/{who}/target"][:3, 3]
            np.testing.assert_allclose(drawn, point, atol=1e-12)
    here = transforms["/robots/both/measured/here"][:3, 3]
    np.testing.assert_array_equal(here, ur3_view.measured[30])
    distance = 1e3 * np.linalg.norm(
        transforms["/robots/nominal/nominal/target"]
        - transforms["/robots/calibrated/calibrated/target"]
    )
    assert f"target <b>{distance:.2f} mm</b> apart".encode() in ur3_page.html


@pytest.mark.parametrize("tilt", [-0.6, 0.4])
def test_a_robot_whose_base_moves_stands_upright(head_and_arm, disturb, tilt):
    q = np.array([tilt, -0.5, 0.2, -1.0, 0.1, 1.8, 0.6, -0.4, 0.7])
    target = np.array([0.0, 0.05, 0.1])
    measured = np.array([[0.1, 0.2, 0.9], [0.0, 0.1, 0.8]])
    calibrated = disturb(head_and_arm)
    page = view_page(View(head_and_arm, calibrated, q, target, target, measured, 1))
    scene = scene_of(page)
    transforms = {
        c["path"]: np.array(c["matrix"]).reshape(4, 4).T
        for c in scene["commands"]
        if c["type"] == "set_transform"
    }
    # How the camera is turned in the root, from a chain that ends there.
    camera = Robot.load("tiago_no_hand", "base_footprint", head_and_arm.base)
    values = dict(zip(head_and_arm.joint_names, q, strict=True))
    at_head = [values.get(name, 0.0) for name in camera.joint_names]
    R_root_base = camera.poses(at_head)[0][:3, :3]
    for who, robot in (("nominal", head_and_arm), ("calibrated", calibrated)):
        T = robot.poses(q)[0]
        point = R_root_base @ (T[:3, :3] @ target + T[:3, 3])
        drawn = transforms[f"/robots/both/{who}/target"][:3, 3]
        np.testing.assert_allclose(drawn, point, atol=1e-9)
    drawn = transforms["/robots/both/measured/here"][:3, 3]
    np.testing.assert_allclose(drawn, R_root_base @ measured[1], atol=1e-9)


@pytest.mark.parametrize("name", ["panda", "gantry", "head_and_arm", "fingers"])
def test_the_three_groups_do_not_touch(request, disturb, name):
    robot = request.getfixturevalue(name)
    q = np.full(len(robot.joint_names), 0.3)
    page = view_page(View(robot, disturb(robot), q))
    assert page.warnings == ()
    scene = scene_of(page)
    groups = [world_points(scene, group) for group in ("nominal", "both", "calibrated")]
    row = groups[2].mean(axis=0) - groups[0].mean(axis=0)
    row /= np.linalg.norm(row)
    ranges = [(g @ row).min() for g in groups], [(g @ row).max() for g in groups]
    assert ranges[1][0] < ranges[0][1]
    assert ranges[1][1] < ranges[0][2]


@pytest.mark.parametrize("scale", [0.1, 10.0])
def test_camera_and_floor_follow_the_robot_s_size(gantry, scale):
    def scaled(match: re.Match) -> str:
        return 'xyz="' + " ".join(repr(scale * float(v)) for v in match[1].split()) + '"'

    text = re.sub(r'(?<=<origin )xyz="([^"]*)"', scaled, gantry.urdf.data.decode())
    robot = Robot.from_urdf(Urdf.from_bytes(text.encode(), "scaled.urdf"), "rail", "tip")
    positions, squares = [], []
    for one, factor in ((gantry, 1.0), (robot, scale)):
        page = view_page(View(one, one, np.array([0.2 * factor, 0.1 * factor, 0.5])))
        positions += [
            np.array(c["value"])
            for c in scene_of(page)["commands"]
            if c["path"] == "/Cameras/default/rotated/<object>"
        ]
        squares.append(re.search(rb"Floor squares ([\d.]+) (m+)", page.html).groups())
    np.testing.assert_allclose(positions[1], scale * positions[0], rtol=1e-9)
    assert squares[0] != squares[1]


def test_a_robot_with_a_hostile_name_and_a_missing_mesh(disturb):
    text = data.paper_urdf().read_text(encoding="utf-8")
    text = text.replace('robot name="ur3"', f'robot name="{escape(HOSTILE)}"')
    text = text.replace("visual/wrist1.dae", f"visual/{escape(HOSTILE)}.dae")
    robot = Robot.from_urdf(Urdf.from_bytes(text.encode(), HOSTILE), "base", "tool0")
    page = view_page(View(robot, disturb(robot), np.full(6, 0.4), pose_name=HOSTILE))
    assert HOSTILE.encode() not in page.html
    assert f"<h1>{escape(HOSTILE)}: nominal and calibrated</h1>".encode() in page.html
    (warning,) = page.warnings
    assert warning.startswith("link 'wrist_1_link': the mesh 'package://example-robot-data/")
    assert escape(warning).encode() in page.html
    assert len(world_points(scene_of(page), "nominal")) == 6 + 2 + 1  # meshes, stick, target


def test_many_measured_points_are_one_cloud_and_a_wild_one_does_not_move_the_camera(ur3_view):
    points = np.random.default_rng(1).normal(size=(100_000, 3)) * 0.1 + [0.2, 0.2, 0.4]
    page = view_page(replace(ur3_view, measured=points, index=None))
    assert len(page.html) < 7_000_000
    scene = scene_of(page)
    drawn = [c["path"] for c in scene["commands"] if c["path"].startswith("/robots/both/measured")]
    assert drawn == ["/robots/both/measured/dots", "/robots/both/measured/dots/<object>"]

    def camera(measured):
        page = view_page(replace(ur3_view, measured=measured, index=None))
        return [
            c["value"]
            for c in scene_of(page)["commands"]
            if c["path"] == "/Cameras/default/rotated/<object>"
        ]

    assert camera(np.array([[1e4, 0, 0]])) == camera(np.zeros((0, 3)))


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
write_view(View(robot, robot, np.full(6, 0.3)), {str(tmp_path / "view.html")!r})
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros(5)}, r"q has shape \(5,\); finite numbers of shape \(6,\) are wanted"),
        ({"q": np.full(6, np.nan)}, "q has shape"),
        ({"nominal_target": np.zeros(2)}, "nominal_target has shape"),
        ({"calibrated_target": np.array([0, 0, np.inf])}, "calibrated_target has shape"),
        ({"measured": np.zeros((4, 2))}, r"measured has shape \(4, 2\); .* shape \(4, 3\)"),
        ({"measured": np.float64(1)}, "measured has shape"),
        ({"index": 35}, "index is 35, and there are 35 measured points"),
        ({"index": -1}, "index is -1"),
    ],
)
def test_what_does_not_fit_is_refused(ur3_view, change, message):
    with pytest.raises(ModelError, match=message):
        replace(ur3_view, **change)


def test_two_different_robots_are_refused(ur3, gantry):
    with pytest.raises(ModelError, match=r"'shoulder_pan_joint'.*'x', 'y', 'c'.*the same chain"):
        View(ur3, gantry, np.zeros(6))


def test_the_arrays_of_a_view_are_copies_that_cannot_be_written_to(ur3):
    q = np.zeros(6)
    view = View(ur3, ur3, q)
    q[0] = 1
    assert view.q[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        view.q[0] = 1


def browse(page: Path) -> tuple[np.ndarray, list[str]]:
    """What Chromium shows of a file, shape (H, W, 3), and the lines of the page's console."""
    shot, profile = page.with_name("shot.png"), page.with_name("profile")
    command = [
        CHROMIUM,
        *FLAGS,
        f"--user-data-dir={profile}",
        f"--screenshot={shot}",
        page.as_uri(),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    with Image.open(shot) as image:
        picture = np.asarray(image.convert("RGB")).astype(int)
    # Chromium's own remark on reading the picture back is not the page's.
    return picture, [line for line in console if "GL Driver Message" not in line]


@pytest.mark.skipif(
    CHROMIUM is None, reason="chromium is not installed: the page was not looked at"
)
@pytest.mark.parametrize("hostile", [False, True])
def test_chromium_shows_both_robots_and_calls_nobody(ur3_view, tmp_path, hostile):
    view = replace(ur3_view, title=HOSTILE * 5, pose_name=HOSTILE) if hostile else ur3_view
    page = write_view(view, tmp_path / "view.html")
    picture, console = browse(page)
    assert console == []  # no error, and nothing that the page's policy would have refused to load

    red, green, blue = np.moveaxis(picture, -1, 0)
    orange = (red - blue > 90) & (red > green)
    steel = (blue - red > 24) & (blue < 235)
    height, width = red.shape
    middle = slice(int(0.2 * height), int(0.8 * height))
    left, right = slice(0, int(0.33 * width)), slice(int(0.62 * width), width)
    assert steel[middle, left].mean() > 0.03
    assert orange[middle, left].mean() < 0.002
    assert orange[middle, right].mean() > 0.03
    assert steel[middle, right].mean() < 0.02
    overlaid = picture[middle, int(0.38 * width) : int(0.62 * width)].reshape(-1, 3)
    tan = (overlaid[:, 0] - overlaid[:, 2] > 30) & (overlaid[:, 0] - overlaid[:, 2] < 100)
    assert tan.mean() > 0.03  # translucent orange over grey
    dark = picture[: int(0.12 * height), : int(0.4 * width)].max(axis=-1) < 90
    assert dark.mean() > 0.005  # the heading


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
@pytest.mark.parametrize(
    "added",
    [
        b'<img src="https://example.org/x.png">',
        b"<script>fetch('https://example.org/x')</script>",
        b"<script>document.title = 'owned'</script>",
        b'<link rel="stylesheet" href="https://example.org/x.css">',
    ],
)
def test_chromium_would_report_what_the_policy_refuses(ur3_page, tmp_path, added):
    page = tmp_path / "view.html"
    page.write_bytes(ur3_page.html.replace(b"</body>", added + b"</body>"))
    _, console = browse(page)
    assert any("Content Security Policy" in line for line in console)


def test_the_browser_test_ran_where_it_can():
    """On a machine with Chromium at its usual place, the test above is not skipped."""
    if os.path.exists("/usr/bin/chromium"):  # noqa: PTH110
        assert CHROMIUM is not None
