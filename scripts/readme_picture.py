"""Take the README's picture: the demo's page, drawn by a headless Chromium.

    .venv/bin/python scripts/readme_picture.py          (writes docs/view.png)

Needs Debian's package chromium, or --browser PATH.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from calib.data import PAPER_TARGET, paper_measurements, paper_urdf
from calib.identify.calibration import calibrate
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.robot import Robot, read_only
from calib.show.pictures import write_page

_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--virtual-time-budget=8000",
)


def main() -> int:
    """Calibrate, write the page, photograph it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--browser", default=shutil.which("chromium"), help="Chromium to use")
    parser.add_argument("--out", type=Path, default=Path("docs/view.png"))
    arguments = parser.parse_args()
    if arguments.browser is None:
        print(
            "No chromium found. Install it (Debian: apt install chromium) or give --browser.",
            file=sys.stderr,
        )
        return 1
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    cell = Cell(target=read_only(PAPER_TARGET), model="paper")
    with tempfile.TemporaryDirectory() as folder:
        page = write_page(calibrate(robot, table, cell=cell), Path(folder) / "view.html")
        subprocess.run(
            [
                arguments.browser,
                *_FLAGS,
                "--host-resolver-rules=MAP * ~NOTFOUND",
                f"--user-data-dir={folder}/profile",
                "--window-size=1600,900",
                f"--screenshot={arguments.out.resolve()}",
                page.as_uri(),
            ],
            check=True,
            capture_output=True,
            timeout=120,
        )
    print(f"Written: {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
