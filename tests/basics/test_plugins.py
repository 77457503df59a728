"""Plugins: what they register, their errors, installed ones, and those that workers load."""

from __future__ import annotations

import importlib
import json
import pickle
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import FrozenInstanceError, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

import calib
import calib.basics.plugins as plugins
from calib.basics.jobs import run
from calib.data import kinds
from calib.data.cell import Cell
from calib.errors import CalibError, PluginError
from calib.fit.estimate.task import Task
from calib.model.families import FAMILIES
from calib.model.parameter_sets import MODELS, split_name
from calib.numerics.solvers import SOLVERS
from calib.result.calibration_file import read_result, write_result
from calib.robot.robot import Robot
from calib.verbs.convert.convert import FORMATS, chosen_format
from calib.verbs.fleet.job import FleetJob, FleetOptions
from calib.verbs.measure.devices.controllers import CONTROLLERS
from calib.verbs.measure.devices.readers import READERS
from calib.verbs.simulate.scenario import Scenario
from tests.parts import of_an_earlier_version
from tests.places import ROOT
from tests.plugin_files import CELL, registries_kept, write_distribution, write_plugin

#: One solver.
SOLVER = """
from calib.numerics.solvers import levenberg_marquardt, register
register("one", levenberg_marquardt)
"""


@pytest.fixture(autouse=True)
def _registries() -> Iterator[None]:
    with registries_kept():
        yield


def test_a_plugin_extends_every_registry_and_is_loaded_once(tmp_path, monkeypatch):
    plugin = plugins.load(write_plugin(tmp_path))
    assert plugin.source == str(tmp_path / "my_plugin.py")
    assert (plugin.families, plugin.kinds, plugin.solvers) == (("ripple",), ("edge",), ("twin",))
    assert (plugin.models, plugin.formats) == (("shoulder",), ("names",))
    assert (plugin.readers, plugin.controllers) == (("gauge",), ("statue",))
    registries = (FAMILIES, kinds.names(), SOLVERS, MODELS, FORMATS, READERS, CONTROLLERS)
    names = ("ripple", "edge", "twin", "shoulder", "names", "gauge", "statue")
    for name, registry in zip(names, registries, strict=True):
        assert name in registry
    monkeypatch.chdir(tmp_path)
    assert plugins.load("my_plugin.py") is plugin
    assert plugins.loaded()[-1] is plugin
    with pytest.raises(FrozenInstanceError):
        plugin.name = "other"
    assert not list(tmp_path.rglob("*.pyc"))


def test_a_module_is_a_plugin_too(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    package = tmp_path / "line_gauge_a"
    package.mkdir()
    write_plugin(package, "from . import solver", "__init__.py")
    write_plugin(package, SOLVER, "solver.py")
    plugin = plugins.load("line_gauge_a")
    assert (plugin.name, plugin.source, plugin.solvers) == (
        "line_gauge_a",
        "line_gauge_a",
        ("one",),
    )
    assert plugins.load("line_gauge_a") is plugin


def test_an_error_of_a_module_names_its_line(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    write_plugin(tmp_path, "x = 1\n\nx / 0", "line_gauge_e.py")
    with pytest.raises(PluginError, match=r"division by zero \(line 3 of line_gauge_e\.py\)"):
        plugins.load("line_gauge_e")


def test_what_a_plugin_loads_itself_is_not_its_own(tmp_path):
    inner = write_plugin(tmp_path, SOLVER, "inner.py")
    outer = write_plugin(
        tmp_path,
        f"import calib\ncalib.plugins.load({str(inner)!r})\n" + SOLVER.replace('"one"', '"two"'),
        "outer.py",
    )
    assert plugins.load(outer).solvers == ("two",)
    assert [plugin.solvers for plugin in plugins.loaded()[-2:]] == [("one",), ("two",)]


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("x = 1\ny = 1 / 0", "ZeroDivisionError: division by zero (line 2 of bad.py)"),
        ("def f():\n    return 1 / 0\nf()", "division by zero (line 2 of bad.py)"),
        ("x = (", "SyntaxError: '(' was never closed (line 1 of bad.py)"),
        (
            "import no_such_module",
            "ModuleNotFoundError: No module named 'no_such_module' (line 1 of",
        ),
        ("import sys\nsys.exit(3)", "SystemExit: 3 (line 2 of bad.py)"),
        ("raise ValueError('two\\nlines')", "ValueError: two lines (line 1 of bad.py)"),
        (
            "from calib.model.families import *\nregister(FAMILIES['gain'])",
            "The family 'gain' has a name that is taken; give it one other than 'length'",
        ),
        (
            "from calib.data import kinds\nkinds.register(kinds.get('plane'))",
            "There is a kind 'plane' already; rename yours (line 2 of",
        ),
        (
            "from calib.numerics.solvers import *\nregister('paper', SOLVERS['lm'])",
            "The solver 'paper' needs a name other than 'lm', 'scipy', 'paper' (line 2 of bad.py)",
        ),
        (
            "from calib.model.parameter_sets import *\nregister('dh', None)",
            "The parameter set 'dh' needs a name without '+', other than 'paper', 'dh'",
        ),
        (
            "from calib.model.parameter_sets import *\nregister('a+b', None)",
            "The parameter set 'a+b' needs a name without '+'",
        ),
        (
            "from calib.verbs.convert.convert import *\nregister('dh', None)",
            "The format 'dh' needs a name other than 'urdf'",
        ),
        (
            "from calib.numerics.solvers import SOLVERS\nSOLVERS['lm'] = None",
            "Plugin '{path}' replaces the solver 'lm'. Give yours a name of its own.",
        ),
    ],
)
def test_an_error_names_the_plugin_the_cause_and_the_line(tmp_path, source, said):
    path = write_plugin(tmp_path, source, "bad.py")
    with pytest.raises(PluginError) as caught:
        plugins.load(path)
    text = str(caught.value)
    assert text.startswith(f"Plugin '{path}'")
    assert said.format(path=path) in text
    assert "\n" not in text


