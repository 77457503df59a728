"""Joint zeros in words: the table has what is written, and docs/zeros.md shows what is printed of the demo."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from calib.result.calibration import Calibration
from calib.verbs.convert.convert import FORMATS, convert
from calib.verbs.convert.text import text
from tests.places import ROOT
from tests.verbs.convert.zero_arms import servo_result, written

DOCS = ROOT / "docs"


def test_the_page_shows_what_is_printed_of_the_demo(default_result: Calibration, tmp_path: Path):
    done = convert(default_result, tmp_path / "zeros.csv", to="zeros")
    printed = text(done, "demo/calibration.json")
    page = (DOCS / "zeros.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
    assert shown.strip() in printed
    assert "must go up by its zero" in " ".join(printed.split())
    assert "Over the joint limits" not in printed  # that is the whole calibration


@pytest.mark.parametrize(
    ("to", "cell"),
    [
        ("zeros", "1.692"),
        ("dynamixel-hardware", "1.692"),
        ("ros2-transmission", "1.692"),
        ("lerobot", "1.696"),
        ("lerobot-dynamixel", "1.696"),
    ],
)
def test_the_page_has_the_error_of_each_format(default_result, tmp_path: Path, to: str, cell: str):
    ending = {"zeros": ".csv", "lerobot": ".json", "lerobot-dynamixel": ".json"}.get(to, ".yaml")
    printed = text(convert(default_result, tmp_path / f"z{ending}", to=to), "demo.json")
    assert re.search(rf"rounded as written +{cell}$", printed, re.MULTILINE)
    page = (DOCS / "zeros.md").read_text(encoding="utf-8")
    (row,) = re.findall(rf"^\|.*\| `{to}` \(.*$", page, re.MULTILINE)
    assert row.endswith(f"| {cell} |")


def test_the_table_has_the_numbers_that_are_stored(tmp_path: Path):
    done = convert(servo_result(), tmp_path / "z.json", to="lerobot")
    describe = FORMATS["lerobot"].describe
    assert describe is not None
    _, table, errors = describe(done)
    assert re.findall(r"^elbow_flex +-1\.\d{4} +0\.\d{4} deg +\+18 ticks$", table, re.MULTILINE)
    assert "change of homing_offset" in table
    assert "whole calibration" in errors
    assert max(map(len, [*table.splitlines(), *errors.splitlines()])) <= 100
    assert FORMATS["dh"].describe is None
    assert written(tmp_path / "zeros.csv", "zeros").exists()
