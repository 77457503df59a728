"""The exit statuses; and what every command makes of a result that is not to be used, with and without ``--accept``."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from calib.cli.exit_status import ExitStatus
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Verdict
from calib.result.calibrate import calibrate
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.simulate.scenario import Scenario
from tests.cli_fixtures import factory
from tests.parts import with_part
from tests.places import ROOT
from tests.verbs.fleet.arms import CELL

DOC = ROOT / "docs" / "command-line.md"
ARM = ("--base", "base", "--tip", "tool0")
MODEL = (*ARM, "--target", "-70 70 22.5 mm", "--model", "zeros")
FIT = ("calibrate", "robot.urdf", "right.csv", *MODEL)
PROGRAM = ("compensate", "robot.urdf", "right.csv", "--columns", "x=-", "--columns", "y=-")


@dataclass(frozen=True)
class Row:
    """A command, and the files that it makes in spite of the verdict, and only if the verdict is accepted."""

    words: tuple[str, ...]
    always: tuple[str, ...] = ()
    accepted: tuple[str, ...] = ()


#: Everything that a robot or its controller could be given.
FOR_ROBOTS = {
    "calibrate": Row((*FIT, "-o", "c.urdf", "--json", "r.json"), ("r.json",), ("c.urdf",)),
    "calibrate, a wrong set-up, not validated": Row(
        ("calibrate", "robot.urdf", "right.csv", "--tip", "tool0", "--no-validate", "-o", "c.urdf"),
        (),
        ("c.urdf",),
    ),
    **{
        f"convert to {name}": Row(("convert", "bad.json", "--to", name, "-o", file), (), (file,))
        for name, file in (
            ("urdf", "a.urdf"),
            ("origins", "a.yaml"),
            ("dh", "a.csv"),
            ("modified-dh", "a.csv"),
            ("hayati", "a.json"),
            ("ur-conf", "a.conf"),
        )
    },
    "convert to ur-yaml": Row(
        ("convert", "bad.json", "--hash-from", "calibration.conf", "--to", "ur-yaml", "-o", "k.yaml"),
        (),
        ("k.yaml",),
    ),
    "convert its URDF": Row(
        ("convert", "bad.urdf", *ARM, "--to", "origins", "-o", "a.yaml"), (), ("a.yaml",)
    ),
    "compensate": Row(
        (*PROGRAM, "--columns", "z=-", "--calibration", "bad.json", "-o", "p.csv"), (), ("p.csv",)
    ),
    "compensate by its URDF": Row(
        (*PROGRAM, "--columns", "z=-", "--corrected", "bad.urdf", *ARM, "-o", "p.csv"), (), ("p.csv",)
    ),
    "fleet": Row(
        ("fleet", "manifest.csv", "--out", "r", *MODEL, "--no-reports", "--workers", "1"),
        tuple(f"r/{n}" for n in ("fleet.csv", "fleet.json", "SN-1/made.json", "SN-1/result.json",
                                 "SN-1/summary.txt")),
        ("r/SN-1/corrected.urdf",),
    ),
}  # fmt: skip

#: What reaches no robot, and is done whatever the verdict says.
FOR_PEOPLE = {
    "calibrate without -o": Row((*FIT, "--json", "r.json"), ("r.json",)),
    "evaluate": Row(
        ("evaluate", "robot.urdf", "right.csv", "--calibration", "bad.json", "--json", "e.json"),
        ("e.json",),
    ),
    "compare": Row(("compare", "bad.json", "bad.json", "--json", "d.json"), ("d.json",)),
    "view": Row(
        ("view", "robot.urdf", "--calibration", "bad.json", "-o", "v.html"), ("v.html",)
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory, ur3: Robot) -> Path:
    """A robot that its URDF describes to the noise: there is nothing to gain, and the verdict is ``do not use``."""
    folder = tmp_path_factory.mktemp("stock")
    (folder / "robot.urdf").write_bytes(ur3.urdf.data)
    scenario = Scenario(ur3, cell=CELL, model="frames")
    made = scenario.draw(0).measure(scenario.random_poses(14, 0), 0)
    made.measurements.write(folder / "right.csv")
    result = calibrate(ur3, made.measurements, cell=CELL)
    result.write_json(folder / "bad.json")
    result.write_urdf(folder / "bad.urdf", accept=True)
    factory(folder)
    rows = "name,robot,data\nSN-1,robot.urdf,right.csv\n"
    (folder / "manifest.csv").write_text(rows, encoding="utf-8")
    return folder


@pytest.fixture
def folder(stock: Path, tmp_path: Path) -> Path:
    """A copy of it to work in."""
    shutil.copytree(stock, tmp_path, dirs_exist_ok=True)
    return tmp_path


def made_in(folder: Path, stock: Path) -> set[str]:
    """The files of a folder that it did not begin with."""
    there = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    return there - {path.name for path in stock.iterdir()}


@pytest.mark.parametrize("name", FOR_ROBOTS)
def test_nothing_for_a_robot_is_written_unless_it_is_accepted(call, folder, stock, name: str):
    row = FOR_ROBOTS[name]
    refused = call(folder, *row.words)
    assert refused.code == ExitStatus.NOT_ACCEPTED
    assert made_in(folder, stock) == set(row.always)
    assert "do not use" in refused.err
    assert "--accept" in refused.err
    assert refused.err.count("\n") == 1
    again = [] if name == "fleet" else ["--force"]
    done = call(folder, *row.words, "--accept", *again, "--quiet")
    assert (done.code, done.out) == (ExitStatus.DONE, "")
    assert made_in(folder, stock) == {*row.always, *row.accepted}
    assert "do not use" in done.err
    for path in (folder / file for file in row.accepted if file.endswith(".urdf")):
        assert Urdf.read(path).verdict.startswith("do not use (")


@pytest.mark.parametrize("name", FOR_PEOPLE)
def test_what_reaches_no_robot_is_done_all_the_same(call, folder, stock, name: str):
    row = FOR_PEOPLE[name]
    done = call(folder, *row.words)
    assert (done.code, done.err) == (ExitStatus.DONE, "")
    assert made_in(folder, stock) == set(row.always)


@pytest.mark.slow
def test_report_view_and_figures_are_written_of_it(call, folder):
    words = ("-o", "c.urdf", "--report", "r.html", "--view", "v.html", "--figures", "f")
    done = call(folder, *FIT, *words)
    assert done.code == ExitStatus.NOT_ACCEPTED
    assert [(folder / name).exists() for name in ("r.html", "v.html", "f", "c.urdf")] == [
        True,
        True,
        True,
        False,
    ]
    # The picture calls neither an unchanged robot nor one without a URDF corrected.
    page = (folder / "v.html").read_bytes()
    assert b"<span>unchanged" in page
    assert b"<span>the corrected URDF" not in page
    changed = ("calibrate", "robot.urdf", "right.csv", "--tip", "tool0", "--no-validate")
    for words, label in (((), b"as fitted"), (("--accept",), b"the corrected URDF, accepted")):
        call(folder, *changed, "-o", "c.urdf", "--view", "v.html", *words, "--force")
        assert b"<span>" + label in (folder / "v.html").read_bytes()


def test_an_earlier_urdf_is_left_and_said_to_be_one(call, folder):
    (folder / "c.urdf").write_text("an earlier one")
    done = call(folder, *FIT, "-o", "c.urdf", "--force")
    assert done.code == ExitStatus.NOT_ACCEPTED
    assert done.err.endswith("is an earlier one.\n")
    assert (folder / "c.urdf").read_text() == "an earlier one"


def test_the_accepted_urdf_differs_by_its_comments_and_origins_alone(call, folder):
    words = FOR_ROBOTS["calibrate, a wrong set-up, not validated"].words
    assert call(folder, *words, "--accept").code == ExitStatus.DONE
    before, after = ((folder / name).read_bytes() for name in ("robot.urdf", "c.urdf"))
    run, verdict, *others = re.findall(rb"<!-- calib (?:run|verdict): .*? -->\n", after)
    assert not others
    without = after.replace(run + verdict, b"")
    changed = [a for b, a in zip(before.splitlines(), without.splitlines(), strict=True) if a != b]
    assert changed
    assert all(b"<origin" in line for line in changed)


def test_the_non_geometric_model_has_a_verdict_of_its_own(call, folder, ur3: Robot):
    """`compensate` obeys the verdict on the model that its commands are made by."""
    table = Measurements.read(folder / "right.csv", ur3.joint_names)
    result = calibrate(ur3, table, cell=replace(CELL, model="zeros+gain"))
    assert result.non_geometric is not None
    assert result.verdict is not None
    fine = Verdict("use", ())
    words = (*PROGRAM, "--columns", "z=-", "--calibration", "both.json")
    non_geometric = replace(result.non_geometric, verdict=fine)
    replace(result, non_geometric=non_geometric).write_json(folder / "both.json")
    assert call(folder, *words).code == ExitStatus.DONE
    assert call(folder, *words, "--geometry").code == ExitStatus.NOT_ACCEPTED
    non_geometric = replace(result.non_geometric, verdict=result.verdict)
    replace(with_part(result, "geometry", verdict=fine), non_geometric=non_geometric).write_json(
        folder / "both.json", overwrite=True
    )
    refused = call(folder, *words)
    assert refused.code == ExitStatus.NOT_ACCEPTED
    assert "--geometry" in refused.err
    assert call(folder, *words, "--geometry").code == ExitStatus.DONE


def test_the_document_has_every_exit_status():
    table = re.findall(r"^\| (\d+) \| ", DOC.read_text(encoding="utf-8"), re.MULTILINE)
    assert [int(status) for status in table] == [int(status) for status in ExitStatus]


def test_the_exit_statuses_are_those_of_the_document(call, folder):
    assert call(folder, "inspect", "robot.urdf", *ARM).code == ExitStatus.DONE
    assert call(folder, "inspect", "none.urdf").code == ExitStatus.REFUSED
    assert call(folder, "inspect", "--none").code == ExitStatus.WRONG_CALL
    words = ("evaluate", "robot.urdf", "right.csv", "--calibration", "bad.json", "--tolerance")
    assert call(folder, *words, "1 um").code == ExitStatus.NOT_ACCEPTED
