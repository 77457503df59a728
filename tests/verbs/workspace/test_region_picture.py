"""Figures of a region: readable by others, true to the region, with no trace in global state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from calib import example
from calib.data.measurements import Measurements
from calib.errors import FileError
from calib.robot.ranges import joint_ranges
from calib.verbs.workspace.region import Density
from calib.verbs.workspace.region_picture import draw_region, headings, write_picture
from calib.verbs.workspace.region_rows import Checked, RegionView
from calib.verbs.workspace.workspace import workspace_points


@pytest.fixture(scope="module")
def rows(ur3):
    return Measurements.read(example.paper_measurements(), ur3.joint_names, ur3.joint_types)


@pytest.fixture(scope="module")
def density(ur3, rows):
    q = rows.joints_for(ur3.joint_names)[rows.estimation]
    ranges = joint_ranges(ur3, like=q, margin=np.radians(5.0))
    return Density.of(workspace_points(ur3, example.PAPER_TARGET, ranges, 2**15))


@pytest.fixture(scope="module")
def region(density):
    return density.region(0.95)


@pytest.fixture(scope="module")
def view(ur3, rows, density, region):
    checked = Checked(rows, rows.points, np.ones(len(rows), dtype=bool))
    return RegionView(ur3, np.zeros(3), np.zeros((6, 2)), density, region, checked)


def test_a_png_opens_elsewhere(view, tmp_path):
    with Image.open(write_picture(view, tmp_path / "a.png")) as image:
        image.load()
        assert image.size == (1950, 1380)
        pixels = np.asarray(image.convert("RGB")).astype(int)
    orange = (pixels[..., 0] > 200) & (pixels[..., 2] < 110)
    green = (pixels[..., 1] - pixels[..., 0] > 90) & (pixels[..., 1] > 140)
    assert 0.02 < orange.mean() < 0.5
    assert green.sum() > 500  # the validation rows


def texts(figure):
    axes = [text.get_text() for ax in figure.axes for text in (ax.title, *ax.texts)]
    return axes + [text.get_text() for text in figure.texts]


def test_rows_inside_and_outside_are_counted_and_numbered(view):
    figure = draw_region(view)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [
        "outline of the region",
        "base",
        "30 estimation rows inside",
        "3 validation rows inside",
        "2 validation rows outside",
    ]
    shown = texts(figure)
    assert {"\n".join(headings(view)), "Seen from above"} <= set(shown)
    for number in ("31", "32", "33", "34", "35"):
        assert shown.count(number) == 3  # once in each view
    assert "30" not in shown


def test_what_is_drawn_is_the_region(view, density, region):
    figure = draw_region(view)
    panels = figure.axes[:6]
    pairs = [(0, 1), (0, 2), (1, 2)]
    for panel, (i, j) in zip(panels, pairs * 2, strict=True):
        image = panel.images[0].get_array()
        assert float(image.max()) == 1.0
        assert image.shape == (density.counts.shape[j], density.counts.shape[i])
        x, y = panel.get_xlim(), panel.get_ylim()
        assert x[0] < 1e3 * density.extent[0, i] < 1e3 * density.extent[1, i] < x[1]
        assert y[0] < 1e3 * density.extent[0, j] < 1e3 * density.extent[1, j] < y[1]
    for panel, (i, j) in zip(panels[:3], pairs, strict=True):
        lines = np.array(panel.collections[0].get_segments()).reshape(-1, 2)
        ends = np.array([lines.min(axis=0), lines.max(axis=0)])
        np.testing.assert_allclose(ends, 1e3 * region.bounds[:, [i, j]], atol=1e-9)


def test_a_flat_workspace_and_a_wrong_ending(view, tmp_path):
    angle = np.linspace(0, 6, 5000)
    density = Density.of(np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1))
    figure = draw_region(replace(view, density=density, region=density.region(0.9), checked=None))
    assert np.ptp(figure.axes[1].get_ylim()) > 0.2 * np.ptp(figure.axes[1].get_xlim())
    with pytest.raises(FileError, match="'jpg'"):
        write_picture(view, tmp_path / "a.jpg")
