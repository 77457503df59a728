"""calib workspace: what it prints and writes, and what it refuses."""

from __future__ import annotations

import re
import shlex

import numpy as np
import pytest
from PIL import Image

from calib.cli.verbs.workspace import parse_margins, parse_within
from calib.design.region import RegionFile
from calib.robot.robot import Robot

PAPER = (
    "robot.urdf", "--base", "base", "--tip", "tool0", "--target", "-69.97 70.20 22.52 mm", "--like", "data.csv",
    "--margin", "5 deg",
)  # fmt: skip
FEW = ("--samples", "4096")


def test_the_paper_s_region(call, shop):
    done = call(
        shop, "workspace", *PAPER, "--check", "data.csv", "-o", "region.json", "--seed", "3"
    )
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == (
        "Robot 'ur3', base 'base', tip 'tool0', the target at -69.97 70.2 22.52 mm in it."
    )
    assert "  elbow_joint                     -95.21 to 128.63 deg" in done.lines
    assert "  wrist_3_joint                   -133.05 to 420.75 deg" in done.lines
    assert "estimation rows of data.csv, 5 deg wider at both ends" in done.out
    assert "  samples     524,288 (seed 3)" in done.lines
    assert "  voxel       25 mm; how often the target is in one is known to about 6 %" in done.lines
    assert re.search(r"\n {14}27\d litres: 17,\d{3} of the 27,\d{3} voxels", done.out)
    assert re.search(
        r"\n +33  validate +-202.5 +-70.8 +484.0   inside +1\d\d +\d+\.\d %\n", done.out
    )
    assert re.search(r"\n +34  validate +389.7 +-44.2 +440.3   OUTSIDE +1\d\d +", done.out)
    assert "  30 of 30 estimation rows lie in the region." in done.lines
    assert "  3 of 5 validation rows lie in the region; outside: 34, 35." in done.lines
    stored = RegionFile.read(shop / "region.json")
    assert (stored.robot, stored.base, stored.tip) == ("ur3", "base", "tool0")
    assert (stored.samples, stored.seed) == (2**19, 3)
    np.testing.assert_allclose(stored.target, [-0.06997, 0.07020, 0.02252], rtol=1e-12)
    assert max(map(len, done.lines)) <= 100


def test_the_command_printed_at_the_end(call, shop):
    extra = ("--range", "elbow_joint=0..90 deg", "--hold", "wrist_3_joint=10 deg", *FEW)
    done = call(shop, "workspace", *PAPER[:-4], *extra, "-o", "a region.json")
    command = done.out.split("Next:  ")[1].replace("\\\n", " ")
    assert shlex.split(command) == [
        "calib", "plan", "robot.urdf", "--base", "base", "--tip", "tool0", "--target", "-69.97 70.2 22.52 mm",
        "--hold", "wrist_3_joint=10 deg", "--range", "elbow_joint=0..90 deg", "--region", "a region.json",
        "-o", "plan.csv",
    ]  # fmt: skip
    done = call(shop, "workspace", *PAPER, *FEW)
    assert done.lines[-1].startswith("Next:  add -o region.json")


def test_figure_and_page(examples):
    folder = examples.folder
    with Image.open(folder / "region.png") as image:
        image.load()
        assert image.width > 1000
    page = (folder / "region.html").read_text(encoding="utf-8")
    assert "ur3: where the target comes to lie, 95 %" in page
    region = RegionFile.read(folder / "region.json").region
    assert region.held == pytest.approx(0.95, abs=1e-3)
    done = examples.starting("calib workspace robot.urdf --base base --range")
    assert "Written: region.html" in done.lines
    assert re.search(r"  samples     \d+,\d{3} in the box, of 524,288 \(seed 0\)", done.out)


def test_a_box_and_a_voxel(call, shop):
    done = call(
        shop, "workspace", "robot.urdf", "--base", "base", "--within", "-200 -200 0 to 200 200 600 mm",
        "--voxel", "50 mm", "--share", "0.5", *FEW, "-o", "r.json",
    )  # fmt: skip
    assert done.code == 0
    region = RegionFile.read(shop / "r.json").region
    assert region.voxel == 0.05
    assert region.bounds.min() >= -0.2
    np.testing.assert_allclose(region.box, [[-0.2, -0.2, 0.0], [0.2, 0.2, 0.6]])
    assert "the target at its origin" in done.lines[0]


def test_a_list_of_poses_and_an_unknown_frame_are_predicted(call, shop):
    lines = (shop / "joints.csv").read_text().splitlines()
    (shop / "poses.csv").write_text("\n".join(line.split(",", 1)[1] for line in lines))
    for words in (("--check", "poses.csv"), ("--check", "data.csv", "--frame", "estimate")):
        done = call(shop, "workspace", *PAPER, *FEW, *words)
        assert (done.code, done.err) == (0, "")
        assert f"Targets of {words[1]}, where the nominal robot puts them:" in done.lines
        assert re.search(r"\n +34  validate +386.\d +-43.\d +441.\d   OUTSIDE ", done.out)


