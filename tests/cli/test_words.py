"""Values from the words of a call, and the one line that refuses them."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from calib.basics.units import Angle, Length
from calib.cli.words import parse_columns, parse_held, parse_pair, parse_payload, parse_point
from calib.data.forms.column_options import ColumnOptions
from calib.errors import CalibError
from calib.robot.gravity import Payload


@pytest.mark.parametrize("text", ["1 2 3 mm", "1,2,3 mm", " 1, 2, 3mm", "0.1 0.2 0.3 cm"])
def test_points(text: str):
    np.testing.assert_allclose(parse_point(text, "--target"), [1e-3, 2e-3, 3e-3], rtol=1e-15)


def test_held_joints():
    held = parse_held(["lift=0.3 m", " pan = -90deg", "a=b=1 mrad"])
    assert held == {"lift": 0.3, "pan": pytest.approx(-np.pi / 2, rel=1e-15), "a=b": 1e-3}
    assert [type(value) for value in held.values()] == [Length, Angle, Angle]


def test_a_payload_keeps_the_centre_that_was_given():
    alone = parse_payload("5 kg", None)
    assert alone.mass == 5.0
    np.testing.assert_array_equal(alone.com, np.zeros(3))
    given = parse_payload(" 500g", Payload(3.0, np.array([0.0, 0.0, 0.1])))
    assert given.mass == 0.5
    np.testing.assert_array_equal(given.com, [0.0, 0.0, 0.1])
    assert parse_payload("1.5e3 g", None).mass == 1.5


@pytest.mark.parametrize(
    ("parse", "text", "said"),
    [
        (lambda t: parse_held([t]), "lift", "--hold was given 'lift'; it must be 'joint=value' with a unit"),
        (lambda t: parse_held([t]), "lift=3", "--hold 'lift=3' is '3'; a joint's value needs a unit of angle or"),
        (lambda t: parse_columns([t]), "kuk", "--columns was given 'kuk'; it must be"),
        (lambda t: parse_columns(["kuka", t]), "fanuc", "--columns was given 'kuka', 'fanuc'"),
        (lambda t: parse_columns(["a=b", t]), "a=c", "--columns was given 'a=c'"),
        (lambda t: parse_payload(t, None), "5", "--payload was given as \"5\"; it must be a mass, not below 0, such"),
    ],
)  # fmt: skip
def test_words_that_mean_nothing(parse: Callable[[str], Any], text: str, said: str):
    with pytest.raises(CalibError, match=re.escape(said)) as caught:
        parse(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "pair"),
    [
        ("10 mm", (0.01, None)),
        ("2deg", (None, np.radians(2.0))),
        ("0.1 deg, 500 um", (5e-4, np.radians(0.1))),
    ],
)
def test_a_length_and_an_angle(text: str, pair: tuple[float | None, float | None]):
    assert parse_pair(text, "--limit", "1 mm") == tuple(
        None if value is None else pytest.approx(value) for value in pair
    )


def test_columns_by_name_and_by_brand():
    assert parse_columns(None) == ColumnOptions()
    words = ["E1=rail [mm]", " KUKA ", "a=b=c"]
    assert parse_columns(words, "fanuc", "deg mm") == ColumnOptions(
        {"E1": "rail [mm]", "a=b": "c"}, "kuka", "fanuc", "deg mm"
    )