def test_of_a_plugin_that_fails_nothing_stays(tmp_path):
    path = write_plugin(tmp_path, SOLVER + "1 / 0")
    with pytest.raises(PluginError, match="line 4"):
        plugins.load(path)
    assert "one" not in SOLVERS
    write_plugin(tmp_path, SOLVER)
    assert plugins.load(path).solvers == ("one",)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("none.py", "Plugin 'none.py': the file '{folder}/none.py' does not exist; check the name"),
        ("no_plugin", "Plugin 'no_plugin': there is no module of this name. Give a Python file"),
        ("email.no_plugin", "Plugin 'email.no_plugin': there is no module of this name"),
        ("my_plugin", "no module of this name (did you mean the file 'my_plugin.py'?)"),
        ("folder.py", "is a folder; name the file inside it."),
        ("./my_plugin", "Plugin './my_plugin' is a path; the name of a file ends in .py."),
    ],
)
def test_a_plugin_that_does_not_exist(tmp_path, monkeypatch, name, said):
    write_plugin(tmp_path)
    (tmp_path / "folder.py").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PluginError) as caught:
        plugins.load(name)
    assert said.format(folder=tmp_path) in str(caught.value)


def test_installed_plugins_are_entry_points(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    write_distribution(tmp_path, "line_gauge_b")
    write_plugin(tmp_path, SOLVER, "line_gauge_b.py")
    assert [plugin.solvers for plugin in plugins.load_installed()] == [("one",)]
    assert plugins.load_installed() == plugins.loaded()[-1:]


def test_a_broken_entry_point_is_named(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    write_distribution(tmp_path, "line_gauge_c")
    with pytest.raises(PluginError) as caught:
        plugins.load_installed()
    assert str(caught.value).startswith(
        "Entry point 'edges' of the installed distribution 'line-gauge': Plugin 'line_gauge_c': there is no module"
    )


def test_a_plugin_that_registers_nothing_is_refused(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(PluginError, match=r"'.*empty\.py' registers nothing"):
        plugins.load(write_plugin(tmp_path, "x = 1\n", "empty.py"))
    write_plugin(tmp_path, SOLVER, "line_gauge_f.py")
    importlib.import_module("line_gauge_f")
    with pytest.raises(PluginError, match="'line_gauge_f' registers nothing"):
        plugins.load("line_gauge_f")


def test_an_entry_point_names_a_module_alone(tmp_path, monkeypatch):
    """A function behind it would not be called."""
    monkeypatch.syspath_prepend(str(tmp_path))
    write_distribution(tmp_path, "line_gauge_e:setup")
    write_plugin(tmp_path, SOLVER, "line_gauge_e.py")
    with pytest.raises(PluginError, match="'setup' in the module 'line_gauge_e'"):
        plugins.load_installed()


def test_a_cell_file_loads_its_plugins_before_its_other_keys(tmp_path):
    write_plugin(tmp_path)
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    cell = Cell.read(path)
    assert (cell.kind, cell.priors.of("ripple")) == ("edge", 2e-3)
    assert plugins.loaded()[-1].name == str(tmp_path / "my_plugin.py")
    for text, said in (
        ('plugins = "my_plugin.py"', "'plugins' is 'my_plugin.py'; it must be a list of names"),
        ("plugins = [1]", "entry 1 of 'plugins' is 1"),
        ('plugins = ["none.py"]', "cell.toml: Plugin"),
    ):
        path.write_text(text)
        with pytest.raises(CalibError) as caught:
            Cell.read(path)
        assert said in str(caught.value)


@pytest.mark.parametrize(
    ("use", "said"),
    [
        (lambda: kinds.get("edge"), "no kind of measurement 'edge'"),
        (lambda: calib.families.family_of("ripple"), "no family of errors 'ripple'"),
        (lambda: Task(None, Cell(), None, "dh", solver="twin").check_solver(), "no solver 'twin'"),
        (lambda: Cell(kind="edge"), "no kind of measurement 'edge'"),
        (lambda: split_name("shoulder"), "no parameter set 'shoulder'"),
        (lambda: split_name("dh+ripple"), "'dh+ripple' adds 'ripple' to the set 'dh'"),
        (lambda: chosen_format(Path("a.txt"), "names", "robot"), "no format 'names'"),
    ],
)
def test_a_name_that_is_not_registered_may_come_from_a_plugin(use, said):
    with pytest.raises(CalibError) as caught:
        use()
    assert said in str(caught.value)
    assert str(caught.value).endswith('--plugin FILE, in Python with calib.plugins.load("FILE").')


@pytest.fixture(scope="module")
def fitted(ur3: Robot, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Path]]:
    """A result of a kind, a family and a solver of a plugin, and the plugin's file."""
    folder = tmp_path_factory.mktemp("fitted")
    path = write_plugin(folder)
    (folder / "cell.toml").write_text(CELL)
    with registries_kept():
        cell = Cell.read(folder / "cell.toml")
        scenario = Scenario(ur3, cell=cell, model="zeros+ripple")
        rows = scenario.draw(seed=1).measure(scenario.random_poses(50, seed=1), seed=1)
        result = calib.calibrate(ur3, rows.measurements, cell=cell, solver="twin", validate=False)
        write_plugin(folder, SOLVER, "unused.py")
        plugins.load(folder / "unused.py")
        write_result(result, folder / "result.json")
    return folder / "result.json", path


def test_a_result_names_the_plugins_that_it_needs(fitted):
    result, plugin = fitted
    with pytest.raises(PluginError) as caught:
        read_result(result)
    assert str(caught.value) in {
        f"{result}: The {what} comes from the plugin '{plugin}', which is not loaded. Load it with --plugin {plugin}, "
        f'in Python with calib.plugins.load("{plugin}").'
        for what in ("kind of measurement 'edge'", "family of errors 'ripple'")
    }
    plugins.load(plugin)
    again = read_result(result)
    used = {
        "families": {"ripple", "zero"},
        "kinds": {"edge"},
        "solvers": {"twin"},
        "models": {"zeros"},
    }
    (table,) = plugins.plugin_tables(used)
    assert table["name"] == str(plugin)
    assert [table[key] for key in used] == [["ripple"], ["edge"], ["twin"], []]
    assert again.method.solver == "twin"


def test_without_a_plugin_that_is_known_the_name_is_said(fitted, tmp_path):
    text = (
        fitted[0]
        .read_text()
        .replace('"name": "' + str(fitted[1]), '"name": "')
        .replace('"edge"', '"wire"')
    )
    (tmp_path / "result.json").write_text(json.dumps(of_an_earlier_version(json.loads(text))))
    plugins.load(fitted[1])
    with pytest.raises(PluginError, match=r"result\.json: There is no kind of measurement 'wire'"):
        read_result(tmp_path / "result.json")


def test_workers_load_the_same_plugins(tmp_path):
    first = plugins.load(write_plugin(tmp_path, SOLVER, "first.py"))
    second = plugins.load(write_plugin(tmp_path, SOLVER.replace("one", "two"), "second.py"))
    plugins.load_sent([first, second])
    sent = pickle.loads(pickle.dumps([first]))
    plugins.load_sent(sent)
    # In whatever order: kinds and families go by their names.
    plugins.load_sent([second])
    with pytest.raises(PluginError, match="has other contents of the plugin"):
        plugins.load_sent([replace(first, sha256="0")])
    with pytest.raises(
        PluginError, match=r"A worker on '.*': Plugin 'third': the file '.*third.py'"
    ):
        plugins.load_sent(
            [first, second, replace(first, name="third", source=f"{tmp_path}/third.py")]
        )


@pytest.mark.slow
def test_jobs_in_processes_have_the_plugins(tmp_path):
    path = write_plugin(tmp_path)
    plugins.load(path)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        # The kind has functions of the plugin, which a worker finds once it has loaded it.
        edge = kinds.get("edge")
        assert dict(run(_same_reading, edge, range(3), executor)) == dict.fromkeys(range(3), 5.0)
        path.unlink()
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor,
        pytest.raises(
            PluginError, match=r"A worker on .* the file '.*my_plugin.py' does not exist"
        ),
    ):
        list(run(_same_reading, edge, range(3), executor))


def _same_reading(kind: kinds.Kind, _item: int) -> float:
    """The reading of a target at (3, 4, 0) m."""
    T = np.eye(4)[None].copy()
    T[0, :2, 3] = 3.0, 4.0
    assert kind.measure is not None
    return float(kind.measure(T)[0, 0])


def test_the_fingerprint_of_a_job_depends_on_the_contents_of_plugins(tmp_path, ur3, paper_table):
    job = FleetJob("a", ur3, paper_table, Cell())
    prints = [job.fingerprint(FleetOptions())]
    for source in (SOLVER, SOLVER + "\n", SOLVER):
        path = write_plugin(tmp_path, source)
        with registries_kept():
            plugins.load(path)
            prints.append(job.fingerprint(FleetOptions()))
    assert len(set(prints)) == 3
    assert prints[1] == prints[3]


def test_to_load_no_plugin_imports_no_registry():
    code = (
        "import sys, calib; calib.plugins.load_installed(); calib.plugins.loaded(); "
        "print(sorted({'numpy', 'calib.model'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.strip() == "[]"
