"""README and docs say what is so: their figures by the commands that make them, their code by running it."""

from __future__ import annotations

import importlib
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.places import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


@pytest.fixture(scope="module")
def demo_output(tmp_path_factory) -> str:
    out = tmp_path_factory.mktemp("demo") / "results"
    program = Path(sys.executable).with_name("calib")
    done = subprocess.run(
        [program, "demo", "--out", out], capture_output=True, text=True, check=True
    )
    return done.stdout


def test_every_line_of_the_printed_demo_is_printed(demo_output):
    (shown,) = blocks("text")
    lines = [line for line in shown.splitlines() if line]
    assert len(lines) > 15
    printed = demo_output.splitlines()
    for line in lines:
        assert line in printed


def test_the_python_example_runs(tmp_path, monkeypatch, capsys):
    (code,) = blocks("python")
    assert len([line for line in code.splitlines() if line and not line.startswith("import")]) == 5
    (tmp_path / "urdf").symlink_to(ROOT / "urdf")
    (tmp_path / "calib").mkdir()
    (tmp_path / "calib" / "example").symlink_to(ROOT / "calib" / "example")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    assert "Verdict: use" in capsys.readouterr().out
    assert (tmp_path / "ur3_corrected.urdf").is_file()


def test_the_example_table_reads(tmp_path):
    from calib.data.measurements import Measurements

    (table,) = blocks("csv")
    path = tmp_path / "data.csv"
    path.write_text("\n".join(line.strip() for line in table.splitlines()), encoding="utf-8")
    data = Measurements.read(path, ["joint_1", "joint_2", "joint_3"])
    assert data.sets == ("estimate", "validate")


def test_the_two_commands_stand_at_the_top():
    first = blocks("sh")[0]
    assert re.findall(r"^make \w+", first, flags=re.MULTILINE) == ["make demo", "make test"]
    assert README.index("make demo") < 600
    targets = (ROOT / "Makefile").read_text()
    for name in ("demo", "test", "lint", "docs"):
        assert re.search(rf"^{name}:", targets, flags=re.MULTILINE)
    assert [
        line for line in (ROOT / ".ci" / "run").read_text().splitlines() if line.startswith("make")
    ] == [
        "make lint",
        "make docs",
        "make demo",
        "make test",
    ]


@pytest.mark.slow
def test_the_tables_of_the_paper_page_are_those_of_its_script():
    done = subprocess.run(
        [sys.executable, ROOT / "scripts" / "paper_study.py"],
        capture_output=True,
        text=True,
        check=True,
    )
    page = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8").splitlines()
    rows = [line for line in done.stdout.splitlines() if line.startswith("|")]
    assert len(rows) == 24
    for row in rows:
        assert row in page


@pytest.fixture
def planning_study(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    return importlib.import_module("planning_study")


@pytest.mark.slow
def test_what_poses_are_worth_is_what_the_planning_study_prints(planning_study):
    printed = dict(planning_study.worth_rows(20_000))
    paper, random, planned, _ = printed.values()
    said = re.search(
        r"is ([\d.]+) after the paper's 30 poses, ([\d.]+) after 30 random ones and ([\d.]+) after 30 that",
        README.replace("\n   ", " "),
    )
    assert said
    assert said.groups() == (paper, random, planned)
    page = (ROOT / "docs" / "planning.md").read_text(encoding="utf-8")
    table = dict(re.findall(r"^\| ([^|]+?) \| ([\d.]+) \|$", page, flags=re.MULTILINE))
    assert list(table.values())[:4] == list(printed.values())


@pytest.mark.slow
@pytest.mark.parametrize("page", ["planning.md", "simulation.md"])
def test_the_python_of_the_measuring_stage_runs(page, capsys):
    import calib

    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    robot = calib.Robot.load(ROOT / "urdf" / "ur3.urdf", base="base", tip="tool0")
    names = {"calib": calib, "robot": robot}
    for code in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        exec(compile(code, page, "exec"), names)
    assert capsys.readouterr().out
    if page == "planning.md":
        assert names["five"].forecast.rms < names["planned"].forecast.rms
        # Over the joint ranges as the plan's, but for the margin and other poses.
        assert names["foreseen"].rms == pytest.approx(names["planned"].forecast.rms, rel=0.05)
    else:
        assert names["error"].shape == (1000,)
        assert np.sqrt(np.mean(names["error"] ** 2)) < 1e-4


@pytest.mark.slow
def test_what_five_more_poses_are_worth_is_so():
    import calib

    page = (ROOT / "docs" / "planning.md").read_text(encoding="utf-8")
    said = re.search(
        r"from ([\d.]+) to ([\d.]+) mm rms; five random ones would leave ([\d.]+) mm\.",
        " ".join(page.split()),
    )
    robot = calib.Robot.load(ROOT / "urdf" / "ur3.urdf", base="base", tip="tool0")
    table = calib.Measurements.read(ROOT / "calib" / "example" / "ur3_leica.csv", robot.joint_names)
    planned = calib.plan(
        robot,
        calib.Cell(target=[-0.06997, 0.07020, 0.02252], sigma={"m": 1e-4}),
        calib.PlanRequest(5, 0, ladder=False),
        taken=table.joints_for(robot.joint_names)[table.estimation],
    )
    found = (planned.before, planned.forecast, planned.at_random)
    assert said
    # Another machine's rounding may choose another of two poses that are as good.
    assert [float(one) for one in said.groups()] == pytest.approx(
        [1e3 * one.rms for one in found if one is not None], rel=0.02
    )


@pytest.mark.slow
@pytest.mark.parametrize("page", ["workspace.md", "convert.md", "quick-start.md"])
def test_the_python_of_a_page_runs_on_files_of_its_names(page, tmp_path, monkeypatch):
    import calib
    from calib.robot.ranges import joint_ranges
    from calib.verbs.workspace.region import Density
    from calib.verbs.workspace.region_file import write_region
    from calib.verbs.workspace.region_rows import RegionView
    from calib.verbs.workspace.workspace import workspace_points

    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "urdf" / "ur3.urdf", "robot.urdf")
    shutil.copy(ROOT / "calib" / "example" / "ur3_leica.csv", "data.csv")
    cell = calib.Cell(base="base", tip="tool0", model="zeros")
    result = calib.calibrate("robot.urdf", "data.csv", cell=cell, validate=False)
    density = Density.of(workspace_points(result.nominal, count=2**12))
    ranges = joint_ranges(result.nominal)
    view = RegionView(result.nominal, np.zeros(3), ranges, density, density.region(), None)
    write_region(view, "region.json", 0)
    names = {"calib": calib, "result": result, "q": result.fit.measurements.joints}
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    for code in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        exec(compile(code, page, "exec"), names)


@pytest.mark.slow
def test_what_approaches_are_worth_is_what_the_planning_study_prints(planning_study):
    page = (ROOT / "docs" / "planning.md").read_text(encoding="utf-8")
    for row in planning_study.approach_rows(20_000):
        assert f"| {' | '.join(row)} |" in page
