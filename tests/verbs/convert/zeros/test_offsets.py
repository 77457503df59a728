"""Files of offsets: sums without digits of their own, entries at any depth, comments that say the sign."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from calib.errors import FileError
from calib.verbs.convert.source import Source
from calib.verbs.convert.zeros.offsets import (
    DYNAMIXEL_YAML,
    LEROBOT_JSON,
    TRANSMISSION_YAML,
    offsets_bytes,
)
from calib.verbs.convert.zeros.rounding import RoundedZeros, stored_number
from tests.verbs.convert.zeros.arms import servo_result


def rounded(name: str) -> RoundedZeros:
    result = servo_result()
    source = Source("result", result.robot, result.nominal, calibration=result)
    return RoundedZeros.of(source, stored_number(name, 4096))


def test_a_sum_has_no_digits_of_its_own(tmp_path: Path):
    zeros = rounded("ros2-transmission")
    own = tmp_path / "own.yaml"
    own.write_text(
        yaml.safe_dump({"a": {"b": {name: {"offset": 0.1} for name in zeros.by_joint()}}})
    )
    data = offsets_bytes(TRANSMISSION_YAML, zeros, own)
    assert data.startswith(b"# offset of each joint")
    assert b"reading = raw / reduction + offset\n" in data
    for name, entry in yaml.safe_load(data)["a"]["b"].items():
        assert entry["offset"] == round(0.1 + zeros.by_joint()[name], 6)


def test_ticks_are_whole():
    zeros = rounded("lerobot")
    content = json.loads(offsets_bytes(LEROBOT_JSON, zeros, None))
    changes = [entry["homing_offset_change"] for entry in content.values()]
    assert all(type(change) is int for change in changes)
    assert changes == [int(number) for number in zeros.numbers]


@pytest.mark.parametrize("gear", ["0.5 turns", True, float("nan")])
def test_a_gear_ratio_that_is_no_number_is_refused(tmp_path: Path, gear: object):
    zeros = rounded("dynamixel-hardware")
    own = tmp_path / "own.yaml"
    own.write_text(yaml.safe_dump({name: {"gear_ratio": gear} for name in zeros.by_joint()}))
    with pytest.raises(FileError, match="gear_ratio"):
        offsets_bytes(DYNAMIXEL_YAML, zeros, own)


@pytest.mark.parametrize(
    ("kind", "entry", "says"),
    [
        (DYNAMIXEL_YAML, {"gear_ratio": 0}, "gear_ratio"),
        (DYNAMIXEL_YAML, {"homing_offset": 12}, "--to"),
        (LEROBOT_JSON, {"homing_offset": 12.5}, "whole ticks"),
    ],
)
def test_entries_of_another_file_or_servo_are_refused(tmp_path: Path, kind, entry, says: str):
    zeros = rounded("lerobot" if kind is LEROBOT_JSON else "dynamixel-hardware")
    own = tmp_path / "own"
    own.write_text(json.dumps(dict.fromkeys(zeros.by_joint(), entry)))
    with pytest.raises(FileError, match=says):
        offsets_bytes(kind, zeros, own)


def test_a_file_of_two_arms_is_refused_for_one_of_them(tmp_path: Path):
    zeros = rounded("lerobot")
    arm = {name: {"homing_offset": 0} for name in zeros.by_joint()}
    own = tmp_path / "own.json"
    own.write_text(json.dumps({"left": arm, "right": arm}))
    with pytest.raises(FileError, match="2 places"):
        offsets_bytes(LEROBOT_JSON, zeros, own)
    own.write_text(json.dumps({"left": arm, "right": {"camera": {"homing_offset": 0}}}))
    assert json.loads(offsets_bytes(LEROBOT_JSON, zeros, own))["left"] != arm
