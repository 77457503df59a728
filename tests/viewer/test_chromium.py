"""The pages in a real browser: what is seen, what the controls do, and that nothing runs or loads that should not."""

from __future__ import annotations

import numpy as np
import pytest

from calib.report.figure_base import CALIBRATED, NOMINAL, OUTLIER, VALIDATION
from calib.viewer.page import view_page
from calib.viewer.view import View, view_of
from tests.hard_cases import made

HOSTILE = "<script>document.title='owned'</script>\"'& é漢"


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
    """Where a node of the scene is, shape (4, 4)."""
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
        assert tab.complaints == []  # no error, and nothing that the page's policy refused to load
        assert tab.elsewhere == []


@pytest.mark.slow
def test_the_slider_takes_both_robots_through_the_measured_poses(browser, demo_page):
    """The tips and targets in the browser are where the robots' own forward kinematics put them, at every factor."""
    view = view_of(made("paper"))
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
        tab.key("ArrowLeft", 37)
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
