"""Tables that are refused, and tables that hold the same."""

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.errors import MeasurementError

ARRAYS = ("joints", "points", "rotations", "distances", "torques")
WORDS = ("joint_names", "sets", "targets", "groups", "rows", "kinds", "pairs", "prismatic")

#: A table of two joints and points, and two rows of it.
HEADER = "row,set,a [deg],b [deg],x [mm],y [mm],z [mm]"
ROWS = ("1,estimate,10,20,300,400,500", "2,validate,-30,420.75,301.5,-400,500")


def write_lines(folder, *lines, encoding="utf-8", name="data.csv"):
    """The path of a file with these lines."""
    path = folder / name
    path.write_bytes("\n".join([*lines, ""]).encode(encoding))
    return path


def refused(path, says, **arguments):
    """The text with which a table is refused; it holds each of the words."""
    with pytest.raises(MeasurementError) as caught:
        Measurements.read(path, **arguments)
    text = str(caught.value)
    for word in [says] if isinstance(says, str) else says:
        assert word in text
    assert "\n" not in text
    return text


def assert_same(first, second, rtol=1e-15, atol=0.0):
    """Two tables hold the same rows."""
    for name in ARRAYS:
        values, others = getattr(first, name), getattr(second, name)
        assert (values is None) == (others is None), name
        if values is not None:
            np.testing.assert_allclose(values, others, rtol=rtol, atol=atol, err_msg=name)
    for name in ("sigma", "readings"):
        mapping, other = getattr(first, name), getattr(second, name)
        assert mapping.keys() == other.keys(), name
        for key in mapping:
            np.testing.assert_allclose(mapping[key], other[key], rtol=rtol, atol=atol, err_msg=key)
    for name in WORDS:
        assert getattr(first, name) == getattr(second, name)
