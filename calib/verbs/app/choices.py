"""What a page sends: which choices it changes, and files that are not taken."""

from __future__ import annotations

from collections.abc import Mapping

from calib.data.cell import read_toml
from calib.errors import CalibError
from calib.verbs.app.job import Job
from calib.verbs.app.uploads import Received, UploadError

#: Choices that go if another robot, table or cell is chosen, as they are about its links and columns.
_OF_ROBOT = ("base", "tip", "frame")
_OF_TABLE = ("kind", "points", "points_unit", "joint_unit", "position_unit", "brand")


def check_no_plugins(received: Received) -> None:
    """Refuse cell files that load code: what was sent is not run. A file that is no TOML is judged later."""
    for name in received.files:
        if not name.lower().endswith(".toml"):
            continue
        try:
            table = read_toml(received.folder / name)
        except CalibError:
            continue
        if "plugins" in table:
            raise UploadError(
                f"'{name}' names plugins, which are Python code; the app runs none that was sent. Leave out the key "
                "'plugins', or calibrate on the command line."
            )


def choices_of(job: Job, form: Mapping[str, str]) -> dict[str, str]:
    """Return what is chosen: before, and where the form differs from what the page showed."""
    choices = dict(job.choices)
    changed = {
        name: value.strip()
        for name, value in form.items()
        if f"was:{name}" in form and value.strip() != form[f"was:{name}"]
    }
    gone: set[str] = set()
    if {"robot", "robot_name", "cell"} & changed.keys():
        gone |= {*_OF_ROBOT}
    if {"robot", "robot_name", "table"} & changed.keys():
        gone |= {*_OF_TABLE, *(name for name in choices if name.startswith("column:"))}
    if "points" in changed:
        gone |= {"points_unit"}
    choices = {name: value for name, value in choices.items() if name not in gone}
    return choices | {name: value for name, value in changed.items() if name not in gone}
