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
from calib.cli.program import app

CALIB = Path(calib.__file__).parent

#: A name that leaves this list breaks programs that use it.
NAMES = [
    "CalibError",
    "Calibration",
    "Cell",
    "Commands",
    "Comparison",
    "Evaluation",
    "Measurements",
    "Plan",
    "PlanRequest",
    "Program",
    "Region",
    "Robot",
    "Scenario",
    "base_frame",
    "bootstrap",
    "calibrate",
    "compare",
    "compensate",
    "convert",
    "evaluate",
    "fleet",
    "inspect",
    "plan",
    "simulate",
    "view",
    "workspace",
]


def test_the_public_names():
    assert calib.__all__ == NAMES
    assert dir(calib) == sorted([*NAMES, "__version__"])


def test_a_public_name_can_be_imported_and_says_what_it_is():
    for name in NAMES:
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
    assert sorted(seen) == NAMES
    for name, (module, inside) in seen.items():
        assert getattr(importlib.import_module(module), inside) is getattr(calib, name)


def test_the_functions_are_the_verbs_of_the_command_line():
    verbs = {name.replace("-", "_") for name in get_command(app).commands}
    functions = {name for name in NAMES if name.islower()}
    assert verbs - {"demo", "fit"} == functions - {"bootstrap"}


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
