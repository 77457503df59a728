"""What references show, in lines."""

from __future__ import annotations

import numpy as np

from calib.diagnosis.frame_drift import FrameDrift, Movement, Mover, StillTarget
from calib.numerics.frame_path import Form
from calib.show.reference_text import reference_lines

STILL = (StillTarget("floor", "", "world", 8, 2e-5), StillTarget("foot", "a", "", 1, np.nan))


def movement(form=Form.STEP, mover=Mover.FRAME, reference="", row=22):
    by = np.array([8e-5, 0.0, 0.0])
    return Movement(form, mover, reference, "", row, 21, 24, by, by / 10.0, np.zeros(3), 1e-4)


def lines(*found):
    return list(reference_lines(FrameDrift(STILL, found, 1.2e-5, 20, 6e-6)))


def test_each_reference_has_a_line():
    first, second, _ = lines()
    assert first == "Reference 'floor' on the world: 8 times, scatter 0.020 mm."
    assert second == "Reference 'foot' from station 'a': once."


def test_what_it_shows_stands_beside_it():
    first, second = lines(movement())
    assert first.endswith("scatter 0.012 mm; step of 0.080 mm between rows 21 and 24.")
    assert "step" not in second
    assert "drift of the base of 0.080 mm" in lines(movement(Form.DRIFT, Mover.BASE))[0]
    assert "row 22 is 0.080 mm off" in lines(movement(Form.READING, Mover.READING, "floor"))[0]
    knocked = lines(movement(Form.STEP, Mover.REFERENCE, "foot"))
    assert "this reference alone" not in knocked[0]
