"""``calib simulate``: the table, the truth beside it, what is printed, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.robot.robot import Robot

ARM = ("--base", "base", "--tip", "tool0")


@pytest.fixture
def simulate(call, shop: Path):
    """A function that simulates the paper's UR3 in the shop with further words."""

    def run(*words: str):
        return call(shop, "simulate", "robot.urdf", *ARM, *words)

    return run


def table(shop: Path, name: str = "t.csv") -> Measurements:
    return Measurements.read(shop / name)


def truth(shop: Path, name: str = "t_truth.json"):
    return json.loads((shop / name).read_text(encoding="utf-8"))


def test_a_table_and_the_truth_beside_it(simulate, shop: Path):
    done = simulate("-o", "t.csv", "--truth-urdf", "true.urdf", "--seed", "3")
    assert (done.code, done.err) == (0, "")
    assert max(map(len, done.lines)) <= 100
    made = table(shop)
    assert (made.estimation.sum(), made.validation.sum()) == (30, 10)
    said = truth(shop)
    assert [row["row"] for row in said["rows"]] == list(made.rows)
    off = made.points - [row["xyz_m"] for row in said["rows"]]
    assert 2e-5 < off.std() < 6e-5
    q = [row["joints"] for row in said["rows"]]
    T = Robot.load(shop / "true.urdf", "base", "tool0").poses(q)
    point = (T @ [*said["targets"][0]["xyz_m"], 1.0])[:, :3]
    assert point == pytest.approx(np.array([row["xyz_m"] for row in said["rows"]]), abs=1e-9)
    for word in (
        "40 rows (30 for estimation, 10 for validation)",
        "True errors               model placement",
        "length                  18, rms",
        "of the nominal robot",
        "Measurement frame         the base frame",
        "robot 20 um",
        "Written: t.csv",
        "Written: t_truth.json",
        "Written: true.urdf",
    ):
        assert word in done.out


def test_poses_of_a_table_keep_their_sets(simulate, shop: Path, paper_table):
    done = simulate("--poses", "data.csv", "-o", "t.csv", "--validation", "3")
    assert done.code == 0
    made = table(shop)
    assert made.joints[:35] == pytest.approx(paper_table.joints)
    assert made.sets == (*paper_table.sets, *["validate"] * 3)


def test_poses_of_a_table_with_the_columns_of_a_brand(simulate, shop: Path):
    (shop / "kuka.csv").write_text("A1,A2,A3,A4,A5,A6\n10,-80,40,0,20,30\n-10,-70,30,5,20,30\n")
    assert simulate("--poses", "kuka.csv", "--columns", "kuka", "-o", "k.csv").code == 0
    header, first = (shop / "k.csv").read_text().splitlines()[:2]
    values = dict(zip(header.split(","), first.split(","), strict=True))
    assert float(values["shoulder_lift_joint [deg]"]) == -80.0


def test_everything_that_disturbs_is_said(simulate, shop: Path):
    (shop / "two.toml").write_text(
        "[targets_mm]\nupper = [0, 0, 120]\nlower = [80, 0, 20]\n"
        "[frames.morning]\nxyz_mm = [1500, 0, 0]\n[frames.evening]\nxyz_mm = [2500, 0, 0]\n"
        '[tracker]\nxyz_mm = [2000, 500, 0]\nnoise = "30 um"\nrepeatability_mm = 0\n'
        "[simulation]\nvisits = 2\nencoder_deg = 0.001\noutlier_size_mm = 8\ndrift_mm = [0.1, 0, 0]\n"
        'moved_row = 25\nmoved_mm = [0, 0, 0.5]\nmoved_target = "upper"\n'
    )
    text = (shop / "two.toml").read_text()
    (shop / "two.toml").write_text("sigma_angle_deg = 0.02\n" + text)
    done = simulate(
        "-o", "t.csv", "--cell", "two.toml", "--kind", "pose", "--outliers", "5 %",
    )  # fmt: skip
    assert (done.code, done.err) == (0, "")
    text = " ".join(done.out.split())
    for words in (
        "160 rows (120 for estimation, 40 for validation)",
        "Each row measures the position and orientation of the target",
        "Targets at each pose upper, lower Stations in turn morning, evening Visits of each pose 2",
        "Frame of 'evening' the base is at (2500, 0, 0) mm in it",
        "Noise of a coordinate 0.03 mm std: instrument 30 um Noise of an orientation 0.02 deg",
        "Encoder steps 0.001 deg Outliers of 8 mm rows ",
        "Moved target 'upper' by (0, 0, 0.5) mm in the tip before row 25: 68 rows",
        "Drift, first to last row (0.1, 0, 0) mm in the measurement frame",
    ):
        assert words in text, words
    said = truth(shop)
    assert len(said["events"]["outliers"]) == 6
    assert said["instrument"]["tracker_base_xyz_m"] == [2.0, 0.5, 0.0]


