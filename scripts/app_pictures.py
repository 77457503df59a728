"""Make the pictures of docs/app.md anew: the app in Chromium, from files to the verdict, a session, a check, a history.

    python scripts/app_pictures.py

The files are those of the paper's UR3; a virtual operator measures the session.
"""

from __future__ import annotations

import io
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from calib.data.cell import Cell  # noqa: E402
from calib.data.measurements import Measurements  # noqa: E402
from calib.data.record import Record  # noqa: E402
from calib.example import paper_measurements, paper_urdf  # noqa: E402
from calib.result.calibrate import calibrate  # noqa: E402
from calib.robot.robot import Robot  # noqa: E402
from tests.browser import Browser, Tab  # noqa: E402
from tests.verbs.app.measured import begun, measure, operator  # noqa: E402
from tests.verbs.app.served import Client, served  # noqa: E402
from tests.verbs.check.shop import POSES, points, write_rows  # noqa: E402

#: Where the pictures are.
PICTURES = ROOT / "docs" / "app"

#: A window at a desk, and a phone [px].
DESK, PHONE = (1200, 900), (412, 860)

#: Colours of a picture, which makes it small.
_COLOURS = 128

#: Stops of the session in the picture.
_STOPS = 14

#: Calibrations of the history: date and model.
_DATES = (("2026-01-12", "zeros"), ("2026-03-02", "dh"), ("2026-06-15", "hayati"))


@contextmanager
def page(browser: Browser, client: Client, path: str, size: tuple[int, int]) -> Iterator[Tab]:
    """Open a page of the app in a window."""
    joint = "&" if "?" in path else "?"
    with browser.open(f"http://{client.host}{path}{joint}token={client.token}", size) as tab:
        tab.wait_for("document.readyState === 'complete'")
        time.sleep(4.0 if tab.evaluate("!!document.querySelector('iframe')") else 0.5)
        yield tab


def keep(tab: Tab, name: str) -> None:
    """Keep what a window shows as a picture."""
    picture = Image.fromarray(tab.screenshot()).quantize(_COLOURS)
    data = io.BytesIO()
    picture.save(data, "PNG", optimize=True)
    (PICTURES / f"{name}.png").write_bytes(data.getvalue())
    print(f"Written: docs/app/{name}.png, {len(data.getvalue()) // 1000} kB")


def keep_results(folder: Path) -> None:
    """Write the results of a robot over half a year."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names)
    for date, model in _DATES:
        result = calibrate(robot, table, cell=Cell(model=model, instrument="tracker"))
        place = folder / date
        place.mkdir()
        record = Record(robot_serial="SN-017", date=date)
        replace(result, record=record).write_json(place / "result.json")


def main() -> None:
    """Take all pictures."""
    PICTURES.mkdir(exist_ok=True)
    browser = Browser()
    with tempfile.TemporaryDirectory() as name, served(Path(name) / "calib-app", "en") as client:
        try:
            client.enter()
            with page(browser, client, "/open", DESK) as tab:
                keep(tab, "open")
            job = client.open(paper_urdf(), paper_measurements())
            with page(browser, client, job, DESK) as tab:
                keep(tab, "reading")
            client.post(f"{job}/choose", action="calibrate")
            client.wait(job)
            with page(browser, client, job, DESK) as tab:
                keep(tab, "verdict")
                tab.evaluate("document.querySelector('iframe').scrollIntoView({block: 'center'})")
                time.sleep(4.0)
                keep(tab, "before-and-after")
            session = begun(client)
            person = operator()
            for _ in range(_STOPS):
                measure(client, session, person)
            with page(browser, client, session, DESK) as tab:
                keep(tab, "measure")
            with page(browser, client, session, PHONE) as tab:
                keep(tab, "phone")
            keep_results(client.folder)
            moved = points(POSES, zeros=(0.0, 0.0, np.deg2rad(0.3), 0.0, 0.0, 0.0))
            rows = write_rows(moved, Path(name) / "morning.csv").read_bytes()
            parts = [("files", "morning.csv", rows)]
            check = client.upload("/check", parts, result=f"{job[6:]}/result.json").to
            client.wait(check)
            with page(browser, client, check, DESK) as tab:
                keep(tab, "check")
            with page(browser, client, "/history", DESK) as tab:
                keep(tab, "history")
        finally:
            browser.close()


if __name__ == "__main__":
    main()
