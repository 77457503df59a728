"""calib workspace: what it prints and writes, and what it refuses."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from calib.verbs.workspace.region_file import read_region

PAPER = (
    "robot.urdf", "--base", "base", "--tip", "tool0", "--target", "-69.97 70.20 22.52 mm", "--like", "data.csv",
    "--margin", "5 deg",
)  # fmt: skip
FEW = ("--samples", "4096")


def test_the_paper_s_region(call, shop):
    done = call(
        shop, "workspace", *PAPER, "--check", "data.csv", "-o", "region.json", "--seed", "3",
        "--samples", "131072",
    )  # fmt: skip
    assert (done.code, done.err) == (0, "")
    assert max(map(len, done.lines)) <= 100
    assert "  elbow_joint                     -95.21 to 128.63 deg" in done.lines
    assert "  samples     131,072 (seed 3)" in done.lines
    assert re.search(
        r"\n  volume +2[78]\d(\.\d)? litres, [\d,]+ of [\d,]+ reached voxels", done.out
    )
    assert re.search(r"\n +34  validate +389.7 +-44.2 +440.3   OUTSIDE +\S+", done.out)
    assert "  30 of 30 estimation rows lie in the region." in done.lines
    assert "  3 of 5 validation rows lie in the region; outside: 34, 35." in done.lines
    stored = json.loads((shop / "region.json").read_text())
    robot = stored["robot"]
    assert (robot["name"], robot["base"], robot["tip"]) == ("ur3", "base", "tool0")
    assert (stored["samples"], stored["seed"]) == (2**17, 3)
    np.testing.assert_allclose(stored["target_xyz_m"], [-0.06997, 0.0702, 0.02252], rtol=1e-12)
    assert read_region(shop / "region.json").held == pytest.approx(0.95, abs=1e-3)


def test_a_list_of_poses_and_an_unknown_frame_are_predicted(call, shop):
    lines = (shop / "joints.csv").read_text().splitlines()
    (shop / "poses.csv").write_text("\n".join(line.split(",", 1)[1] for line in lines))
    for words in (("--check", "poses.csv"), ("--check", "data.csv", "--frame", "estimate")):
        done = call(shop, "workspace", *PAPER, *FEW, *words)
        assert (done.code, done.err) == (0, "")
        assert f"Targets of {words[1]}, 0 measured, 35 predicted:" in done.lines
        assert re.search(r"\n +34  validate +386.\d +-43.\d +441.\d   OUTSIDE ", done.out)


def test_a_cell_file_gives_ranges_and_target(call, shop):
    (shop / "c.toml").write_text(
        'base = "base"\n[targets_mm]\nball = [-69.97, 70.20, 22.52]\n'
        '[ranges]\nelbow_joint = ["0 deg", "90 deg"]\n'
    )
    words = ("--voxel", "50 mm", "--share", "0.5", "-o", "r.json")
    done = call(shop, "workspace", "robot.urdf", "--cell", "c.toml", *FEW, *words)
    assert (done.code, done.err) == (0, "")
    assert "  elbow_joint                     0 to 90 deg" in done.lines
    assert "target at -69.97 70.2 22.52 mm" in done.lines[0]
    assert read_region(shop / "r.json").voxel == 0.05


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--share", "0"), "The share is 0; it must be greater than 0 and at most 1"),
        (("--voxel", "1 mm"), "at most 4,000,000 are made"),
        (("--like", "data.csv", "--margin", "5 mm"), "it must be an angle"),
        (("--picture", "r.gif"), "cannot be written as 'gif'"),
        (("--tip", "a=tool0"), "for one chain at a time"),
    ],
)
def test_errors_are_one_line_and_nothing_is_written(call, shop, words, said):
    before = {path.name for path in shop.iterdir()}
    done = call(shop, "workspace", "robot.urdf", "--base", "base", *FEW, "-o", "r.json", *words)
    assert (done.code, done.out) == (1, "")
    assert said in done.err
    assert done.err.count("\n") == 1
    assert {path.name for path in shop.iterdir()} == before
