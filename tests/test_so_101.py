"""The way of docs/so-101.md: a simulated SO-101, recorded in LeRobot's numbers, gets the offsets that it lacks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib.basics.tables import Table

#: Ranges of the motors, in ticks.
RANGES = {
    "shoulder_pan": (751, 3460),
    "shoulder_lift": (830, 3201),
    "elbow_flex": (900, 3121),
    "wrist_flex": (811, 3222),
    "wrist_roll": (0, 4095),
}

BOARD = ("--columns", 7, "--rows", 5, "--square", "17 mm", "--marker", "12 mm")

PLACES = ("--camera-on", "base_link", "--board-on", "gripper_link", "--camera", "1280x720")


def as_lerobot_writes(corners: Path, path: Path) -> None:
    """The same table with LeRobot's columns: percents of the ranges, of whole ticks."""
    table = Table.read(corners)
    columns = []
    for i, label in enumerate(table.header):
        name = label.split(" [")[0]
        texts = [row[i] for row in table.cells]
        if name in RANGES:
            assert label == f"{name} [deg]"
            first, last = RANGES[name]
            angles = np.array([float(text) for text in texts])
            ticks = np.round(angles * 4096 / 360 + (first + last) / 2)
            percents = (ticks - first) / (last - first) * 200 - 100
            label, texts = f"{name}.pos", [repr(float(percent)) for percent in percents]
        columns.append([label, *texts])
    path.write_text("\n".join(map(",".join, zip(*columns, strict=True))))


@pytest.mark.slow
def test_the_offsets_of_a_simulated_arm(call, tmp_path):
    motors = {
        name: {"id": i, "drive_mode": 0, "homing_offset": 10 * i, "range_min": a, "range_max": b}
        for i, (name, (a, b)) in enumerate(RANGES.items())
    }
    (tmp_path / "mine.json").write_text(json.dumps(motors))
    call(tmp_path, "board", "-o", "board", *BOARD)
    arm = ("--kind", "pixel", *PLACES, "--board", "board.toml", "--model", "zeros")
    size = ("--sizes", "zero 2 deg", "--count", 24, "--validation", 0, "--seed", 1)
    assert call(tmp_path, "simulate", "so101", *arm, *size, "-o", "sim.csv").code == 0
    as_lerobot_writes(tmp_path / "sim.csv", tmp_path / "corners.csv")
    numbers = ("--columns", "lerobot", "--joint-unit", "%", "--motors", "mine.json")
    made = ("--board", "board.toml", "--model", "zeros", "--json", "result.json")
    done = call(tmp_path, "calibrate", "so101", "corners.csv", *PLACES, *numbers, *made)
    assert done.code == 0
    done = call(
        tmp_path,
        *("convert", "result.json", "--to", "lerobot", "--update", "mine.json", "-o", "new.json"),
    )
    assert done.code == 0
    new = json.loads((tmp_path / "new.json").read_text())
    truth = json.loads((tmp_path / "sim_truth.json").read_text())["parameters"]
    true = {row["name"]: row["value"] for row in truth}
    changes = {name: new[name]["homing_offset"] - motors[name]["homing_offset"] for name in RANGES}
    for name in ("shoulder_lift", "elbow_flex", "wrist_flex"):
        wanted = -true[f"{name}.zero"] * 4096 / (2 * np.pi)  # the reading goes up by the zero
        assert changes[name] == pytest.approx(wanted, abs=1.6)
        assert abs(wanted) > 5
    # A camera at an unknown place turns with the first joint, and a board on the gripper with the last.
    assert changes["shoulder_pan"] == changes["wrist_roll"] == 0
