"""Tables of accuracy as text: every figure is that of the accuracy, and what is missing is named."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.show.lines import mm
from calib.verbs.evaluate.acceptance import Assessment
from calib.verbs.evaluate.accuracy_text import (
    ACCURACY_HEADS,
    CHARACTERISTIC_HEADS,
    accuracy_cells,
    accuracy_text,
    characteristic_cells,
    characteristics_text,
    figures_of,
    missing,
    pose_cells,
    pose_heads,
    poses_text,
)
from calib.verbs.evaluate.evaluation import evaluate

KNOWN = Cell(target=(0.0, 0.0, 0.0), estimate_target=False)


@pytest.fixture(scope="module")
def made(ur3: Robot) -> Assessment:
    """Twelve poses, each three times in turn, one worse than the other."""
    q = np.tile(random_joint_values(ur3, 12, 3), (3, 1))
    points = ur3.poses(q)[:, :3, 3]
    points[:, 0] += np.tile(1e-4 * np.arange(1, 13), 3) + np.repeat([0.0, 1e-5, -1e-5], 12)
    return Assessment.of_one(evaluate(ur3, Measurements(ur3.joint_names, q, points), KNOWN))


def test_cells_are_the_figures(made: Assessment):
    ((name, *cells),) = accuracy_cells(figures_of(made), "m")
    assert (name, len(cells)) == ("URDF as it is", len(ACCURACY_HEADS))
    assert cells == ["12", *(mm(v) for v in made.accuracies["urdf"].figures("m").values())]
    assert all(cell in accuracy_text(figures_of(made)) for cell in cells)


def test_characteristics_are_listed_and_the_others_say_what_they_need(made: Assessment):
    found = made.characteristics["urdf"]
    rows = characteristic_cells(found)
    assert [row[0].split()[0] for row in rows] == ["AD", "RD"]
    for row, characteristic in zip(rows, found, strict=False):
        assert len(row) == 1 + len(CHARACTERISTIC_HEADS)
        assert row[1:] == ("66 pairs", mm(characteristic.largest), mm(characteristic.mean))
    assert [symbols for symbols, _ in missing(found)] == ["vAP", "dAP, dRP"]
    text = characteristics_text(found, "URDF as it is")
    assert f"{mm(found[0].largest):>11}{mm(found[0].mean):>11}" in text
    assert "  dAP, dRP n/a: needs 20 repeats of a pose" in text.splitlines()
    assert max(map(len, text.splitlines())) <= 100


def test_poses_are_listed_from_the_worst_on_without_a_tolerance_too(made: Assessment):
    rows = list(pose_cells(made, 40))
    assert [row[0] for row in rows[:2]] == ["rows 12, 24, 36", "rows 11, 23, 35"]
    assert len(rows) == 12
    assert pose_heads(made) == ["repeats", "AP [mm]", "x", "y", "z", "RP", "single"]
    assert rows[0][1:3] == ("3", "1.200")
    lines = poses_text(made, "the URDF").splitlines()
    assert len(lines) == 2 + 10 + 1
    assert lines[2].split()[-7:] == list(rows[0][1:])
