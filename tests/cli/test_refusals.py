"""What words of commands are refused for, in full: what was given, what is allowed, the fix."""

from __future__ import annotations

import re

import pytest

from calib.cli.setup import parse_amount
from calib.errors import CalibError


def refused(text: str):
    """The whole message, as it is printed."""
    return pytest.raises(CalibError, match=f"^{re.escape(text)}$")


def test_amounts_of_another_quantity_or_of_none():
    with refused('--outlier-size "1 mrad": that is an angle, a length is wanted: "1 mm".'):
        parse_amount("1 mrad", "--outlier-size", "a length", "1 mm")
    with refused(
        '--outlier-size "much": \'much\' is no number with a unit, such as "0.5 mm". Write "1 mm".'
    ):
        parse_amount("much", "--outlier-size", "a length", "1 mm")
    with refused('--margin "-1 deg" must not be below 0.'):
        parse_amount("-1 deg", "--margin", "an angle", "5 deg")
    assert parse_amount("-1 mm", "--x", "a length", "1 mm", signed=True) == -1e-3
    assert parse_amount("0", "--x", "a length", "1 mm") == 0.0


def test_an_offset_of_the_plane_that_is_no_length(call, tmp_path):
    (tmp_path / "s.csv").write_text("sweep,x [mm],y [mm],z [mm]\nplane,100,200,300\n")
    done = call(tmp_path, "base-frame", "s.csv", "--plane-offset", "thick")
    assert done.code == 1
    assert done.err == (
        'calib: --plane-offset "thick": \'thick\' is no number with a unit, such as "0.5 mm". Write "19.05 mm".\n'
    )
