"""``--plugin``, installed plugins and those of a cell file, through the real program."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.plugin_files import CELL, SOURCE, registries_kept, write_distribution, write_plugin

#: A call that needs the cell's plugin, with its table.
CALIBRATE = "calibrate ur3 table.csv --cell cell.toml --solver twin --json result.json --force"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the plugin and the cell that names it."""
    folder = tmp_path_factory.mktemp("plugins")
    write_plugin(folder)
    (folder / "cell.toml").write_text(CELL)
    (folder / "manifest.csv").write_text("name,robot,data\nA,ur3,table.csv\nB,ur3,table.csv\n")
    return folder


@pytest.fixture
def words(call, folder):
    """A function that makes a call in this process, and takes what it registers out again."""

    def within(text: str, code: int = 0) -> str:
        with registries_kept():
            done = call(folder, *text.split())
        assert done.code == code, done.err
        return done.out + done.err

    return within


@pytest.fixture
def table(words, folder) -> Iterator[None]:
    """The plugin's table and a result of it."""
    if not (folder / "result.json").exists():
        words("simulate ur3 --cell cell.toml --count 50 --seed 1 -o table.csv --quiet")
        words(CALIBRATE)


@pytest.mark.slow
@pytest.mark.usefixtures("table")
def test_verbs_take_a_family_a_kind_a_solver_and_a_format_of_a_plugin(words, folder):
    assert "edge_distance [mm]" in (folder / "table.csv").read_text()
    said = words(CALIBRATE)
    assert re.search(r"elbow_joint.sin2 +-?\d", said)
    assert "Solver 'twin': converged" in said
    evaluated = "evaluate ur3 table.csv --cell cell.toml --calibration result.json"
    assert "the robot with the non-geometric model of result.json" in words(evaluated)
    words("convert result.json --plugin my_plugin.py --to names -o names.txt --force")
    assert (folder / "names.txt").read_text().startswith("shoulder_pan_joint shoulder_lift_joint")
    assert "lift" in words("inspect ur3 --plugin my_plugin.py --base base --model shoulder")


@pytest.mark.usefixtures("table")
def test_a_result_names_its_plugin_and_is_not_read_without_it(words, folder):
    (plugin,) = json.loads((folder / "result.json").read_text())["plugins"]
    assert plugin.pop("sha256")
    assert plugin == {
        "name": "my_plugin.py",
        "families": ["ripple"],
        "kinds": ["edge"],
        "solvers": ["twin"],
        "models": [],
    }
    said = words("convert result.json --to dh -o rows.csv", code=1)
    assert said.startswith("calib: result.json: The ")
    assert said.endswith(
        "comes from the plugin 'my_plugin.py', which is not loaded. Load it with --plugin my_plugin.py, in Python "
        'with calib.plugins.load("my_plugin.py").\n'
    )
    words("convert result.json --to dh -o rows.csv --plugin my_plugin.py --plugin ./my_plugin.py")


@pytest.mark.usefixtures("table")
def test_what_is_wrong_is_one_line(words, folder):
    write_plugin(folder, "\n\nraise KeyError('x')", "broken.py")
    for text, said in (
        ("demo --plugin none.py", "calib: Plugin 'none.py': the file '"),
        (
            "demo --plugin broken.py",
            "calib: Plugin 'broken.py' cannot be loaded: KeyError: 'x' (line 3",
        ),
        ("demo --help --plugin broken.py", "calib: Plugin 'broken.py' cannot be loaded: KeyError"),
        ("calibrate ur3 table.csv --kind edge", "calib: There is no kind of measurement 'edge'"),
        ("inspect ur3 --model dh+ripple", "calib: 'dh+ripple' adds 'ripple'"),
        ("calibrate ur3 table.csv --solver tvin --plugin my_plugin.py", "(did you mean 'twin'?)"),
        ("fleet manifest.csv --out none --solver twin", "calib: There is no solver 'twin'"),
    ):
        printed = words(text, code=1)
        assert said in printed
        assert printed.count("\n") == 1
    assert "Traceback" in words("demo --plugin broken.py --debug", code=1)


@pytest.mark.slow
def test_the_help_lists_what_a_plugin_registers(run, folder):
    done = run(folder, "calibrate", "--help", "--plugin", "my_plugin.py")
    assert done.code == 0
    assert {"ripple", "edge", "twin", "shoulder"} <= set(re.findall(r"\w+", done.out))
    done = run(folder, "convert", "--plugin", "my_plugin.py", "--help")
    assert "names of the joints" in " ".join(done.out.split())


@pytest.mark.slow
def test_installed_plugins_are_loaded(program, tmp_path):
    write_distribution(tmp_path, "line_gauge_d")
    environment = os.environ | {
        "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    }

    def printed() -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*program, "inspect", "--help"],
            env=environment,
            cwd=tmp_path,
            capture_output=True,
            encoding="utf-8",
            check=False,
        )

    broken = printed()
    assert broken.returncode == 1
    assert broken.stderr.startswith("calib: Entry point 'edges' of the installed distribution")
    write_plugin(tmp_path, SOURCE, "line_gauge_d.py")
    assert "edge" in re.findall(r"\w+", printed().stdout)


@pytest.mark.slow
@pytest.mark.usefixtures("table")
def test_a_fleet_in_processes_has_the_plugins_and_depends_on_their_contents(run, folder):
    words = "fleet manifest.csv --cell cell.toml --out fleet --no-reports --solver twin --workers 2"
    fleet = words.split()
    assert "2 of 2 robots calibrated" in run(folder, *fleet).out
    written = json.loads((folder / "fleet" / "A" / "result.json").read_text())
    assert written["plugins"] == json.loads((folder / "result.json").read_text())["plugins"]
    assert "2 of them by an earlier run" in " ".join(run(folder, *fleet).out.split())
    try:
        write_plugin(folder, SOURCE + "\n")
        assert "earlier run" not in " ".join(run(folder, *fleet).out.split())
    finally:
        write_plugin(folder)


@pytest.mark.slow
@pytest.mark.usefixtures("table")
def test_bootstraps_in_processes_have_the_plugins(run, folder):
    sampled = []
    for workers in ("1", "2"):
        bootstrap = (
            "calibrate ur3 table.csv --cell cell.toml --model zeros --solver twin --no-validate --bootstrap 40 "
            f"--json intervals.json --force --workers {workers}"
        )
        done = run(folder, *bootstrap.split())
        assert done.code == 0, done.err
        sampled.append(json.loads((folder / "intervals.json").read_text())["bootstrap"])
    assert sampled[0] == sampled[1]


@pytest.mark.slow
@pytest.mark.usefixtures("table")
def test_poses_are_planned_for_a_kind_of_a_plugin(run, folder):
    plan = "plan ur3 --cell cell.toml --count 24 --validation 0 --candidates 300 --no-collisions -o plan.csv"
    done = run(folder, *plan.split())
    assert done.code == 0, done.err
    assert "edge_distance" in (folder / "plan.csv").read_text()
