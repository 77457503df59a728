"""What the record of a report says of noise, repeats, held joints and columns left out."""

from __future__ import annotations

import numpy as np

from calib.data import paper_urdf
from calib.identify.calibration import Calibration, calibrate
from calib.measure.cell import Cell
from calib.measure.simulation import VirtualCell
from calib.measure.truth import draw_truth
from calib.model.readback import random_joint_values
from calib.model.robot import Robot
from calib.model.urdf import Urdf


def recorded(folder, robot: Robot, cell: Cell, visits: int = 3) -> tuple[Calibration, str]:
    """A calibration by points of repeated poses, and its report as text."""
    truth = draw_truth(robot, "zeros", seed=3, cell=cell)
    q = random_joint_values(robot, 15, seed=4)
    table = VirtualCell(truth, visits=visits).measure(q, 5).measurements
    made = calibrate(robot, table, cell=cell, validate=False)
    text = made.write_report(folder / "r.txt").read_text(encoding="utf-8")
    return made, " ".join(text.split())


def test_stated_noise_repeats_and_a_joint_held(tmp_path):
    robot = Robot.load(paper_urdf(), "base", "tool0", held={"wrist_3_joint": 0.3})
    made, text = recorded(tmp_path, robot, Cell(model="zeros", sigma=2e-5))
    assert made.repeats is not None
    scatter = 1e3 * made.repeats.within[0]
    assert "Noise stated 0.020 mm a coordinate (median of the rows)" in text
    assert f"Repeats of a pose scatter by {scatter:.3f} mm a coordinate (90 d.o.f.)." in text
    assert "Joints held wrist_3_joint at 17.189 deg" in text


def test_a_sliding_joint_held(tmp_path, gantry):
    data = gantry.urdf.data  # a table has columns x and y of its own
    for name in (b"x", b"y"):
        data = data.replace(b'name="' + name + b'"', b'name="slide_' + name + b'"')
    urdf = Urdf.from_bytes(data, "gantry.urdf")
    robot = Robot.from_urdf(urdf, gantry.base, gantry.tip, held={"slide_y": 0.25})
    _, text = recorded(tmp_path, robot, Cell(model="zeros", target=np.array([0.1, 0.0, 0.1])), 1)
    assert "Joints held slide_y at 250.000 mm" in text