def test_a_true_robot_is_the_truth(simulate, shop: Path):
    assert simulate("-o", "t.csv", "--seed", "2", "--truth-urdf", "true.urdf").code == 0
    assert simulate("-o", "u.csv", "--seed", "2", "--truth-robot", "true.urdf").code == 0
    assert table(shop).points == pytest.approx(table(shop, "u.csv").points, abs=1e-12)


def test_without_noise_a_fit_finds_the_truth(simulate, call, shop: Path):
    assert simulate("-o", "t.csv", "--noise", "none", "--frame", "estimate").code == 0
    (shop / "free.toml").write_text('priors = "off"\nframe = "estimate"\n')
    words = ("fit", "robot.urdf", "t.csv", *ARM, "--cell", "free.toml", "--model", "placement")
    assert call(shop, *words, "--json", "r.json", "--no-validate").code == 0
    errors = json.loads((shop / "r.json").read_text())["errors"]["calibrated"]
    assert errors["estimation"]["m"]["max"] < 1e-9
    assert errors["validation"]["m"]["max"] < 1e-9


IMAGES = ("--kind", "pixel", "--camera-on", "tool0", "--board-on", "base")


@pytest.fixture
def photograph(call, shop: Path):
    """A function that simulates pictures of the paper's UR3 in the shop with further words."""

    def run(*words: str):
        return call(shop, "simulate", "robot.urdf", *words)

    return run


@pytest.mark.slow
def test_pictures_with_their_files_and_the_table_of_corners(photograph, shop: Path):
    words = (*IMAGES, "--count", "2", "--validation", "1", "--seed", "3")
    done = photograph(*words, "--images", "pictures", "-o", "t.csv", "--noise", "0.2 px")
    assert (done.code, done.err) == (0, "")
    assert max(map(len, done.lines)) <= 100
    names = sorted(path.name for path in (shop / "pictures").iterdir())
    pictures = ["picture_01.png", "picture_02.png", "picture_03.png"]
    assert names == ["board.toml", "camera.yaml", "joints.csv", *pictures]
    made = table(shop)
    assert set(made.images) == set(pictures)
    assert {made.images[i] for i in np.flatnonzero(made.validation)} == {pictures[2]}
    said = truth(shop)
    pixels = np.concatenate([picture["pixels"] for picture in said["pictures"]])
    off = np.column_stack([made.reading("u"), made.reading("v")]) - pixels
    assert off.std() == pytest.approx(0.2, rel=0.25)
    for word in ("72 corners in 3 pictures", "Written: pictures/joints.csv", "Written: t.csv"):
        assert word in done.out
    again = photograph(*words, "--images", "pictures")
    assert again.code != 0
    forced = photograph(*words, "--images", "pictures", "--force")
    assert forced.code == 0
    assert (shop / "pictures" / "truth.json").exists()


