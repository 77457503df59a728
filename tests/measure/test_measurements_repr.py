"""What measurements call themselves in a debugger and in messages."""

import numpy as np

from calib.measure.measurements import Measurements


def test_measurements_in_one_line(paper_table):
    assert repr(paper_table) == "Measurements(35 rows of 6 joints from ur3_leica.csv)"
    made = Measurements(("a", "b"), np.zeros((3, 2)), np.ones((3, 3)))
    assert repr(made) == "Measurements(3 rows of 2 joints)"
