"""Numbers that cannot be in their units."""

import numpy as np
import pytest

from calib.basics.units import UNITS
from calib.data.measurements import Measurements
from calib.data.plausibility import implausible_length
from tests.data.tables import refused


@pytest.mark.parametrize(
    ("unit", "point", "says"),
    [
        ("m", "-149.02,-207.5,742.6", ["'z [m]'", "742.6 was read as 742.6 m", "in mm"]),
        ("mm", "-149020,-207500,742600", ["742600 was read as 742.6 m", "in um"]),
        ("mm", "-0.149,-0.2075,0.7426", ["0.7426 was read as 0.0007426 m", "in m"]),
        ("um", "-149.02,-207.5,742.6", ["742.6 was read as 0.0007426 m", "in mm"]),
        ("m", "1e9,0,0", ["column 'x [m]'", "Correct the value"]),
        ("mm", "0,0,0", ["none is further from the origin than 5 mm", "Correct the value"]),
    ],
)
def test_points_in_the_wrong_unit(table, unit, point, says):
    path = table(f"a [deg],x [{unit}],y [{unit}],z [{unit}]", f"1,{point}")
    refused(path, says=["line 2 (row 1), column '", *says])


def test_degrees_read_as_radians(table):
    header = "a [rad],b [rad],x [mm],y [mm],z [mm]"
    path = table(header, "1,-74.76,10,20,300", "1,6.1,10,20,300", "1,-72,10,20,300")
    refused(path, says=["column 'b [rad]'", "look like degrees", "'b [deg]'"])


@pytest.mark.parametrize(
    ("values", "unit", "near", "found"),
    [
        ([[100, 0, 0], [0, np.nan, -5]], "mm", True, None),
        ([[0, 0, 0], [0, -100.1, 2]], "m", True, (1, 1)),
        ([[1, 0, 0], [0, 0, 4.9]], "mm", True, (1, 2)),
        ([[1, 0, 0], [0, 0, 4.9]], "mm", False, None),
        ([[0.001, 0, 0]], "m", True, None),
        ([[1e300, 0, 0]], "mm", True, (0, 0)),
    ],
)
def test_the_farthest_row_decides(values, unit, near, found):
    fault = implausible_length(np.array(values, dtype=float), [UNITS[unit]] * 3, near=near)
    assert (None if fault is None else fault[:2]) == found


def test_a_date_that_excel_made_of_a_number_is_refused(table):
    header, others = "a [deg],x [mm],y [mm],z [mm]", ["1.4,10,20,300", "-72,10,20,300"]
    refused(table(header, "46143,10,20,300", *others), says=["line 2", "'a [deg]'", "2026-05-01"])
    refused(table(header, *others, "3,46027,20,300"), says=["line 4", "'x [mm]'", "2026-01-05"])
    # Not whole, of another century, or no larger than the others.
    for value, other in ((46143.5, "-72"), (36525.0, "-72"), (46143.0, "-7200")):
        rows = [f"{value},10,20,300", f"{other},10,20,300"]
        Measurements.read(table("a [deg],x [um],y [um],z [mm]", *rows))
