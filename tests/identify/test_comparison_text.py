"""What a comparison says of places without a partner, of names, and of data that know too little."""

from __future__ import annotations

from functools import cache

from calib.calibration import Calibration, calibrate, compare
from calib.data import paper_urdf
from calib.identify.comparison_text import notes, sentence
from calib.measure.cell import Cell
from calib.model.readback import random_joint_values
from calib.model.robot import Robot
from calib.model.urdf import Urdf
from calib.simulate.scenario import Scenario

PLACES = {"upper": (0.1, 0.0, 0.05), "lower": (0.0, 0.1, 0.05), "third": (-0.1, 0.0, 0.0)}


@cache
def measured(
    *targets: str, seed: int = 1, name: str = "ur3", poses: int = 12, **options: bool
) -> Calibration:
    """A calibration of one true UR3 by some targets."""
    data = paper_urdf().read_bytes().replace(b'name="ur3"', f'name="{name}"'.encode(), 1)
    robot = Robot.from_urdf(Urdf.from_bytes(data, "ur3.urdf"), "base", "tool0")
    cell = Cell(targets={t: PLACES[t] for t in targets}, model="zeros", **options)
    virtual = Scenario(robot, cell, "zeros").draw(7)
    table = virtual.measure(random_joint_values(robot, poses, seed=seed), seed)
    return calibrate(robot, table.measurements, cell=cell, validate=False)


def test_places_without_a_partner_are_named_for_both():
    found = compare(measured("upper", "lower"), measured("upper", "third", seed=2))
    said = " ".join(found.summary().split())
    assert "Without a partner of the same name: targets 'lower' of a; targets 'third' of b." in said


def test_robots_of_other_names():
    found = compare(measured("upper", "lower"), measured("upper", "lower", seed=2, name="cell 7"))
    assert "The URDFs name their robots 'ur3' and 'cell 7'." in notes(found)


def test_data_that_know_nothing_in_common():
    one, other = (measured("upper", seed=seed, poses=1, estimate_target=True) for seed in (1, 2))
    found = compare(one, other)
    assert (found.outcome, found.why) == ("cannot tell", "nothing known")
    assert "know no combination of the robot's parameters in common" in sentence(found)
