"""The live page: served to this computer alone, the same robots and objects of meshcat in every window."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
import webbrowser
from pathlib import Path

import numpy as np
import pytest
from meshcat import geometry as mc

import calib
from calib import example
from calib.errors import FileError
from calib.show.scene.puppet import translation
from calib.verbs.view.live import Viewer
from calib.verbs.view.view import View
from tests.hard_cases import made
from tests.listening import listening
from tests.places import ROOT

TARGET = translation([0.1, 0.2, 0.3])

#: The size of windows that need no more.
SMALL = (640, 400)

#: Nodes that the program drew, on the page.
OWN = 'viewer.scene_tree.find(["robots", "calibrated", "own"]).children'


@pytest.fixture
def view(gantry, disturb):
    """Two robots of a page: no meshes, so that the page is small."""
    q = np.array([[0.1, 0.2, 0.3], [0.3, -0.1, 1.0]])
    return View(gantry, disturb(gantry), q, nominal_target=TARGET, calibrated_target=TARGET)


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="no /proc/net/tcp: not Linux")
def test_nothing_listens_beyond_this_computer_and_nothing_is_left(view):
    before = listening(os.getpid())
    with Viewer(view) as viewer:
        assert viewer.url == f"http://127.0.0.1:{viewer.port}/"
        viewer.display([0.0, 0.0, 0.0])
        viewer.visualizer["ball"].set_object(mc.Sphere(0.1))
        opened = [address for address in listening(os.getpid()) if address not in before]
        assert opened == [("127.0.0.1", viewer.port)]
    assert listening(os.getpid()) == before
    with socket.create_server(("127.0.0.1", viewer.port)):
        pass


def test_the_page_is_sent_to_those_who_ask_for_this_computer(view):
    with Viewer(view) as viewer:
        with urllib.request.urlopen(viewer.url, timeout=10) as answer:
            assert b"data-live" in answer.read()
        # A web site may let its own name point to 127.0.0.1.
        request = urllib.request.Request(viewer.url, headers={"Host": "evil.example"})
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(request, timeout=10)


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


@pytest.mark.slow
def test_robots_and_objects_are_the_same_in_every_window(browser, view):
    robots = {"nominal": view.nominal, "calibrated": view.calibrated}
    with Viewer(view) as viewer, browser.open(viewer.url, SMALL) as first:
        ball = viewer.visualizer["ball"]
        ball.set_object(mc.Sphere(0.2), mc.MeshLambertMaterial(color=0x00A000))
        for q in ([-1.0, 0.4, 2.0], [1.5, 0.5, -1.0]):
            viewer.display(q, f"at {q} <b>")
            first.wait_for(f"document.getElementById('pose').textContent.includes('at {q} <b>')")
            for who, robot in robots.items():
                expected = (robot.poses(q)[0] @ TARGET)[:3, 3]
                np.testing.assert_allclose(target_of(first, who), expected, atol=2e-6)
        ball.set_transform(translation([0.3, 0.2, 0.1]))
        viewer.visualizer["gone"].set_object(mc.Box([1, 1, 1]))
        first.wait_for(f"'gone' in {OWN}")
        viewer.visualizer["gone"].delete()
        viewer.display([0.5, 0.5, 0.5], "last")
        with browser.open(viewer.url, SMALL) as late:
            for tab in (first, late):
                tab.wait_for("document.getElementById('pose').textContent.includes('last')")
                assert tab.evaluate(f"Object.keys({OWN})") == ["ball"]
                assert tab.evaluate(f"{OWN}.ball.object.position.x") == 0.3
                expected = (view.nominal.poses([0.5, 0.5, 0.5])[0] @ TARGET)[:3, 3]
                np.testing.assert_allclose(target_of(tab, "nominal"), expected, atol=2e-6)
                assert tab.console == []
                assert tab.elsewhere == []
            assert [url.split("/", 3)[-1] for url in late.requests] == ["", "live"]
        viewer.close()
        first.wait_for("document.body.textContent.includes('The server has stopped')")


@pytest.mark.slow
def test_the_document_s_example_runs_until_ctrl_c(tmp_path):
    text = (ROOT / "docs" / "view.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    for name in ("robot.urdf", "corrected.urdf"):
        urdf = example.paper_urdf().read_text(encoding="utf-8")
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


def test_view_opens_a_file_or_serves_the_page(gantry, disturb, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    page = calib.view(made("two_joints"))
    assert opened == [page.as_uri()]
    assert "planar: nominal and calibrated" in page.read_text(encoding="utf-8")
    text = calib.view(gantry, disturb(gantry)).read_text(encoding="utf-8")
    assert "<strong>First</strong>" in text
    assert "<strong>" not in calib.view(gantry).read_text(encoding="utf-8")
    with calib.view(gantry, live=True) as viewer:
        assert opened[-1] == viewer.url
        viewer.display(np.zeros(3))
        with urllib.request.urlopen(viewer.url, timeout=10) as answer:
            assert b"data-live" in answer.read()


def test_view_writes_the_named_file_alone_and_opens_nothing(gantry, monkeypatch, tmp_path):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
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
