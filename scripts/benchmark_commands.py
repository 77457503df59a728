"""The commands that people wait for, with inputs that are simulated: written into a folder, each when it is asked for.

Tables are of the paper's UR3 with DH errors of a usual size (`benchmark_one.simulate`) or by ``calib simulate``.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from benchmark_one import simulate

from calib.example import paper_measurements, paper_urdf

#: What follows ``calib``, after the inputs were written into a folder.
Prepare = Callable[[Path], list[str]]

#: The chain of the paper's UR3.
CHAIN = ["--base", "base", "--tip", "tool0"]

#: The board of 24 corners, that of 54 and that of 63.
BOARDS = {
    24: 'pattern = "charuco"\ncolumns = 7\nrows = 5\nsquare_mm = 30\nmarker_mm = 22\ndictionary = "DICT_5X5_100"\n',
    54: 'pattern = "charuco"\ncolumns = 10\nrows = 7\nsquare_mm = 30\nmarker_mm = 22\ndictionary = "DICT_5X5_100"\n',
    63: 'pattern = "chessboard"\ncolumns = 10\nrows = 8\nsquare_mm = 20\n',
}

#: Four markers on a flange.
MARKERS = """
base = "base"
tip = "tool0"
frame = "estimate"
[targets_mm]
a = [60, 0, 40]
b = [-60, 0, 40]
c = [0, 60, 40]
d = [0, -60, 60]
"""

#: Joints of the long chain, and length of its links [m].
LONG, LINK = 60, 0.1


def run_calib(folder: Path, arguments: Sequence[str]) -> None:
    """Run a calib command that makes an input, in its folder."""
    command = [sys.executable, "-m", "calib", *arguments]
    subprocess.run(command, cwd=folder, stdout=subprocess.DEVNULL, check=True)


def outputs(name: str = "corrected") -> list[str]:
    """Return the options that name the outputs of a fit."""
    return ["-o", f"{name}.urdf", "--json", f"{name}.json", "--force", "--quiet"]


def of_rows(count: int) -> Prepare:
    """Return how a table of so many points is calibrated."""

    def prepare(folder: Path) -> list[str]:
        _, table = simulate(count)
        table.write(folder / "table.csv", overwrite=True)
        return ["calibrate", str(paper_urdf()), "table.csv", *CHAIN, *outputs()]

    return prepare


def of_paper(*more: str) -> Prepare:
    """Return how the paper's 35 rows are calibrated, with further options."""

    def prepare(folder: Path) -> list[str]:
        del folder
        inputs = [str(paper_urdf()), str(paper_measurements())]
        return ["calibrate", *inputs, *CHAIN, *outputs(), *more]

    return prepare


def simulated(robot: str, options: Sequence[str], fitted: Sequence[str], cell: str = "") -> Prepare:
    """Return how a table by ``calib simulate`` is calibrated.

    Args:
        robot: Name of the robot.
        options: Options of the simulation.
        fitted: Options of the fit.
        cell: Cell file of both; "" for none.
    """

    def prepare(folder: Path) -> list[str]:
        (folder / "cell.toml").write_text(cell, encoding="utf-8")
        of_cell = ["--cell", "cell.toml"] if cell else []
        no_rest = ["--validation", "0", "-o", "table.csv", "--force"]
        run_calib(folder, ["simulate", robot, *of_cell, *options, *no_rest])
        return ["calibrate", robot, "table.csv", *of_cell, *fitted, *outputs()]

    return prepare


def of_pictures(
    robot: str, camera_on: Sequence[str], board_on: str, corners: int, pictures: int
) -> Prepare:
    """Return how the corners of pictures are calibrated, of which the camera's size alone is known.

    Args:
        robot: Name of the robot.
        camera_on: Links that carry the cameras, with the cameras' names if there are several.
        board_on: Link that carries the board.
        corners: Number of its corners, of `BOARDS`.
        pictures: Number of poses.
    """

    def prepare(folder: Path) -> list[str]:
        (folder / "board.toml").write_text(BOARDS[corners], encoding="utf-8")
        links = [word for link in camera_on for word in ("--camera-on", link)]
        links += ["--board-on", board_on]
        seen = ["--camera", "1280x720", "--board", "board.toml"]
        options = ["--kind", "pixel", *links, *seen, "--count", str(pictures)]
        return simulated(robot, options, [*links, *seen])(folder)

    return prepare


