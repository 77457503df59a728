"""The names that users may rely on, and what is said about them."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

import calib
import calib.basics.plugins as plugins
from calib.model.error_model import Parameter
from calib.numerics.solvers import Solution
from calib.program import app

CALIB = Path(calib.__file__).parent

#: A name that leaves this list breaks programs that use it.
NAMES = [
    "Acceptance",
    "Again",
    "Aim",
    "Board",
    "CalibError",
    "Calibration",
    "Camera",
    "Cell",
    "Certificate",
    "CheckResult",
    "ColumnOptions",
    "Commands",
    "Comparison",
    "DHRow",
    "Evaluation",
    "History",
    "Measurements",
    "Plan",
    "PlanRequest",
    "Program",
    "Region",
    "Robot",
    "RobotTrend",
    "Row",
    "Scenario",
    "Session",
    "TrackerNoise",
    "acceptance",
    "again",
    "bag",
    "base_frame",
    "bootstrap",
    "calibrate",
    "certificate",
    "check",
    "check_poses",
    "compare",
    "compensate",
    "convert",
    "detect",
    "evaluate",
    "fleet",
    "further_poses",
    "history",
    "inspect",
    "joints",
    "plan",
    "simulate",
    "trend",
    "view",
    "workspace",
]

#: Modules by which users extend calib, and where they are defined: those with a registry, and plugins.
MODULES = {
    "controllers": "calib.verbs.measure.devices.controllers",
    "families": "calib.model.families",
    "formats": "calib.verbs.convert.convert",
    "kinds": "calib.data.kinds",
    "models": "calib.model.parameter_sets",
    "plugins": "calib.basics.plugins",
    "readers": "calib.verbs.measure.devices.readers",
    "solvers": "calib.numerics.solvers",
}


def test_the_public_names():
    assert calib.__all__ == sorted([*NAMES, *MODULES])
    assert dir(calib) == sorted([*NAMES, *MODULES, "__version__"])


def test_a_public_name_can_be_imported_and_says_what_it_is():
    for name in [*NAMES, *MODULES]:
        thing = getattr(calib, name)
        assert inspect.getdoc(thing), name


def test_types_checkers_see_the_same_names():
    # The imports under TYPE_CHECKING and the table of modules are written by hand, both.
    tree = ast.parse((CALIB / "__init__.py").read_text(encoding="utf-8"))
    seen = {
        alias.asname: (node.module, alias.name)
        for branch in tree.body
        if isinstance(branch, ast.If)
        for node in branch.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    modules = {"controllers", "families", "kinds", "readers", "solvers"}
    others = {None}  # modules that are assigned, as `models`
    assert seen.keys() - others == {*NAMES, *modules}
    for name in [*NAMES, *modules]:
        module, inside = seen[name]
        thing = getattr(calib, name)
        assert getattr(importlib.import_module(module), inside) is thing


def test_the_functions_are_the_verbs_of_the_command_line():
    verbs = {name.replace("-", "_") for name in get_command(app).commands}
    functions = {name for name in NAMES if name.islower()}
    further = {"acceptance", "again", "bootstrap", "check_poses", "further_poses", "trend"}
    # A session is an object, `calib.Session`.
    assert verbs - {"app", "demo", "fit", "board", "measure"} == functions - further


def test_every_registry_has_a_module_with_register():
    assert set(MODULES) - {"plugins"} == set(plugins.WORDS)
    for name, module in MODULES.items():
        assert getattr(calib, name) is importlib.import_module(module)
    for what in plugins.WORDS:
        assert callable(getattr(calib, what).register)
    entries = {
        "controllers": "Controller",
        "families": "Family",
        "formats": "Format",
        "kinds": "Kind",
        "readers": "Reader",
    }
    for module, entry in entries.items():
        assert inspect.isclass(getattr(getattr(calib, module), entry))
    assert calib.models.Parameter is Parameter
    assert calib.solvers.Solution is Solution


def test_the_registry_of_formats_has_what_an_own_format_is_made_of():
    assert calib.formats.register is importlib.import_module("calib.verbs.convert.convert").register
    assert calib.formats.Options.__module__ == calib.formats.Source.__module__


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'calib' has no attribute 'calibrat'"):
        calib.calibrat  # noqa: B018


def test_import_calib_alone_loads_nothing_heavy():
    code = (
        "import sys, calib; calib.__version__; "
        "heavy = {'numpy', 'scipy', 'pinocchio', 'meshcat', 'yourdfpy', 'trimesh', 'rich', 'typer'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=CALIB.parent
    )
    assert run.stdout.strip() == "[]"
