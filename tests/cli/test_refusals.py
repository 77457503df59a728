"""What words of commands are refused for, in full: what was given, what is allowed, the fix."""

from __future__ import annotations

import re

import pytest

from calib.cli import simulate_options
from calib.errors import CalibError


def refused(text: str):
    """The whole message, as it is printed."""
    return pytest.raises(CalibError, match=f"^{re.escape(text)}$")


def test_steps_of_encoders_and_sizes_that_are_none():
    with refused(
        '--encoder: \'fine\' is no number with a unit, such as "0.5 mm". Write "0.001 deg", or "0.01 '
        'mm" for joints that slide.'
    ):
        simulate_options.parse_encoder(["fine"])
    with refused('--outlier-size "1 mrad": "1 mrad" is an angle, a length is wanted: "1 mm".'):
        simulate_options.parse_size("1 mrad", "--outlier-size")
    with refused(
        '--outlier-size "much": \'much\' is no number with a unit, such as "0.5 mm". Write "1 mm".'
    ):
        simulate_options.parse_size("much", "--outlier-size")


def test_an_offset_of_the_plane_that_is_no_length(call, tmp_path):
    (tmp_path / "s.csv").write_text("sweep,x [mm],y [mm],z [mm]\nplane,100,200,300\n")
    done = call(tmp_path, "base-frame", "s.csv", "--plane-offset", "thick")
    assert done.code == 1
    assert done.err == (
        'calib: --plane-offset: \'thick\' is no number with a unit, such as "0.5 mm". Write "19.05 mm".\n'
    )
