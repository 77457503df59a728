"""Simulated pictures as text: numbers are those of the camera, the print and the mounts that were drawn."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.arrays import rigid_inverse
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.robot.robot import Robot
from calib.verbs.simulate.camera.simulate import simulate_pictures
from calib.verbs.simulate.camera.text import simulated_pictures_text
from calib.verbs.simulate.disturbances import Encoder, Outliers
from calib.verbs.simulate.scenario import Scenario

ARM = ("ur5", "tool0", "base_link")


@pytest.fixture(scope="module")
def pictures():
    scenario = Scenario(
        Robot.load(*ARM),
        Cell(kind="pixel"),
        sigma={"px": 0.25},
        encoder=Encoder(angle=np.deg2rad(0.01)),
        outliers=Outliers(count=2),
    )
    return simulate_pictures(scenario, 4, 2, seed=3)


@pytest.fixture(scope="module")
def text(pictures):
    return simulated_pictures_text(pictures)


def test_lines_are_at_most_100_columns_wide(text):
    assert max(map(len, text.splitlines())) <= 100


def test_counts_noise_and_disturbances(text, pictures):
    joined = " ".join(text.split())
    assert (
        f"{len(pictures.picture)} corners in 6 pictures (4 for estimation, 2 for validation)"
        in joined
    )
    assert "Noise of a corner 0.25 px" in joined
    assert "Repeatability 20 um" in joined
    assert "Encoder steps 0.01 deg" in joined
    rows = ", ".join(str(row) for row in pictures.outlier_rows)
    assert f"Outliers of 5 px rows {rows}" in joined


def test_camera_and_print_as_they_are(text, pictures):
    cell, joined = pictures.cell, " ".join(text.split())
    assert f"true fx {cell.camera.values[0]:.6g}, fy {cell.camera.values[1]:.6g}" in joined
    assert "stated fx 920, fy 920, cx 639.5" in joined
    assert f"printed {100 * (cell.printed.scale[0] - 1):+.2f} % wide" in joined
    assert f"sags by {1e3 * cell.printed.warp[0]:.2f} mm along x" in joined
    x, y, _ = 1e3 * rigid_inverse(cell.truth.T_frame_base[0])[:3, 3]
    assert f"at ({x:.3f}".rstrip("0") in joined
    assert f"{y:.3f}".rstrip("0") in joined


def test_a_camera_of_which_nothing_is_stated():
    cell = Cell(kind="pixel", cameras={"": Camera(width=640, height=480)})
    made = simulate_pictures(Scenario(Robot.load(*ARM), cell, noise=None), 2, 0, seed=1)
    joined = " ".join(simulated_pictures_text(made).split())
    assert "stated nothing but the size" in joined
    assert "Repeatability" not in joined
    assert "Noise of a corner 0 px" in joined
