"""Arms for fleets: virtual UR3s with errors of their own, their tables on the disk."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path

import calib.example
from calib.data.cell import Cell
from calib.robot.robot import Robot
from calib.verbs.fleet.job import FleetRobot
from calib.verbs.simulate.scenario import Scenario

#: Position of the target in the tip [m].
TARGET = (-0.07, 0.07, 0.0225)

#: A measurement setup whose model is fitted fast.
CELL = Cell(base="base", tip="tool0", target=TARGET, model="zeros")


def scenario(robot: Robot) -> Scenario:
    """The arms' distribution of errors: joint zeros."""
    return Scenario(robot, cell=CELL, model="zeros")


def arms(folder: Path, robot: Robot, numbers: Iterable[int]) -> list[FleetRobot]:
    """Arms whose files stand in a folder: ``robot.urdf``, and ``arm-0.csv`` and so on with 12 poses."""
    errors = scenario(robot)
    shutil.copy(calib.example.paper_urdf(), folder / "robot.urdf")
    robots = []
    for k in numbers:
        table = folder / f"arm-{k}.csv"
        if not table.exists():
            poses = errors.random_poses(12, k)
            errors.draw(k).measure(poses, k).measurements.write(table)
        robots.append(arm(folder, f"arm-{k}"))
    return robots


def arm(folder: Path, name: str) -> FleetRobot:
    """The arm whose table in the folder has its name."""
    return FleetRobot.of_files(name, folder / "robot.urdf", folder / f"{name}.csv", CELL)


def files(folder: Path) -> dict[str, bytes]:
    """Every file of a folder and its bytes."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
