"""Columns of a reading: those of each kind, and what is said of wrong ones."""

from __future__ import annotations

import pytest

from calib.verbs.measure.headers import column_fault, headers_of, misread_place, quoted

PLACE = ("x [mm]", "y [mm]", "z [mm]")
JOINTS = ("a [rad]", "b [rad]")


def test_columns_of_each_kind():
    assert tuple(headers_of("point", "mm")) == PLACE
    assert tuple(headers_of("pose", "m"))[2:] == ("z [m]", "rx [deg]", "ry [deg]", "rz [deg]")
    assert tuple(headers_of("distance", "mm"))[-1].endswith(" [mm]")
    assert tuple(headers_of("pixel", "mm")) == ()
    assert quoted(PLACE) == "'x [mm]', 'y [mm]', 'z [mm]'"


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ({}, "no column 'x [mm]'"),
        ({"x [mm]": 1.0, "y [mm]": 2.0}, "no column 'z [mm]'"),
        ({"x": 1.0, "y": 2.0, "z": 3.0}, "'x' has no unit"),
        ({"x [kg]": 1.0, "y [mm]": 2.0, "z [mm]": 3.0}, "'x [kg]' is not in a unit such as 'mm'"),
        ({"x [deg]": 1.0, "y [mm]": 2.0, "z [mm]": 3.0}, "'x [deg]' is not in a unit"),
    ],
)
def test_a_wrong_column_is_named_with_those_to_give(row, says):
    fault = column_fault(row, PLACE, JOINTS, "the instrument")
    assert says in fault
    assert quoted(PLACE) in fault
    assert "--" not in fault


def test_joint_values_are_given_all_or_none():
    row = {"x [m]": 1.0, "y [cm]": 2.0, "z [mm]": 3.0}
    assert column_fault(row, PLACE, JOINTS, "the instrument") is None
    assert column_fault(row | {"a [deg]": 1.0, "b [deg]": 2.0}, PLACE, JOINTS, "") is None
    assert quoted(JOINTS) in column_fault(row | {"b [deg]": 2.0}, PLACE, JOINTS, "")


def test_an_orientation_may_have_other_columns():
    row = dict.fromkeys((*PLACE, "qx", "qy", "qz", "qw"), 500.0)
    assert column_fault(row, tuple(headers_of("pose", "mm")), (), "") is None


@pytest.mark.parametrize(
    ("place", "unit", "right"),
    [
        ((2.0, 0.3, 0.4), "mm", "m"),
        ((2000.0, 300.0, 400.0), "m", "mm"),
        ((2000.0, 300.0, 400.0), "mm", None),
        ((2.0, 0.3, 0.4), "m", None),
        ((1e9, 0.0, 0.0), "m", None),  # in no unit
    ],
)
def test_a_place_in_another_unit_is_found(place, unit, right):
    row = {f"{axis} [{unit}]": value for axis, value in zip("xyz", place, strict=True)}
    found = misread_place(row, "the instrument")
    assert (found and found[1]) == right
    several = {header: [value, 7.0] for header, value in row.items()}
    assert misread_place(several, "the instrument") == found
    if right:
        assert column_fault(row, PLACE, (), "the instrument").endswith(
            f"'x [{right}]', 'y [{right}]', 'z [{right}]'."
        )
        assert {"mm": "near", "m": "far"}[unit] in found[0]


def test_columns_that_have_no_place_or_several_units_are_left_alone():
    for row in ({"d [mm]": 1.0}, {"x [mm]": 1.0, "y [m]": 1.0, "z [mm]": 1.0}, {"x": 1, "y": 1}):
        assert misread_place(row, "the instrument") is None
