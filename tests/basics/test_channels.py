"""Channels of residuals by hand: which kind and unit each entry has."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.channels import RESIDUAL_UNITS, Channels, channels_of, residual_unit
from calib.errors import CalibError

#: Kinds with an angle between lengths, with two pixels, and with three lengths that are a vector.
UNITS = (("m", "rad", "m"), ("px", "px"), ("m", "m", "m"))
VECTORS = ((), (), ("m",))


@pytest.fixture
def channels() -> Channels:
    return channels_of(UNITS, VECTORS, np.array([1, 0, 2, -1]))


def test_channels_are_numbered_by_unit_then_by_kind(channels):
    assert channels.units == ("m", "m", "rad", "px")
    assert channels.vectors == (False, True, False, False)
    expected = [[3, 3, -1], [0, 2, 0], [1, 1, 1], [-1, -1, -1]]
    np.testing.assert_array_equal(channels.index, expected)
    np.testing.assert_array_equal(channels.used, np.array(expected) >= 0)
    assert (len(channels), channels.width) == (4, 3)


def test_the_entries_of_a_unit(channels):
    assert channels.present == ("m", "rad", "px")
    np.testing.assert_array_equal(channels.where("px"), [[1, 1, 0], [0] * 3, [0] * 3, [0] * 3])
    np.testing.assert_array_equal(channels.columns("rad"), [1])
    np.testing.assert_array_equal(channels.columns("m"), [0, 1, 2])
    values = np.array([[3.0, 4.0, 9.0], [1.0, 5.0, -1.0], [2.0, 2.0, 1.0], [7.0] * 3])
    np.testing.assert_allclose(channels.norms(values, "px"), [5.0, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(channels.norms(values, "rad"), [np.nan, 5.0, np.nan, np.nan])
    np.testing.assert_allclose(channels.norms(values, "m"), [np.nan, np.sqrt(2), 3.0, np.nan])


def test_only_vectors_lie_along_axes(channels):
    columns, rows = channels.vector_columns("m")
    np.testing.assert_array_equal(columns, [0, 1, 2])
    np.testing.assert_array_equal(rows, [False, False, True, False])
    columns, rows = channels.vector_columns("px")
    assert len(columns) == 0
    assert not rows.any()


def test_a_selection_keeps_the_channels_of_its_rows(channels):
    chosen = channels.select(np.array([True, False, False, True]))
    assert chosen.present == ("px",)
    np.testing.assert_array_equal(chosen.index, [[3, 3, -1], [-1, -1, -1]])


def test_a_table_without_kinds_has_one_column_and_no_channel():
    nothing = channels_of(UNITS, VECTORS, np.array([-1, -1]))
    assert (nothing.units, nothing.present, nothing.width) == ((), (), 1)


def test_each_unit_is_shown_in_a_unit_of_its_quantity():
    factors = {"m": 1e3, "rad": np.degrees(1.0), "px": 1.0}
    for symbol, unit in RESIDUAL_UNITS.items():
        assert unit.to_shown == pytest.approx(factors[symbol], rel=1e-15)
        assert unit.sigma_key == f"{unit.sigma_name}_{unit.shown}"
        assert 0.0 < unit.repeatability < unit.absurd
    assert residual_unit("px") is RESIDUAL_UNITS["px"]
    with pytest.raises(CalibError, match="'mm' is not a unit of residuals; allowed are 'm', 'rad'"):
        residual_unit("mm")
