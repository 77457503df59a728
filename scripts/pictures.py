"""Take the pictures that README and docs show, from the demo: pages in a headless Chromium, and one of its figures.

    .venv/bin/python scripts/pictures.py          (writes docs/*.png)

Needs Debian's package chromium, or --browser PATH. What a picture was taken of is written into it, and a test compares
that with what the demo would show now: after a change of the pages, run this again.
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

import calib
from calib.calibration import calibrate
from calib.data import PAPER_TARGET, paper_measurements, paper_urdf
from calib.identify.result import Calibration
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.robot import Robot, read_only
from calib.show.pictures import write_page
from calib.show.report import write_report

ROOT = Path(__file__).parents[1]

#: The key of the text in a picture that says what it was taken of.
MADE_FROM = "calib-made-from"

#: The code that each page is made by, below calib/; meshes too: a robot drawn torn was not noticed.
_SHOWN = {
    "view": (
        "show/*page.*",
        "show/*.js",
        "show/motion.py",
        "show/scene.py",
        "show/arrangement.py",
        "show/puppet.py",
        "show/palette.py",
        "show/triangles.py",
        "show/visuals.py",
        "model/meshes.py",
    ),
    "report": ("show/report*", "show/figure*", "show/document.py", "show/palette.py"),
}

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


@dataclass(frozen=True)
class Picture:
    """A picture of a page.

    Attributes:
        name: File below docs/.
        page: ``"view"`` or ``"report"``.
        at: What is shown, as the page's address says it.
        size: Of the window [px].
    """

    name: str
    page: str
    at: str
    size: tuple[int, int]


PICTURES = (
    Picture("view.png", "view", "", (1600, 900)),
    Picture("overlaid.png", "view", "#mode=over&robots=50", (1600, 900)),
    Picture("report.png", "report", "", (1000, 1320)),
)


def demo_result() -> Calibration:
    """What `calib demo` computes."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    return calibrate(robot, table, cell=Cell(target=read_only(PAPER_TARGET), model="paper"))


def made_from(picture: Picture, result: Calibration) -> str:
    """A word for what a picture shows: the pages' own code, and what the calibration found, rounded."""
    folder = Path(calib.__file__).parent
    code = [
        file.read_bytes()
        for pattern in _SHOWN[picture.page]
        for file in sorted(folder.glob(pattern))
        if file.suffix in (".py", ".js", ".html", ".j2")
    ]
    # Beyond a micrometre and a microradian numbers differ from machine to machine.
    found = [f"{p.name} {round(p.value, 6) + 0.0:.6f}" for p in result.parameters]
    text = "\n".join([*found, picture.at, str(picture.size)])
    return hashlib.sha256(b"".join([*code, text.encode()])).hexdigest()[:16]


def main() -> int:
    """Calibrate, write the pages, photograph them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--browser", default=shutil.which("chromium"), help="Chromium to use")
    parser.add_argument("--out", type=Path, default=ROOT / "docs")
    arguments = parser.parse_args()
    if arguments.browser is None:
        print(
            "No chromium found. Install it (Debian: apt install chromium) or give --browser.",
            file=sys.stderr,
        )
        return 1
    result = demo_result()
    with tempfile.TemporaryDirectory() as folder:
        pages = {
            "view": write_page(result, Path(folder) / "view.html"),
            "report": write_report(result, Path(folder) / "report.html", command="calib demo"),
        }
        for path in _taken(arguments.browser, pages, result, arguments.out, Path(folder)):
            print(f"Written: {path}")
    return 0


def _taken(
    browser: str, pages: dict[str, Path], result: Calibration, out: Path, folder: Path
) -> Iterator[Path]:
    """Photograph each page and write the picture."""
    for picture in PICTURES:
        shot = folder / picture.name
        command = [
            browser,
            *_FLAGS,
            "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={folder}/profile",
            f"--window-size={picture.size[0]},{picture.size[1]}",
            f"--screenshot={shot}",
            pages[picture.page].as_uri() + picture.at,
        ]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        said = PngInfo()
        said.add_text(MADE_FROM, made_from(picture, result))
        with Image.open(shot) as image:
            image.convert("RGB").save(out / picture.name, optimize=True, pnginfo=said)
        yield out / picture.name


if __name__ == "__main__":
    sys.exit(main())
