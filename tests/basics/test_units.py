import numpy as np
import pytest
from hypothesis import given, strategies as st

from calib.basics.units import (
    UNITS,
    Angle,
    Length,
    find_unit,
    parse_joint_values,
    parse_point,
    split_header,
    unit_fault,
)
from calib.errors import CalibError


@pytest.mark.parametrize("symbol", ["Nm", "N m", "N.m", "N*m", "N\u00b7m", "N\u22c5m"])
def test_a_torque_is_written_in_many_ways(symbol):
    assert find_unit(symbol) is UNITS["Nm"]


@pytest.mark.parametrize(
    ("symbol", "unit"),
    [
        *(
            ("\u00b0", "deg"),
            ("deg.", "deg"),
            ("DEG", "deg"),
            ("degrees", "deg"),
            ("\u0433\u0440\u0430\u0434", "deg"),
        ),
        *(("\u00b5m", "um"), ("\u03bcm", "um"), ("\u339c", "mm"), ("\u043c\u043c", "mm")),
        *(("\u6beb\u7c73", "mm"), ("inch", "in"), ("radian", "rad"), ("pixels", "px")),
    ],
)
def test_a_unit_is_written_in_words_signs_and_other_scripts(symbol, unit):
    assert find_unit(symbol) is UNITS[unit]


@pytest.mark.parametrize("symbol", ["", "MM", "grad", "m m", "furlong"])
def test_unknown_unit_names_the_allowed_ones(symbol):
    with pytest.raises(CalibError) as caught:
        find_unit(symbol)
    text = str(caught.value)
    assert f"'{symbol}' is not a unit" in text
    assert all(f"'{allowed}'" in text for allowed in UNITS)


@pytest.mark.parametrize(
    ("header", "name", "symbol"),
    [
        ("x [mm]", "x", "mm"),
        ("  x[mm]  ", "x", "mm"),
        ("arm[0] [deg]", "arm[0]", "deg"),
        ("wrist 1 joint [ rad ]", "wrist 1 joint", "rad"),
        ("set", "set", None),
        ("x [mm", "x [mm", None),
        ("x (mm)", "x", "mm"),
        ("x (raw)", "x (raw)", None),
        ("x \uff3bmm\uff3d", "x", "mm"),
        ("force [N]", "force", "N"),
        ("x []", "x", ""),
        ("", "", None),
    ],
)
def test_split_header(header, name, symbol):
    assert split_header(header) == (name, symbol)


@given(st.text(alphabet="abcJ_0 .:/-", min_size=1).map(str.strip), st.sampled_from(list(UNITS)))
def test_a_header_that_was_put_together_comes_apart(name, symbol):
    assert split_header(f"{name} [{symbol}]") == (name, symbol)


def test_a_unit_is_held_against_the_joint():
    assert unit_fault(Length(0.3), slides=True) is None
    assert unit_fault(Angle(0.3), slides=False) is None
    assert unit_fault(Angle(0.3), slides=True).startswith("is an angle, and the joint slides")
    assert unit_fault(Length(0.3), slides=False).startswith("is a length, and the joint turns")
    # Of a plain number nothing is known.
    assert unit_fault(0.3, slides=True) is unit_fault(0.3, slides=False) is None


@pytest.mark.parametrize("text", ["1 2 3 mm", "1,2,3 mm", " 1, 2, 3mm", "0.1 0.2 0.3 cm"])
def test_points(text: str):
    point = parse_point(text, "--target")
    np.testing.assert_allclose(point, [1e-3, 2e-3, 3e-3], rtol=1e-15)
    assert not point.flags.writeable


def test_joint_values():
    values = parse_joint_values(["lift=0.3 m", " pan = -90deg", "a=b=1 mrad"], "--hold")
    assert values == {"lift": 0.3, "pan": pytest.approx(-np.pi / 2, rel=1e-15), "a=b": 1e-3}
    assert [type(value) for value in values.values()] == [Length, Angle, Angle]