def test_the_same_seed_gives_the_same_corners(photograph, shop: Path):
    for name in ("one.csv", "two.csv"):
        assert photograph(*IMAGES, "--count", "2", "-o", name).code == 0
    assert (shop / "one.csv").read_bytes() == (shop / "two.csv").read_bytes()
    assert (shop / "one_truth.json").read_bytes() == (shop / "two_truth.json").read_bytes()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--images", "pictures"), "--kind pixel"),
        ((*IMAGES, "--noise", "0.1 mm", "-o", "t.csv"), "px"),
        ((*IMAGES,), "-o table.csv"),
    ],
)
def test_pictures_that_cannot_be_simulated(photograph, shop: Path, words, said):
    done = photograph(*words)
    assert done.code != 0
    assert said in done.err
    assert not (shop / "pictures").exists()


@pytest.mark.parametrize(
    ("words", "tips"),
    [
        (("tiago_dual",), ("wrist_left_ft_tool_link", "wrist_right_ft_tool_link")),
        (("panda", "--other-robot", "right=panda"), ("panda_link8", "right/panda_link8")),
    ],
)
@pytest.mark.parametrize("verb", ["simulate", "plan"])
def test_of_two_arms_the_hand_is_to_be_named(call, shop: Path, verb, words, tips):
    done = call(shop, verb, *words, "--frame", "estimate", "-o", "two.csv")
    assert done.code == 1
    assert all(f"--tip NAME={tip}" in done.err for tip in tips)
    assert not (shop / "two.csv").exists()


# Sessions


@pytest.mark.slow
def test_a_session_leaves_its_folder_and_the_truth_beside_it(simulate, shop: Path):
    words = ("--model", "zeros", "--frame", "estimate", "--session", "s", "--aim", "0.1 mm")
    done = simulate(*words, "--seed", "5", "--mistakes")
    assert (done.code, done.err) == (0, "")
    said = truth(shop, "s_truth.json")
    assert said["schema"] == "session truth 1"
    assert said["seed"] == 5
    assert len(said["parameters"]) == 6
    events = [json.loads(line) for line in (shop / "s" / "journal.jsonl").read_text().splitlines()]
    rows = [event for event in events if event["event"] == "row"]
    assert len(said["stops"]) == len(rows)
    assert max(map(len, done.lines)) <= 100
    assert "error of the calibrated robot in mm, at most, with 95 %" in " ".join(done.out.split())
    lines = done.out.replace("\n      ", " ").splitlines()
    lines = [line for line in lines if line[:4].strip().isdigit()]
    assert [int(line[:4]) for line in lines] == [stop["stop"] for stop in said["stops"]]
    for line, stop in zip(lines, said["stops"], strict=True):
        is_knock = bool(stop["mistakes"]) and stop["mistakes"][0]["mistake"].endswith("moved")
        assert ("in truth" in line) == bool(stop["mistakes"]) or is_knock
        joints = [float(word) for word in line.split()[1:7]]
        assert joints == pytest.approx(np.degrees(stop["joints"]), abs=0.051)
    table = Measurements.read(shop / "s" / "measurements.csv")
    assert len(table) <= len(rows)
    assert any(line.startswith("Verdict: ") for line in done.lines)
    assert simulate(*words).code != 0  # the truth is there


def test_what_a_session_refuses(simulate, shop: Path):
    for words in (
        ("--mistakes", "-o", "t.csv"),
        ("--aim", "0.1 mm", "-o", "t.csv"),
        ("--session", "s", "-o", "t.csv"),
        ("--session", "s", "--poses", "data.csv"),
        ("--session", "s", "--validation", "3"),
        ("--session", "s", "--aim", "0.1"),
        ("--session", "s", "--outliers", "3"),
        ("--session", "s", "--kind", "distance"),
    ):
        done = simulate(*words)
        assert (done.code, done.out) != (0, ""), words
        assert done.err, words
    assert not (shop / "s").exists()
    assert not (shop / "t.csv").exists()
