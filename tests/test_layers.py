"""The house is built in one direction, without circles: counted over all imports, late ones and those for types too."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

from tests.places import ROOT

CALIB = ROOT / "calib"
MODULES = sorted(CALIB.rglob("*.py"))

#: Each may import from those before it, and from itself. The data are paths, and import nothing.
ORDER = (
    "version",
    "errors",
    "values",
    "mappings",
    "arrays",
    "units",
    "channels",
    "files",
    "json_files",
    "tables",
    "plugins",
    "jobs",
    "blas",
    "example",
    "robot",
    "numerics",
    "camera",
    "model",
    "data",
    "inputs",
    "vision",
    "registration",
    "estimate",
    "selection",
    "diagnosis",
    "result",
    "regions",
    "design",
    "simulation",
    "circle_points",
    "compensation",
    "formats",
    "text",
    "report",
    "calibration",
    "planning",
    "conversion",
    "fleets",
    "viewer",
    "cli",
    "__main__",
)

#: What a person's own machine calls its folders.
SOMEWHERE = re.compile(r"(?<![\w.:/}])/(?:home|root|Users|work|mnt|opt)/\S+")


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def layer(module: str) -> str:
    """The folder, or the module beside the folders, that a dotted name belongs to; '' for calib itself."""
    return [*module.split("."), ""][1]


TREES = {module_name(path): ast.parse(path.read_text(encoding="utf-8")) for path in MODULES}


def imports(tree: ast.Module) -> Iterator[str]:
    """The modules of calib that are imported anywhere in a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name.split(".")[0] == "calib")
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in line {node.lineno}"
            if (node.module or "").split(".")[0] == "calib":
                # from calib.viewer import scene imports a module, from calib.errors import X does not
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    yield inner if inner in TREES else str(node.module)
                    if node.module == "calib":
                        yield "calib"  # and with it, by name, everything that it hands out


GRAPH = {name: set(imports(tree)) for name, tree in TREES.items()}


def test_every_folder_has_its_place_in_the_order():
    assert {layer(name) for name in TREES} - {""} == set(ORDER)


def test_imports_point_one_way():
    upwards = {
        f"{name} imports {imported}"
        for name, found in GRAPH.items()
        for imported in found
        if name != "calib"  # hands out names of every layer, on first use
        and ORDER.index(layer(imported)) > ORDER.index(layer(name))
    }
    assert not upwards


def test_no_module_imports_itself_in_a_circle():
    assert sum(len(found) for found in GRAPH.values()) > 50
    TopologicalSorter(GRAPH).prepare()  # raises CycleError, which names the circle


def code_lines(path: Path) -> int:
    """Count the lines of code: docstrings, comments and blank lines are free."""
    text = path.read_text(encoding="utf-8")
    documented = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(
            node
        ):
            docstring = node.body[0]
            documented |= set(range(docstring.lineno, (docstring.end_lineno or 0) + 1))
    numbered = enumerate(map(str.strip, text.splitlines()), start=1)
    return sum(
        bool(line) and not line.startswith("#") and number not in documented
        for number, line in numbered
    )


def test_a_module_is_one_idea():
    lines = {module_name(path): code_lines(path) for path in MODULES}
    assert not {name: count for name, count in lines.items() if count > 325}


def test_only_the_command_line_prints():
    printing = {
        f"{name}, line {node.lineno}"
        for name, tree in TREES.items()
        if layer(name) != "cli"
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and ast.unparse(node.func) in ("print", "sys.stdout.write", "sys.stderr.write")
    }
    assert not printing


def test_no_file_mentions_a_place_on_someone_s_machine():
    places = ("calib", "docs", "scripts", "tests", "urdf", "README.md", "pyproject.toml")
    kinds = {".py", ".md", ".html", ".js", ".urdf", ".csv", ".toml"}
    files = [p for place in places for p in (ROOT / place, *(ROOT / place).rglob("*"))]
    found = {
        str(path.relative_to(ROOT)): places
        for path in files
        if path.suffix in kinds and (places := SOMEWHERE.findall(path.read_text(encoding="utf-8")))
    }
    assert not found


def test_the_checks_see_what_they_look_for():
    tree = ast.parse(
        "from calib.cli import options\ndef f():\n    import calib.viewer.scene\n"
        "if TYPE_CHECKING:\n    from calib.errors import CalibError\n"
    )
    assert set(imports(tree)) == {"calib.cli.options", "calib.viewer.scene", "calib.errors"}
