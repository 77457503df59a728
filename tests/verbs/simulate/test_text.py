"""A simulation as text: errors, noise and disturbances are those that were simulated."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.basics.arrays import rigid_inverse
from calib.camera.camera import Camera
from calib.data.cell import Cell, TrackerNoise
from calib.model.families import FAMILIES
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import Encoder, MovedTarget, Outliers
from calib.verbs.simulate.scenario import Scenario, Simulated, simulate
from calib.verbs.simulate.text import _errors_by_family, simulated_text
from calib.verbs.simulate.truth import draw_truth
from tests.verbs.simulate.cells import virtual

SETS = ("estimate",) * 15 + ("validate",) * 5


@pytest.fixture(scope="module")
def scenario(ur3: Robot) -> Scenario:
    return virtual(
        draw_truth(ur3, "zeros", seed=1),
        noise=TrackerNoise(1e-4, 0.0, 0.0),
        outliers=Outliers(0.2, size=5e-3),
        moved=MovedTarget(12, np.array([1e-3, 0.0, 0.0])),
    ).scenario


@pytest.fixture(scope="module")
def simulated(ur3: Robot, scenario: Scenario) -> Simulated:
    cell = virtual(draw_truth(ur3, "zeros", seed=1))
    return replace(cell, scenario=scenario).measure(random_joint_values(ur3, 20, 7), sets=SETS)


@pytest.fixture(scope="module")
def text(scenario: Scenario, simulated: Simulated) -> str:
    return simulated_text(scenario, simulated)


def line_of(text: str, label: str) -> str:
    (line,) = [line for line in text.splitlines() if line.startswith(label)]
    return line


def test_the_rows_are_counted(text: str):
    assert "20 rows (15 for estimation, 5 for validation)" in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 100


def test_the_true_errors(text: str, simulated: Simulated):
    truth = simulated.truth
    zeros = 1e3 * truth.x[[p.family == "zero" for p in truth.model.parameters]]
    line = line_of(text, "  zero")
    rms, largest = np.sqrt(np.mean(zeros**2)), zeros[np.argmax(np.abs(zeros))]
    assert f"{len(zeros)}, rms {rms:.3g} mrad" in line
    assert f" {largest:.3g} mrad" in line
    errors = 1e3 * truth.nominal_errors(simulated.q)
    line = line_of(text, "  of the nominal robot")
    assert f"{np.sqrt(np.mean(errors**2)):.3g} mm rms, {errors.max():.3g} mm at most" in line


def test_the_disturbances(text: str, simulated: Simulated):
    assert "0.1 mm std: instrument 100 um" in line_of(text, "Noise of a coordinate")
    rows = [
        int(row) for row in re.findall(r"\d+", line_of(text, "Outliers of 5 mm").split("rows")[1])
    ]
    assert set(rows) <= set(simulated.outlier_rows)
    moved = line_of(text, "Moved target")
    assert "(1, 0, 0) mm in the tip before row 12" in moved
    assert f": {int(simulated.moved.sum())} rows" in moved


def test_what_is_not_simulated_has_no_line(text: str):
    assert "Encoder steps" not in text
    assert "Drift" not in text
    assert "Noise of an orientation" not in text


def test_families_of_errors_stand_in_their_order(ur3: Robot):
    truth = draw_truth(ur3, "dh+gain", seed=1)
    families = _errors_by_family(truth)
    names = [family for family, _ in families]
    assert names == sorted(names, key=list(FAMILIES).index)
    assert len(set(names)) > 1
    shown = {name: value for errors in families.values() for name, value in errors.items()}
    given = dict(zip(truth.model.names, truth.x, strict=True))
    assert shown == {name: value for name, value in given.items() if value}


# Pictures

ARM = ("ur5", "tool0", "base_link")


@pytest.fixture(scope="module")
def photographed():
    scenario = Scenario(
        Robot.load(*ARM),
        Cell(kind="pixel"),
        sigma={"px": 0.25},
        encoder=Encoder(angle=np.deg2rad(0.01)),
        outliers=Outliers(count=2),
    )
    return scenario, simulate(scenario, 4, 2, seed=3)


def test_pictures_are_counted_and_their_disturbances_said(photographed):
    pictures, text = photographed[1].pictures, simulated_text(*photographed)
    assert max(map(len, text.splitlines())) <= 100
    joined = " ".join(text.split())
    assert (
        f"{len(pictures.picture)} corners in 6 pictures (4 for estimation, 2 for validation)"
        in joined
    )
    assert "Noise of a corner 0.25 px" in joined
    assert "Repeatability 20 um" in joined
    assert "Encoder steps 0.01 deg" in joined
    rows = ", ".join(str(row) for row in photographed[1].outlier_rows)
    assert f"Outliers of 5 px rows {rows}" in joined


def test_camera_and_print_as_they_are(photographed):
    truth, equipment = photographed[1].truth, photographed[1].pictures.equipment
    joined = " ".join(simulated_text(*photographed).split())
    assert (
        f"true fx {equipment.camera.values[0]:.6g}, fy {equipment.camera.values[1]:.6g}" in joined
    )
    assert "stated fx 920, fy 920, cx 639.5" in joined
    assert f"printed {100 * (equipment.printed.scale[0] - 1):+.2f} % wide" in joined
    assert f"sags by {1e3 * equipment.printed.warp[0]:.2f} mm along x" in joined
    x, y, _ = 1e3 * rigid_inverse(truth.T_frame_base[0])[:3, 3]
    assert f"at ({x:.3f}".rstrip("0") in joined
    assert f"{y:.3f}".rstrip("0") in joined


def test_a_camera_of_which_nothing_is_stated():
    cell = Cell(kind="pixel", cameras={"": Camera(width=640, height=480)})
    scenario = Scenario(Robot.load(*ARM), cell, noise=None)
    joined = " ".join(simulated_text(scenario, simulate(scenario, 2, 0, seed=1)).split())
    assert "stated nothing but the size" in joined
    assert "Repeatability" not in joined
    assert "Noise of a corner 0 px" in joined
