"""An operator with a virtual tracker, who reads the pose from the page and types what the tracker shows."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache

import numpy as np

from calib.data.cell import Cell
from calib.robot.robot import Robot
from calib.verbs.simulate.operator import Mistakes, Operator
from calib.verbs.simulate.scenario import Scenario
from tests.verbs.app.served import Answer, Client

AXES = ("x", "y", "z")


@cache
def arm() -> Robot:
    return Robot.load("ur10e", base="base_link", tip="tool0")


def operator(**mistakes: str) -> Operator:
    """A person with a tracker 3 m away, who makes mistakes at given readings, such as ``r3="gross"``."""
    cell = Cell(kind="point", estimate_frame=True, sigma={"m": 3e-5})
    planned = {int(name[1:]): code for name, code in mistakes.items()}
    return Operator.of(Scenario(arm(), cell).draw(4), 5, Mistakes(at=planned))


def begun(client: Client, **chosen: str) -> str:
    """A session of this arm that was begun on the page; its address."""
    job = client.upload("/measure", [], robot_name="ur10e", key=client.get("/measure").key()).to
    fields = {
        "action": "measure",
        "was:noise": "",
        "noise": "0.03 mm",
        "was:aim": "",
        "aim": "0.15 mm",
    }
    fields |= {"was:instrument": "", "instrument": "tracker", "was:serial": "", "serial": "SN-10"}
    fields |= {f"was:{name}": "" for name in chosen} | chosen
    answer = client.form(f"{job}/choose", fields)
    assert answer.status == 303, answer.text
    return job


def shown_pose(page: Answer) -> np.ndarray:
    """The joint values on the page [rad]."""
    row = re.search(r'<pre id="row" class="hidden">([^<]+)</pre>', page.text)
    assert row is not None, page.text
    return np.deg2rad([float(value) for value in row[1].split()])


def hidden(page: Answer) -> dict[str, str]:
    """The hidden fields of the form of a reading."""
    form = page.text.partition('id="entry">')[2]
    return {
        name: re.search(rf'name="{name}" value="([^"]+)"', form)[1]  # type: ignore[index]
        for name in ("key", "pose")
    }


def typed(xyz: np.ndarray, page: Answer) -> dict[str, str]:
    """What is typed of a position [m], with decimal commas."""
    values = {
        f"value:target:{axis} [mm]": f"{1e3 * v:.4f}".replace(".", ",")
        for axis, v in zip(AXES, xyz, strict=True)
    }
    return hidden(page) | values


def measure(client: Client, job: str, person: Operator) -> Mapping[str, str]:
    """Measure the pose that is shown; the form that was sent."""
    page = client.get(job)
    reading = person.measure(shown_pose(page), again="Again: stop" in page.text).readings
    form = typed(reading.points[0], page)
    answer = client.form(f"{job}/reading", form)
    assert answer.status == 303, answer.text
    return form
