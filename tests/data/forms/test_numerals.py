"""Decimal signs and signs between thousands, told by all numbers of a file."""

import pytest

from calib.data.forms.numerals import NUMERAL, decimal_sign_in, decimal_sign_of, plain
from calib.errors import MeasurementError


def sign(*texts, stated=None):
    return decimal_sign_of(list(enumerate(texts, 1)), "t.txt", stated)


@pytest.mark.parametrize(
    ("texts", "decimal", "numbers"),
    [
        (("1,992.4945", "-300.5", "12"), ".", ["1992.4945", "-300.5", "12"]),
        (("1.992,4945", "-300,5", "12"), ",", ["1992.4945", "-300.5", "12"]),
        (("1,992", "300.25", "+2,000,000.5"), ".", ["1992", "300.25", "+2000000.5"]),
        (("1.992", "300,25"), ",", ["1992", "300.25"]),
        (("1,234,567", "1,992"), ".", ["1234567", "1992"]),
        (("1.992", "300.125"), ".", ["1.992", "300.125"]),
        (("0,992", "1,992"), ",", ["0.992", "1.992"]),
        (("1992,494", "1,992"), ",", ["1992.494", "1.992"]),
        (("1'992.4945", "1\N{NARROW NO-BREAK SPACE}000.5"), ".", ["1992.4945", "1000.5"]),
        (("1,5e3", ",5", "5,"), ",", ["1.5e3", ".5", "5."]),
        (("x", "", "1.5"), ".", ["x", "", "1.5"]),
    ],
)
def test_all_numbers_tell_which_sign_is_decimal(texts, decimal, numbers):
    assert sign(*texts) == decimal
    assert [plain(text, decimal) for text in texts] == numbers


def test_a_comma_that_may_be_either_needs_a_remark():
    with pytest.raises(MeasurementError, match=r"t.txt, line 2.*'# Decimal: comma'"):
        sign("12", "1,992", "-300,125")
    assert sign("1,992", stated=",") == ","
    assert sign("1,992", stated=".") == "."
    for remark, decimal in (
        ("Decimal: comma", ","),
        ("decimal separator = .", "."),
        ("Decimal point", "."),
        ("decimals: 3", None),
        ("Units: mm", None),
    ):
        assert decimal_sign_in(["x", remark]) == decimal


@pytest.mark.parametrize(
    ("texts", "stated", "says"),
    [
        (("1.5", "1,5"), None, "decimal point in line 1 and a decimal comma in line 2"),
        (("1,992.5", "1.992,5"), None, "decimal point in line 1"),
        (("1,5", "1,234,567"), None, "line 1 and between thousands in line 2"),
        (("1,234,567", "1.234.567"), None, "line 2 and commas in line 1"),
        (("12", "1,5"), ".", "decimal comma in line 2"),
    ],
)
def test_contradictions_are_refused(texts, stated, says):
    with pytest.raises(MeasurementError, match=says):
        sign(*texts, stated=stated)


def test_what_is_no_number():
    for text in ("1,99,2", "12,34.5", "1,992,4945", "5'", "5'11", "1 992", "", ".", "1.2.3", "nan"):
        assert not NUMERAL.fullmatch(text)