def of_moving_arm(count: int) -> Prepare:
    """Return how so many rows of an arm are calibrated that moves on slowly, at 10 rows a second."""

    def prepare(folder: Path) -> list[str]:
        seconds = np.arange(count) / 10.0
        periods = np.array([31.0, 43.0, 23.0, 17.0, 13.0, 29.0])  # [s], without a common multiple
        q = 100.0 * np.sin(2.0 * np.pi * seconds[:, None] / periods)
        names = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
        head = ",".join(f"{name}_joint [deg]" for name in names)
        np.savetxt(folder / "poses.csv", q, delimiter=",", header=head, comments="", fmt="%.6f")
        options = ["--base", "base", "--tip", "tool0", "--poses", "poses.csv"]
        run_calib(folder, ["simulate", "ur5", *options, "-o", "table.csv", "--force"])
        return ["calibrate", "ur5", "table.csv", *CHAIN, *outputs()]

    return prepare


def of_long_chain(rows: int) -> Prepare:
    """Return how a chain of `LONG` joints about x, y and z in turn is calibrated from so many points."""

    def prepare(folder: Path) -> list[str]:
        links = "".join(f'<link name="l{k}"/>' for k in range(LONG + 1))
        joints = ""
        for k in range(LONG):
            axis = " ".join("1" if k % 3 == i else "0" for i in range(3))
            joints += (
                f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
                f'<origin xyz="0 0 {LINK}"/><axis xyz="{axis}"/>'
                '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
            )
        urdf = f'<robot name="long">{links}{joints}</robot>'
        (folder / "long.urdf").write_text(urdf, encoding="utf-8")
        chain = ["--base", "l0", "--tip", f"l{LONG}"]
        return simulated("long.urdf", [*chain, "--count", str(rows)], chain)(folder)

    return prepare


def of_fleet(robots: int) -> Prepare:
    """Return how so many robots of 30 rows are calibrated."""

    def prepare(folder: Path) -> list[str]:
        lines = ["name,robot,data"]
        for k in range(robots):
            _, table = simulate(30, seed=k)
            table.write(folder / f"{k}.csv", overwrite=True)
            lines.append(f"SN-{k},{paper_urdf()},{k}.csv")
        (folder / "manifest.csv").write_text("\n".join(lines), encoding="utf-8")
        return ["fleet", "manifest.csv", "--out", "results", *CHAIN]

    return prepare


def of_drawn_pictures(pictures: int, drawn: str = "", described: str = "") -> Prepare:
    """Return how corners are found in so many drawn pictures of 1280 x 720.

    Args:
        pictures: Their number. Ten are drawn, and used as often as needed: drawing takes longer than searching.
        drawn: Description of the board; "" for a usual one.
        described: What the description says instead; "" if it is right.
    """

    def prepare(folder: Path) -> list[str]:
        options = ["--kind", "pixel", "--camera-on", "tool0", "--board-on", "base_link"]
        options += ["--camera", "1280x720", "--validation", "0", "--count", "10"]
        if drawn:
            (folder / "drawn.toml").write_text(drawn, encoding="utf-8")
            options += ["--board", "drawn.toml"]
        run_calib(folder, ["simulate", "ur5", *options, "--images", "drawn", "--force"])
        source = folder / "drawn"
        board = described or (source / "board.toml").read_text(encoding="utf-8")
        (folder / "board.toml").write_text(board, encoding="utf-8")

        head, *rows = (source / "joints.csv").read_text(encoding="utf-8").splitlines()
        column = head.split(",").index("image")
        lines = [head]
        for k in range(pictures):
            cells = rows[k % len(rows)].split(",")
            picture = next(source.glob(f"{Path(cells[column]).stem}.png"))
            cells[column] = f"copy_{k}.png"
            (source / cells[column]).write_bytes(picture.read_bytes())
            lines.append(",".join(cells))
        (folder / "joints.csv").write_text("\n".join(lines), encoding="utf-8")
        inputs = ["drawn/copy_*.png", "--board", "board.toml", "--joints", "joints.csv"]
        return ["detect", *inputs, "-o", "corners.csv", "--force"]

    return prepare


