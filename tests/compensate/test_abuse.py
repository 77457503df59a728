"""Files of controllers and origins that fuzzing found to take for ever: refused in bounded time."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from calib.errors import FileError
from calib.formats.origins import parse_origins
from calib.formats.ur_conf import read_deltas
from calib.formats.ur_yaml import read_yaml

#: Digits, of which the last is none: patterns that go back take time with the square of the length.
LONG = "0" * 200_000 + "x"

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")


def in_time(start: float) -> None:
    assert time.process_time() - start < 5.0


def test_a_long_number_of_a_calibration_conf(tmp_path: Path):
    path = tmp_path / "calibration.conf"
    lines = [f"delta_{key} = [0, 0, 0, 0, 0, {LONG}]" for key in ("theta", "a", "d", "alpha")]
    path.write_text("\n".join(["[mounting]", *lines]))
    start = time.process_time()
    with pytest.raises(
        FileError, match=r"delta_theta of joint 6 is '0000.*a finite number \[rad\]"
    ) as error:
        read_deltas(path)
    in_time(start)
    assert len(str(error.value)) < 500


def test_a_section_with_a_long_name(tmp_path: Path):
    path = tmp_path / "calibration.conf"
    path.write_text(f"[{'m' * 1_000_000}]\ndelta_theta = [0]\n")
    with pytest.raises(FileError, match=r"there is no \[mounting\] in it") as error:
        read_deltas(path)
    assert len(str(error.value)) < 5000


def test_a_long_number_of_a_kinematics_yaml(tmp_path: Path):
    path = tmp_path / "kinematics.yaml"
    rows = "".join(
        f"  {link}: {{x: {LONG}, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0}}\n" for link in LINKS[:1]
    )
    rows += "".join(
        f"  {link}: {{x: 0, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0}}\n" for link in LINKS[1:]
    )
    path.write_text(f"kinematics:\n{rows}")
    start = time.process_time()
    with pytest.raises(FileError, match="x of 'shoulder' is '0000"):
        read_yaml(path)
    in_time(start)


def test_aliases_of_a_kinematics_yaml_are_not_written_out(tmp_path: Path):
    path = tmp_path / "kinematics.yaml"
    bomb = "".join(f"a{i}: &a{i} [{f'*a{i - 1}, ' * 9 if i else 'x'}]\n" for i in range(30))
    path.write_text(bomb + "kinematics: *a29\n")
    start = time.process_time()
    with pytest.raises(FileError, match="kinematics has no keys with values"):
        read_yaml(path)
    in_time(start)


def test_a_long_number_of_an_origins_file():
    text = f'origins:\n  elbow: {{xyz: "{LONG} 0 0", rpy: "0 0 0"}}\n'
    start = time.process_time()
    with pytest.raises(FileError, match="origins, joint 'elbow': xyz is") as error:
        parse_origins(text.encode(), "o.yaml")
    in_time(start)
    assert len(str(error.value)) < 5000
