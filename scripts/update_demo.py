"""Make anew what ships with the demo: the corrected UR3, the origins of its joints, and the pictures of the docs.

    python scripts/update_demo.py [--no-pictures] [--browser chromium]

Tests compare the robots' files with what the demo computes. The pictures are taken by a headless Chromium.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tempfile
from pathlib import Path

from calib.basics.arrays import read_only
from calib.boards.board_file import read_board
from calib.camera.camera_file import read_camera
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, franka_file, paper_measurements, paper_urdf
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.calibrate.report import write_report
from calib.verbs.convert.origins import write_origins
from calib.verbs.view.robots_page import write_page

DOCS = Path(__file__).parents[1] / "docs"

#: The pictures: the file below docs/, the page and what its address asks for, and the window's size [px].
PICTURES = (
    ("view.png", "view.html", (1600, 900)),
    ("overlaid.png", "view.html#mode=over&factor=50", (1600, 900)),
    ("report.png", "report.html", (1000, 1320)),
    ("camera.png", "camera.html", (1600, 900)),
)

#: Options of Chromium: a picture of the whole window, and nothing from the network.
_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--hide-scrollbars",
    "--virtual-time-budget=8000",
    "--host-resolver-rules=MAP * ~NOTFOUND",
)


def main() -> None:
    """Calibrate as the demo does, write the files beside the nominal URDF, and photograph the pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--no-pictures", action="store_true", help="write the files alone")
    parser.add_argument("--browser", default=shutil.which("chromium"), help="Chromium to use")
    arguments = parser.parse_args()
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    cell = Cell(target=read_only(PAPER_TARGET), model="paper", instrument="tracker")
    result = calibrate(robot, table, cell=cell)
    folder = paper_urdf().parent
    result.write_urdf(folder / "ur3_calibrated.urdf", overwrite=True)
    write_origins(result.robot, folder / "ur3_origins.yaml", overwrite=True)
    write_origins(robot, folder / "ur3_nominal_origins.yaml", overwrite=True)
    if arguments.no_pictures:
        return
    if arguments.browser is None:
        parser.error("no chromium found; install it or give --browser")
    with tempfile.TemporaryDirectory() as pages:
        write_page(result, Path(pages) / "view.html")
        write_report(result, Path(pages) / "report.html", command="calib demo")
        write_page(franka_result(), Path(pages) / "camera.html")
        for name, page, (width, height) in PICTURES:
            file, hash_sign, fragment = page.partition("#")
            address = (Path(pages) / file).as_uri() + hash_sign + fragment
            command = [arguments.browser, *_FLAGS, f"--user-data-dir={pages}/profile"]
            command += [f"--window-size={width},{height}", f"--screenshot={DOCS / name}", address]
            subprocess.run(command, check=True, capture_output=True, timeout=120)
            print(f"Written: {DOCS / name}")


def franka_result() -> Calibration:
    """Calibrate the Franka arm with a camera as `calib demo --camera` does."""
    robot = Robot.load("panda", base="panda_link8", tip="panda_link0")
    cameras = {"": read_camera(franka_file("camera.toml"))}
    boards = {"": read_board(franka_file("board.toml"))}
    cell = Cell(cameras=cameras, boards=boards, model="dh")
    return calibrate(robot, franka_file("corners.csv"), cell=cell)


if __name__ == "__main__":
    main()