def of_demo(folder: Path) -> list[str]:
    """Return the demo's arguments."""
    del folder
    return ["demo", "--out", "demo", "--force", "--quiet"]


def of_plan(folder: Path) -> list[str]:
    """Return how 30 of 20,000 poses are planned."""
    del folder
    target = ["--target", "70 -70 22.5 mm"]
    return ["plan", "ur3", *CHAIN, *target, "-o", "plan.csv", "--force", "--quiet"]


def of_view(folder: Path) -> list[str]:
    """Return how the page of a result and its rows is made."""
    run_calib(folder, of_paper()(folder))
    shown = ["--calibration", "corrected.json", "--data", str(paper_measurements())]
    return ["view", str(paper_urdf()), *CHAIN, *shown, "-o", "view.html", "--force"]


#: The commands by the title of their row.
COMMANDS: Mapping[str, Prepare] = {
    "`calib --help`": lambda _: ["--help"],
    "`calib calibrate`, the paper's 35 rows": of_paper(),
    "the same with `--report`": of_paper("--report", "report.html"),
    "30 rows": of_rows(30),
    "300 rows": of_rows(300),
    "3,000 rows": of_rows(3_000),
    "100,000 rows": of_rows(100_000),
    "1,000,000 rows": of_rows(1_000_000),
    "3,400 rows of a moving arm": of_moving_arm(3_400),
    "four markers at 37 stops": simulated("ur5", ["--count", "37"], [], MARKERS),
    "two arms, 14 joints, 170 points": simulated(
        "baxter",
        _arms := [
            *("--base", "base", "--frame", "estimate"),
            *("--tip", "left=left_gripper", "--tip", "right=right_gripper", "--count", "85"),
        ],
        _arms[:-2],
    ),
    "60 joints, 80 points": of_long_chain(80),
    "24 pictures of 24 corners": of_pictures("panda", ["panda_link8"], "panda_link0", 24, 24),
    "120 pictures of 54 corners": of_pictures("ur5", ["tool0"], "base_link", 54, 120),
    "four cameras, 80 pictures of 63 corners": of_pictures(
        "ur3", [f"cam{k}=base_link" for k in range(1, 5)], "tool0", 63, 64
    ),
    "`calib detect`, 160 pictures of 1280 x 720": of_drawn_pictures(160),
    "`calib plan`, 30 poses of 20,000": of_plan,
    "`calib view`, 35 rows": of_view,
    "`calib demo`": of_demo,
    "`calib fleet`, 20 robots of 30 rows": of_fleet(20),
}

#: Pictures whose board is described wrongly, and words of the finding that names the cause.
WRONG_BOARDS: Mapping[str, tuple[Prepare, str]] = {
    "`calib detect`: markers of another dictionary": (
        of_drawn_pictures(24, BOARDS[24], BOARDS[24].replace("5X5", "6X6")),
        "the markers are from DICT_5X5_50",
    ),
    "`calib detect`: other ids of markers": (
        of_drawn_pictures(24, BOARDS[24], BOARDS[24] + "first_marker = 40\n"),
        "the first marker has the id 0",
    ),
    "`calib detect`: inner corners for squares": (
        of_drawn_pictures(24, BOARDS[63], BOARDS[63].replace("10", "9").replace("8", "7")),
        "numbers of inner corners",
    ),
}
