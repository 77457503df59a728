"""The names that users may rely on, and what is said about them."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import calib

CALIB = Path(calib.__file__).parent

#: A name that leaves this list breaks programs that use it.
NAMES = [
    "Acceptance",
    "Box",
    "CalibError",
    "Calibration",
    "Cell",
    "Commands",
    "Comparison",
    "Density",
    "Evaluation",
    "Fleet",
    "FleetOptions",
    "FleetRobot",
    "GroupDistance",
    "Measurements",
    "Payload",
    "Plan",
    "PlanRequest",
    "Priors",
    "Program",
    "Reflector",
    "Region",
    "Robot",
    "Scenario",
    "Survey",
    "Sweeps",
    "Tracker",
    "TrackerNoise",
    "acceptance",
    "bootstrap",
    "calibrate",
    "compare",
    "compensate",
    "convert",
    "evaluate",
    "fleet",
    "forecast",
    "plan",
    "profile_interval",
    "read_sweeps",
    "simulate",
    "survey",
    "view",
    "workspace",
    "workspace_uncertainty",
]


def test_the_public_names():
    assert calib.__all__ == NAMES
    assert dir(calib) == sorted([*NAMES, "__version__"])


def test_a_public_name_can_be_imported_and_says_what_it_is():
    for name in NAMES:
        thing = getattr(calib, name)
        assert thing.__name__.rpartition(".")[2] == name
        assert inspect.getdoc(thing), name


def test_types_checkers_see_the_same_names():
    # The imports under TYPE_CHECKING and the table of modules are written by hand, both.
    tree = ast.parse((CALIB / "__init__.py").read_text(encoding="utf-8"))
    seen = {
        alias.name: node.module
        for branch in tree.body
        if isinstance(branch, ast.If)
        for node in branch.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert sorted(seen) == NAMES
    for name, module in seen.items():
        thing = getattr(importlib.import_module(module), name)
        assert thing.__name__ == name
        assert thing is getattr(calib, name)


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