def test_points_in_another_frame_are_noticed(call, shop):
    text = (shop / "data.csv").read_text().replace("-274.68,", "2274.68,")
    (shop / "moved.csv").write_text(re.sub(r"(?m)^((?:[^,]*,){2})(-?[\d.]+)", r"\g<1>1\2", text))
    target = ("--target", "400 0 0 mm")
    done = call(
        shop, "workspace", "robot.urdf", "--base", "base", *target, *FEW, "--check", "data.csv"
    )
    assert done.code == 0
    assert re.search(
        r"Note: the measured points lie \d{3} mm from where the nominal robot", done.out
    )
    assert "Note:" not in call(shop, "workspace", *PAPER, *FEW).out


def test_rows_near_the_border_are_named(call, shop):
    done = call(shop, "workspace", *PAPER, *FEW, "--voxel", "150 mm", "--check", "data.csv")
    assert "The border is known to about half a voxel: rows " in done.out


def test_long_tables_show_what_matters(call, shop):
    header, *rows = (shop / "data.csv").read_text().splitlines()
    if header.startswith("row"):
        rows = [f"{i}," + row.split(",", 1)[1] for i, row in enumerate(rows * 3, 1)]
    (shop / "long.csv").write_text("\n".join([header, *rows]))
    done = call(shop, "workspace", *PAPER, *FEW, "--check", "long.csv")
    assert re.search(r"\n  \d+ more rows lie inside by a voxel or more\.\n", done.out)
    assert len(re.findall(r"OUTSIDE", done.out)) == 6


def test_a_cell_file_gives_ranges_and_target(call, shop):
    (shop / "c.toml").write_text(
        'base = "base"\n[targets_mm]\nball = [-69.97, 70.20, 22.52]\n'
        '[ranges]\nelbow_joint = ["0 deg", "90 deg"]\n'
    )
    done = call(shop, "workspace", "robot.urdf", "--cell", "c.toml", *FEW)
    assert (done.code, done.err) == (0, "")
    assert "  elbow_joint                     0 to 90 deg" in done.lines
    assert "the target at -69.97 70.2 22.52 mm in it." in done.lines[0]
    narrow = ("--range", "elbow_joint=0..45 deg")
    done = call(shop, "workspace", "robot.urdf", "--cell", "c.toml", *FEW, *narrow)
    assert "  elbow_joint                     0 to 45 deg" in done.lines


@pytest.mark.parametrize(
    "words",
    [("panda", "--tip", "panda_link1"), ("tiago", "--tip", "arm_7_link")],
)
def test_robots_of_other_kinds(call, shop, words):
    drawn = ("--picture", "r.pdf", "--view", "r.html") if words[0] == "tiago" else ()
    done = call(shop, "workspace", *words, *FEW, "-o", "r.json", *drawn)
    assert (done.code, done.err) == (0, "")
    assert max(map(len, done.lines)) <= 100
    assert ("With fewer than three joints" in done.out) == (words[0] == "panda")


OUT = ("-o", "r.json", "--picture", "r.png", "--view", "r.html")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--share", "0"), "The share is 0; it must be greater than 0 and at most 1"),
        (("--voxel", "0 mm"), "The voxel is 0 mm; it must be a length greater than 0"),
        (("--voxel", "1 mm"), "at most 4,000,000 are made. Give voxels of "),
        (("--range", "elbow_joint=0..200 deg"), "of 'elbow_joint' is 0 to 200 deg; its limits in the URDF are -180 to"),
        (("--within", "2000 0 0 to 3000 1 1 mm"), "The region is empty: none of 4,096 samples lies in the box from"),
        (("--within", "0 0 0 to 0 1 1 mm"), "the second greater than the first along x, y and z"),
        (("--within", "0 0 0, 1 1 1 mm"), "it must be two corners in the base frame"),
        (("--margin", "5 deg"), "--margin widens the ranges of a table; name the table with --like"),
        (("--like", "data.csv", "--margin", "-5 deg"), '--margin was given as "-5 deg"; it must be a length, an angle'),
        (("--like", "data.csv", "--margin", "5 mm"), '--margin was given as "5 mm"; joints that turn'),
        (("--picture", "r.gif"), "r.gif: the ending says what kind of picture is written; choose one of"),
    ],
)  # fmt: skip
def test_errors_are_one_line_and_nothing_is_written(call, shop, words, said):
    before = {path.name for path in shop.iterdir()}
    out = OUT[:2] if "--picture" in words else OUT
    done = call(
        shop, "workspace", "robot.urdf", "--base", "base", "--tip", "tool0", *FEW, *out, *words
    )
    assert (done.code, done.out) == (1, "")
    assert done.err.startswith("calib: ")
    assert said in done.err
    assert done.err.count("\n") == 1
    assert {path.name for path in shop.iterdir()} == before


def test_words():
    np.testing.assert_allclose(
        parse_within("0 -1 2 to 3 4 5 cm"), [[0, -0.01, 0.02], [0.03, 0.04, 0.05]]
    )
    np.testing.assert_allclose(parse_within("0,0,0 to 0.1,0.2,0.3m"), [[0, 0, 0], [0.1, 0.2, 0.3]])
    np.testing.assert_allclose(parse_within("0 0 0 mm to 1 1 1 m"), [[0, 0, 0], [1, 1, 1]])
    robot = Robot.load("tiago", tip="arm_7_link")
    margins = parse_margins(["5 deg", "10 mm"], robot)
    slides = [kind == "prismatic" for kind in robot.joint_types.values()]
    np.testing.assert_allclose(margins, np.where(slides, 0.01, np.radians(5)))
    assert parse_margins(["10 mm"], robot)[1:].max() == 0
