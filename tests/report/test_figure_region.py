"""Figures of a region: readable by others, true to the region, with no trace in global state."""

from __future__ import annotations

import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from calib import example
from calib.data.measurements import Measurements
from calib.data.ranges import joint_ranges
from calib.design.workspace import Density, sample_workspace
from calib.errors import FileError
from calib.report.figure_region import Marked, RegionView, draw_region, outline, write_picture


@pytest.fixture(scope="module")
def rows(ur3):
    return Measurements.read(example.paper_measurements(), ur3.joint_names, ur3.joint_types)


@pytest.fixture(scope="module")
def marked(rows):
    return Marked(rows.points, rows.rows, rows.validation)


@pytest.fixture(scope="module")
def density(ur3, rows):
    q = rows.joints_for(ur3.joint_names)[rows.estimation]
    ranges = joint_ranges(ur3, like=q, margin=np.radians(5.0))
    return Density.of(sample_workspace(ur3, example.PAPER_TARGET, ranges, 2**15))


@pytest.fixture(scope="module")
def region(density):
    return density.region(0.95)


def shown(density, region, title, text="", marked=None) -> RegionView:
    """What a figure shows; the robot is for pages."""
    return RegionView(None, None, None, density, region, title, text, marked)


def test_png_svg_and_pdf_open_elsewhere(density, region, marked, tmp_path):
    paths = [
        write_picture(shown(density, region, title="t", marked=marked), tmp_path / name)
        for name in ("a.png", "a.SVG", "a.pdf")
    ]
    with Image.open(paths[0]) as image:
        image.load()
        assert image.size == (1950, 1380)
        pixels = np.asarray(image.convert("RGB")).astype(int)
    orange = (pixels[..., 0] > 200) & (pixels[..., 2] < 110)
    green = (pixels[..., 1] - pixels[..., 0] > 90) & (pixels[..., 1] > 140)
    assert 0.02 < orange.mean() < 0.5
    assert green.sum() > 500  # the validation rows
    assert ElementTree.parse(paths[1]).getroot().tag == "{http://www.w3.org/2000/svg}svg"
    pdf = paths[2].read_bytes()
    assert pdf.startswith(b"%PDF-")
    assert pdf.rstrip().endswith(b"%%EOF")


def test_the_same_figure_is_the_same_file(density, region, tmp_path):
    view = shown(density, region, title="t")
    first, second = (write_picture(view, tmp_path / f"{n}.svg").read_bytes() for n in "ab")
    assert first == second


def texts(figure):
    axes = [text.get_text() for ax in figure.axes for text in (ax.title, *ax.texts)]
    return axes + [text.get_text() for text in figure.texts]


def test_rows_inside_and_outside_are_counted_and_numbered(density, region, marked):
    figure = draw_region(shown(density, region, title="Title", text="below", marked=marked))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [
        "outline of the region",
        "30 estimation rows inside",
        "3 validation rows inside",
        "2 validation rows outside",
    ]
    said = texts(figure)
    assert {"Title", "below", "Seen from above", "base"} <= set(said)
    for number in ("31", "32", "33", "34", "35"):
        assert said.count(number) == 3  # once in each view
    assert "30" not in said


def test_what_is_drawn_is_the_region(density, region):
    figure = draw_region(shown(density, region, title="t"))
    panels = figure.axes[:6]
    pairs = [(0, 1), (0, 2), (1, 2)]
    for panel, (i, j) in zip(panels, pairs * 2, strict=True):
        image = panel.images[0].get_array()
        assert float(image.max()) == 1.0
        assert image.shape == (density.counts.shape[j], density.counts.shape[i])
        x, y = panel.get_xlim(), panel.get_ylim()
        assert x[0] < density.extent[0, i] < density.extent[1, i] < x[1]
        assert y[0] < density.extent[0, j] < density.extent[1, j] < y[1]
    for panel, (i, j) in zip(panels[:3], pairs, strict=True):
        lines = np.array(panel.collections[0].get_segments()).reshape(-1, 2)
        np.testing.assert_allclose(lines.min(axis=0), region.bounds[0, [i, j]], atol=1e-12)
        np.testing.assert_allclose(lines.max(axis=0), region.bounds[1, [i, j]], atol=1e-12)


def test_a_box_cuts_the_outline(ur3):
    points = sample_workspace(ur3, count=2**13)
    density = Density.of(points, box=[[-0.3, -np.inf, -np.inf], [np.inf, 0.2, np.inf]])
    figure = draw_region(shown(density, density.region(0.9), title="t"))
    lines = np.array(figure.axes[0].collections[0].get_segments()).reshape(-1, 2)
    assert lines[:, 0].min() >= -0.3
    assert lines[:, 1].max() <= 0.2


def test_the_outline_of_cells():
    inside = np.array([[True, True], [False, True]])
    edges = outline(inside, np.array([1.0, 2.0]), 0.5)
    assert len(edges) == 8
    np.testing.assert_allclose(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1), 0.5)
    found = {tuple(np.round(edge.ravel(), 9)) for edge in edges}
    assert (1.0, 2.0, 1.0, 2.5) in found  # left of the first
    assert (1.0, 2.0, 1.5, 2.0) in found  # below it
    assert (1.5, 2.0, 1.5, 2.5) in found  # between it and the one that is not inside
    assert (1.5, 2.5, 1.5, 3.0) not in found  # between two that are


@pytest.mark.parametrize("count", [0, 5000])
def test_any_number_of_rows(density, region, count):
    rng = np.random.default_rng(0)
    # A wild one among them must not make the workspace small.
    points = rng.normal(size=(count, 3)) * 0.2
    points[:1] = 1e3
    marked = Marked(points, tuple(range(1, count + 1)), rng.random(count) < 0.5)
    figure = draw_region(shown(density, region, title="t", marked=marked))
    assert np.ptp(figure.axes[0].get_xlim()) < 3.0
    assert "7" not in texts(figure)


def test_a_flat_and_a_huge_workspace_and_strange_names(tmp_path):
    angle = np.linspace(0, 6, 5000)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(5000)], axis=1)
    for scale, unit in ((0.3, "mm"), (50.0, "m")):
        density = Density.of(scale * ring)
        figure = draw_region(shown(density, density.region(0.9), title="$x_{ 測量", text="a\\frac"))
        assert figure.axes[0].get_xlabel() == f"x [{unit}]"
        assert np.ptp(figure.axes[1].get_ylim()) > 0.2 * np.ptp(figure.axes[1].get_xlim())
        path = tmp_path / f"{unit}.png"
        write_picture(shown(density, density.region(0.9), title="$x_{ 測量", text="a\\frac"), path)
        with Image.open(path) as image:
            image.load()


def test_files_that_cannot_be_written_are_refused(density, region, tmp_path):
    for name in ("a.jpg", "a", "png"):
        with pytest.raises(FileError, match=r"choose one of '\.png', '\.svg', '\.pdf'"):
            write_picture(shown(density, region, title="t"), tmp_path / name)


def test_no_window_no_state_and_nothing_printed(tmp_path):
    program = f"""
import sys
import numpy as np
import calib.report.figure_region as pictures
assert "matplotlib" not in sys.modules
from calib.design.workspace import Density
import matplotlib
before = matplotlib.rcParams.copy()
density = Density.of(np.random.default_rng(0).normal(size=(5000, 3)))
view = pictures.RegionView(None, None, None, density, density.region(0.9), "t")
pictures.write_picture(view, {str(tmp_path)!r} + "/a.png")
assert "matplotlib.pyplot" not in sys.modules
assert matplotlib.rcParams.copy() == before
"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
