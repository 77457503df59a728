"""Arms for fleets: virtual UR3s with errors of their own, their tables on the disk."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path

import calib.example
from calib.data.cell import Cell
from calib.fleets.fleet import FleetRobot
from calib.robot.robot import Robot
from calib.simulation.scenario import Scenario

TARGET = (-0.07, 0.07, 0.0225)

#: A model that is fitted fast.
CELL = Cell(base="base", tip="tool0", target=TARGET, model="zeros")


def scenario(robot: Robot) -> Scenario:
    """What the arms are like."""
    return Scenario(robot, cell=CELL, model="zeros")


def arms(folder: Path, robot: Robot, numbers: Iterable[int]) -> list[FleetRobot]:
    """Arms whose files stand in a folder: ``robot.urdf``, and ``arm-0.csv`` and so on with 12 poses."""
    what = scenario(robot)
    shutil.copy(calib.example.paper_urdf(), folder / "robot.urdf")
    made = []
    for k in numbers:
        path = folder / f"arm-{k}.csv"
        if not path.exists():
            what.draw(k).measure(what.random_poses(12, k), k).measurements.write(path)
        made.append(FleetRobot.of_files(f"arm-{k}", folder / "robot.urdf", path, CELL))
    return made


def files(folder: Path) -> dict[str, bytes]:
    """Every file of a folder and its bytes."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
