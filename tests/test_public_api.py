"""The names that users may rely on, and what is said about them."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
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
    "Priors",
    "Program",
    "Reflector",
    "Region",
    "Robot",
    "Scenario",
    "Study",
    "Survey",
    "Sweeps",
    "Tracker",
    "TrackerNoise",
    "Trials",
    "acceptance",
    "bootstrap",
    "calibrate",
    "commands",
    "compare",
    "evaluate",
    "fleet",
    "forecast",
    "plan",
    "profile_interval",
    "read_sweeps",
    "sample_workspace",
    "study",
    "survey",
    "view",
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
        if name != "show":
            assert thing is getattr(calib, name)


@pytest.mark.parametrize("before", ["pass", "import calib.viewer.scene"])
def test_show_can_be_called_whatever_was_imported_before(before):
    # calib/show is a folder too, and importing from a folder sets calib's attribute of that name.
    code = f"import calib; {before}; assert callable(calib.view), calib.view"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=CALIB.parent)


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


def public(tree: ast.AST) -> list[tuple[str, ast.AST, str]]:
    """Public functions, classes and their public methods: name, node, docstring of the class around it."""
    found: list[tuple[str, ast.AST, str]] = []
    for node in ast.iter_child_nodes(tree):
        if "overload" in map(ast.unparse, getattr(node, "decorator_list", [])):
            continue  # a signature of the function that follows
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            found.append((node.name, node, ""))
            if isinstance(node, ast.ClassDef):
                around = ast.get_docstring(node) or ""
                found += [(f"{node.name}.{n}", inner, around) for n, inner, _ in public(node)]
    return found


def test_everything_public_has_a_docstring_that_says_the_shape_of_its_arrays():
    silent, shapeless = [], []
    for path in sorted(CALIB.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if not ast.get_docstring(tree):
            silent.append(path.name)
        for name, node, around in public(tree):
            said = (ast.get_docstring(node) or "") + around
            if not ast.get_docstring(node):
                silent.append(f"{path.name}: {name}")
            if isinstance(node, ast.FunctionDef):
                arguments = node.args.args + node.args.kwonlyargs
                hints = [*(a.annotation for a in arguments), node.returns]
            else:
                hints = [n.annotation for n in node.body if isinstance(n, ast.AnnAssign)]
            text = " ".join(ast.unparse(hint) for hint in hints if hint is not None)
            if (
                path.parent.name == "model"
                and "Array" in text
                and not re.search(r"shape|\(\w+, ?\w*\)", said)
            ):
                shapeless.append(f"{path.name}: {name}")
    assert not silent
    assert not shapeless
