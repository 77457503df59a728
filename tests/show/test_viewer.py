"""The live picture: robots where they were sent, what meshcat draws in every window, and its end."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import meshcat
import numpy as np
import pytest
import umsgpack
from meshcat import geometry as mc
from meshcat.animation import Animation

from calib import data
from calib.errors import CalibError, ModelError
from calib.show.view import View, translated
from calib.show.viewer import LiveWindow, Viewer

TARGET = translated([0.1, 0.2, 0.3])

#: The size of windows that need no more.
SMALL = (640, 400)

#: What was drawn by hand, on the page.
OWN = 'viewer.scene_tree.find(["robots", "calibrated", "own"]).children'


@pytest.fixture(scope="module")
def viewer(gantry, disturb):
    """Two robots of one page: no meshes, so that the page is small."""
    q = np.array([[0.1, 0.2, 0.3], [0.3, -0.1, 1.0]])
    view = View(gantry, disturb(gantry), q, nominal_target=TARGET, calibrated_target=TARGET)
    with Viewer(view) as viewer:
        yield viewer


def target_of(tab, who: str) -> list[float]:
    """Where the page has the target of a robot, in its base [m]."""
    return tab.evaluate(
        f"""(() => {{
            const links = viewer.scene_tree.find(["robots", "{who}", "robot", "links"]).children;
            const target = links[Object.keys(links).sort().at(-1)].object;
            const group = viewer.scene_tree.find(["robots", "{who}"]).object;
            viewer.scene.updateMatrixWorld(true);
            const inGroup = group.matrixWorld.clone().invert().multiply(target.matrixWorld);
            return inGroup.elements.slice(12, 15);
        }})()"""
    )


def test_robots_and_objects_are_the_same_in_every_window(browser, viewer, gantry, disturb):
    robots = {"nominal": gantry, "calibrated": disturb(gantry)}
    ball = viewer.visualizer["ball"]
    ball.set_object(mc.Sphere(0.2), mc.MeshLambertMaterial(color=0x00A000))
    with browser.open(viewer.url, SMALL) as one:
        for q in ([-1.0, 0.4, 2.0], [1.5, 0.5, -1.0]):
            viewer.display(q, f"at {q} <b>")
            one.wait_for(f"document.getElementById('pose').textContent.includes('at {q} <b>')")
            for who, robot in robots.items():
                there = (robot.poses(q)[0] @ TARGET)[:3, 3]
                np.testing.assert_allclose(target_of(one, who), there, atol=2e-6)
        ball.set_transform(translated([0.3, 0.2, 0.1]))
        viewer.visualizer["gone"].set_object(mc.Box([1, 1, 1]))
        one.wait_for(f"'gone' in {OWN}")
        viewer.visualizer["gone"].delete()
        viewer.display([0.5, 0.5, 0.5], "last")
        with browser.open(viewer.url, SMALL) as late:
            for tab in (one, late):
                tab.wait_for("document.getElementById('pose').textContent.includes('last')")
                assert tab.evaluate(f"Object.keys({OWN})") == ["ball"]
                assert tab.evaluate(f"{OWN}.ball.object.position.x") == 0.3
                there = (gantry.poses([0.5, 0.5, 0.5])[0] @ TARGET)[:3, 3]
                np.testing.assert_allclose(target_of(tab, "nominal"), there, atol=2e-6)
                assert tab.console == []
                assert tab.elsewhere == []
            assert [url.split("/", 3)[-1] for url in late.requests] == ["", "live"]
            colours = late.screenshot().astype(int)
            green = (colours[..., 1] - colours[..., 0] > 60) & (colours[..., 2] < 80)
            assert np.sum(green) > 100


@pytest.mark.parametrize(
    ("q", "has"),
    [
        ([0.0, 0.0], r"shape \(2,\)"),
        ([[0.0, 0.0, 0.0]], r"shape \(1, 3\)"),
        (1.0, r"shape \(\)"),
        ([0.0, 0.0, np.nan], "values that are not finite"),
        ([np.inf, 0.0, 0.0], "values that are not finite"),
    ],
)
def test_a_pose_that_is_none_is_refused(viewer, q, has):
    with pytest.raises(
        ModelError, match=rf"q has {has}; give .* \[rad\] or \[m\]: 'x', 'y', 'c'\."
    ):
        viewer.display(q)


def test_a_closed_viewer_says_so(gantry, browser):
    with Viewer(View(gantry, None, np.zeros((1, 3)))) as viewer:
        assert repr(viewer) == f"<Viewer {viewer.url}>"
        with browser.open(viewer.url, SMALL) as tab:
            viewer.display([0.1, 0.1, 0.1])
            viewer.close()
            tab.wait_for("document.body.textContent.includes('The server has stopped')")
            assert tab.console == []
    viewer.close()
    assert repr(viewer) == "<Viewer closed>"
    with pytest.raises(CalibError, match="was closed"):
        viewer.display([0.0, 0.0, 0.0])
    with pytest.raises(CalibError, match="was closed"):
        viewer.visualizer.set_object(mc.Sphere(0.1))


def test_what_was_drawn_is_kept_as_it_is_last():
    sent: list[bytes] = []
    window = LiveWindow(sent.append)
    root = meshcat.Visualizer.view_into(window, meshcat.path.Path())
    root["a"].set_object(mc.Sphere(1.0))
    root["a"].set_property("visible", False)
    root["a"].set_object(mc.Sphere(2.0))  # as in meshcat: an object comes without properties
    for value in (0.1, 0.2, 0.3):
        root["a"].set_property("opacity", value)
        root["a"].set_transform(translated([value, 0.0, 0.0]))
    root["a"]["deeper"].set_object(mc.Box([1.0, 1.0, 1.0]))
    root["b"].set_object(mc.Sphere(1.0))
    root["b"].delete()
    root["never drawn"].delete()
    animation = Animation()
    with animation.at_frame(root["a"], 1) as frame:
        frame.set_transform(translated([1.0, 0.0, 0.0]))
    root.set_animation(animation)
    assert len(sent) == 14
    kept = [umsgpack.unpackb(message) for message in window.messages()]
    said = {(m["path"], m["type"]): m for m in kept}
    assert len(said) == len(kept)
    assert set(said) == {
        ("/a", "set_object"),
        ("/a", "set_property"),
        ("/a", "set_transform"),
        ("/a/deeper", "set_object"),
        ("", "set_animation"),
    }
    assert said["/a", "set_object"]["object"]["geometries"][0]["radius"] == 2.0
    assert said["/a", "set_property"]["value"] == 0.3
    assert said["/a", "set_transform"]["matrix"][12] == 0.3
    root.delete()
    assert window.messages() == []


def test_many_threads_may_draw():
    window = LiveWindow(lambda _message: None)
    root = meshcat.Visualizer.view_into(window, meshcat.path.Path())

    def draw(i: int) -> None:
        for n in range(50):
            root[f"{i}"][f"{n}"].set_transform(np.eye(4))
            window.messages()

    threads = [threading.Thread(target=draw, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(window.messages()) == 200


def test_what_a_window_cannot_do_is_refused():
    with pytest.raises(CalibError, match="no meshcat command 'capture_image'"):
        LiveWindow(lambda _message: None).send(meshcat.commands.CaptureImage())


def test_a_page_that_asks_again_is_told_the_pose(viewer):
    viewer.display([0.1, 0.2, 0.3], "here")
    (pose,) = [m for m in viewer._welcome() if isinstance(m, str)]
    assert json.loads(pose)["pose"]["label"] == "here"


def test_the_document_s_example_runs_until_ctrl_c(tmp_path):
    text = (Path(__file__).parents[2] / "docs" / "view.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    for name in ("robot.urdf", "corrected.urdf"):
        urdf = data.paper_urdf().read_text(encoding="utf-8")
        # Without meshes, which take their time.
        plain = re.sub("<visual>.*?</visual>", "", urdf, flags=re.DOTALL)
        (tmp_path / name).write_text(plain, encoding="utf-8")
    (tmp_path / "browser.py").write_text("import sys; open('opened', 'w').write(sys.argv[1])")
    code = code.replace("sleep(0.03)", "sleep(0.001)")
    code = code.replace("    viewer.wait()", "    print('waits', flush=True)\n    viewer.wait()")
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "BROWSER": f"{sys.executable} browser.py %s"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    url = process.stdout.readline().strip()
    assert process.stdout.readline() == "waits\n"
    time.sleep(0.3)  # for it has said so before it does
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=20)
    assert (process.returncode, out, err) == (0, "", "")
    assert (tmp_path / "opened").read_text() == url
