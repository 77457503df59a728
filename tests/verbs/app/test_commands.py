"""The command that a page shows is the one that makes its result, to the last digit."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

from calib.basics.records import parse_toml
from calib.data.cell import Cell
from calib.errors import CalibError
from calib.verbs.app.commands import calibration_commands, cell_text
from calib.verbs.app.guesses import look
from calib.verbs.app.job import Job, command_text
from tests.cli_fixtures import calib
from tests.verbs.app.sent import JOINTS, TABLE, URDF, job_of, joints_and_points, with_header
from tests.verbs.app.served import Client

FILES = {"ur3.urdf": URDF, "data.csv": TABLE.encode()}


def test_what_is_chosen_stands_in_the_cell_file(tmp_path: Path):
    chosen = {
        "serial": 'SN "1"\\',
        "target": "70 -70 22.5 mm",
        "model": "dh",
        "kind": "point",
        "instrument": "stereo",
    }
    job = job_of(tmp_path, FILES, **chosen)
    looked = look(job)
    text = cell_text(looked)
    assert parse_toml(text)["record"]["robot_serial"] == 'SN "1"\\'
    (tmp_path / "cell.toml").write_text(text)
    cell = Cell.read(tmp_path / "cell.toml")
    assert (cell.base, cell.tip, cell.kind, cell.model) == ("base", "tool0", "point", "dh")
    assert (cell.instrument, cell.estimate_target) == ("stereo", True)
    assert cell.target is not None
    assert [round(1e3 * value, 9) for value in cell.target] == [70.0, -70.0, 22.5]
    (words,) = calibration_commands(job, looked)
    assert words[:5] == ("calibrate", "ur3.urdf", "data.csv", "--cell", "cell.toml")


def test_a_target_that_is_none_is_refused_in_words(tmp_path: Path):
    with pytest.raises(CalibError, match="target"):
        cell_text(look(job_of(tmp_path, FILES, target="here")))


def test_columns_units_and_lists_stand_in_the_command(tmp_path: Path):
    labels = [f"q{i}" for i in range(6)]
    job = job_of(tmp_path, {**FILES, "data.csv": with_header(*labels, "X", "Y", "Z")})
    (words,) = calibration_commands(job, look(job))
    options = " ".join(words)
    assert "--joint-unit deg" in options
    assert f"--columns q0={JOINTS[0]} --columns" in options
    assert "--columns X=x [mm]" in options
    table, points = joints_and_points()
    job = job_of(tmp_path, {"ur3.urdf": URDF, "joints.csv": table, "points.txt": points})
    (words,) = calibration_commands(job, look(job))
    assert "--points points.txt --points-unit mm" in " ".join(words)


def test_a_cell_file_that_was_sent_is_named_and_choices_go_over_it(tmp_path: Path):
    files = {**FILES, "own.toml": b'base = "base"\nframe = "known"\n'}
    job = job_of(tmp_path, files, tip="wrist_3_link", frame="estimate")
    (words,) = calibration_commands(job, look(job))
    options = " ".join(words)
    assert "--cell own.toml" in options
    assert "--tip wrist_3_link" in options
    assert "--frame estimate" in options
    assert "--base" not in options


def test_a_command_is_typed_as_it_is_run():
    words = ("calibrate", "a b.urdf", "t.xlsx#Day 1", "--columns", "J1=joint [deg]")
    assert tuple(shlex.split(command_text(words))) == ("calib", *words)


def numbers_of(path: Path) -> object:
    """All of a result file but what differs from run to run: when, how long, and the files' names."""
    table = json.loads(path.read_bytes())
    for name in ("time", "checksums", "outputs"):
        table.pop(name, None)

    def without_seconds(value: object) -> object:
        if isinstance(value, dict):
            return {
                k: without_seconds(v)
                for k, v in value.items()
                if "seconds" not in k and not k.endswith("_s")
            }
        return [without_seconds(one) for one in value] if isinstance(value, list) else value

    return without_seconds(table)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["table", "names and list"])
def test_the_command_makes_the_same_numbers_to_the_last_digit(
    client: Client, tmp_path: Path, form: str
):
    files = dict(FILES)
    if form != "table":
        table, points = joints_and_points()
        files = {
            "ur3.urdf": URDF,
            "joints.csv": table.replace(b"shoulder_pan_joint [deg]", b"J1"),
            "p.txt": points,
        }
    job = client.open(*files.items())
    client.form(f"{job}/choose", {"action": "calibrate", "was:serial": "", "serial": "SN-1"})
    assert client.wait(job) == "done"
    page = client.get(job).text
    folder = client.folder / job.rpartition("/")[2]
    (line,) = Job.read(folder).commands
    shown = command_text(line)
    assert all(f'<span class="word">{word}</span>' in page for word in shown.split(" "))

    by_hand = tmp_path / "by hand"
    by_hand.mkdir()
    for name, content in files.items():
        (by_hand / name).write_bytes(content)
    (by_hand / "cell.toml").write_bytes(client.get(f"{job}/files/cell.toml").body)
    done = calib(by_hand, *shlex.split(shown)[1:])
    assert done.code == 0, done.err
    assert numbers_of(by_hand / "result.json") == numbers_of(folder / "result.json")
    assert (by_hand / "corrected.urdf").read_bytes() == client.get(
        f"{job}/files/corrected.urdf"
    ).body
