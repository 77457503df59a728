"""Write urdf/ur3_calibrated.urdf, the corrected robot of the demo, and the origins of its joints anew.

    .venv/bin/python scripts/update_demo.py

Tests compare the files with what the demo computes.
"""

from __future__ import annotations

from pathlib import Path

from calib.calibration import calibrate
from calib.data import PAPER_TARGET, paper_measurements, paper_urdf
from calib.formats.origins import write_origins
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.robot import Robot, read_only


def main() -> None:
    """Calibrate as the demo does and write the files beside the nominal URDF."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    cell = Cell(target=read_only(PAPER_TARGET), model="paper")
    result = calibrate(robot, table, cell=cell, validate=False)
    folder = paper_urdf().parent
    for path in (
        result.write_urdf(folder / "ur3_calibrated.urdf", overwrite=True),
        write_origins(result.robot, folder / "ur3_origins.yaml", overwrite=True),
        write_origins(robot, folder / "ur3_nominal_origins.yaml", overwrite=True),
    ):
        print(
            f"Written: {path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path}"
        )


if __name__ == "__main__":
    main()
