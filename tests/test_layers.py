"""The house is built in one direction: model, measure, identify, compensate, show, cli."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

#: What may import upwards, late: a result writes its report as it writes its other files.
UPWARDS = {
    ("calib.identify.result", "calib.show.report"),
    # Each robot of a fleet gets one, in the process that has calibrated it; all bear the date of the run.
    ("calib.identify.fleet_robot", "calib.show.report"),
    ("calib.identify.fleet", "calib.show.report_record"),
}

ROOT = Path(__file__).parents[1]
CALIB = ROOT / "calib"
MODULES = sorted(CALIB.rglob("*.py"))

#: Each may import from those before it, and from itself. The data are paths, and import nothing.
ORDER = (
    "errors",
    "units",
    "kinds",
    "data",
    "model",
    "measure",
    "identify",
    "compensate",
    "show",
    "cli",
)


def ident(path: Path) -> str:
    return str(path.relative_to(ROOT))


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {module_name(path) for path in MODULES}


def layer(module: str) -> str:
    """The folder, or the module beside the folders, that a dotted name belongs to; '' for calib itself."""
    return [*module.split("."), ""][1]


def imports(tree: ast.Module, *, top_only: bool) -> Iterator[str]:
    """The modules of calib that are imported; with ``top_only`` those imported when the module itself is."""

    def walk(node: ast.AST) -> Iterator[ast.AST]:
        for child in ast.iter_child_nodes(node):
            deferred = isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
            typing_only = isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)
            if top_only and (deferred or typing_only):
                continue
            yield child
            yield from walk(child)

    for node in walk(tree):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name.split(".")[0] == "calib")
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in line {node.lineno}"
            if (node.module or "").split(".")[0] == "calib":
                # from calib.show import scene imports a module, from calib.errors import X does not
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    yield inner if inner in NAMES else str(node.module)


#: The compiled kernel, and who calls it when there is much to do.
KERNEL = [name for name in NAMES if name.startswith("calib.model.kernel")]
COMPILED = ("calib.model.batch", "calib.identify.passes", "calib.identify.streams")


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def test_every_folder_has_its_place_in_the_order():
    assert {layer(name) for name in NAMES} - {""} <= set(ORDER)
    assert {"model", "measure", "identify", "show", "cli"} <= {layer(name) for name in NAMES}


@pytest.mark.parametrize("path", MODULES, ids=ident)
def test_imports_point_one_way(path):
    own = layer(module_name(path))
    if own == "":  # the package itself hands out names of every layer, on first use
        assert list(imports(parse(path), top_only=True)) == []
        return
    tree = parse(path)
    for imported in imports(tree, top_only=False):
        if imported == "calib":
            used = {
                node.attr
                for node in ast.walk(tree)
                if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "calib"
            }
            assert used <= {"__version__"}, "the public names are for users; import from the module"
            continue
        if (module_name(path), imported) in UPWARDS:
            assert imported not in set(imports(tree, top_only=True))
            continue
        assert ORDER.index(layer(imported)) <= ORDER.index(own), f"{imported} is above {own}"


def test_no_module_imports_itself_in_a_circle():
    graph = {module_name(path): set(imports(parse(path), top_only=True)) for path in MODULES}
    assert sum(len(edges) for edges in graph.values()) > 50
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def test_deferred_imports_within_a_folder_are_few():
    # A deferred import can hide a circle: outside of the command line values do so for their own files.
    deferred = set()
    for path in MODULES:
        if layer(module_name(path)) in ("", "cli"):
            continue
        tree = parse(path)
        hidden = set(imports(tree, top_only=False)) - set(imports(tree, top_only=True))
        deferred |= {(module_name(path), name) for name in hidden}
    assert deferred <= {
        ("calib.identify.result", "calib.identify.summary"),
        # numba takes its time to load, and few tables are that large.
        *((of, kernel) for of in COMPILED for kernel in KERNEL),
        ("calib.model.robot", "calib.model.batch"),  # which is made of robots
        ("calib.model.batch", "calib.model.kinematics"),  # for the types alone
        ("calib.identify.result", "calib.identify.result_file"),
        *UPWARDS,
        # A program and its commands have files of their own, which are made of them.
        ("calib.compensate.program", "calib.compensate.program_file"),
        ("calib.compensate.commands", "calib.compensate.commands_file"),
        ("calib.compensate.commands_file", "calib.compensate.commands"),
        # calib.show can be called: what it calls, and what it is called with.
        ("calib.show", "calib.show.opening"),
        ("calib.show", "calib.identify.calibration"),
        ("calib.show", "calib.model.robot"),
        ("calib.show", "calib.show.viewer"),
    }


@pytest.mark.parametrize("path", MODULES, ids=ident)
def test_a_module_is_one_idea(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 400


@pytest.mark.parametrize("path", MODULES, ids=ident)
def test_only_the_command_line_prints(path):
    if layer(module_name(path)) == "cli":
        return
    calls = [node.func for node in ast.walk(parse(path)) if isinstance(node, ast.Call)]
    assert not [f for f in calls if isinstance(f, ast.Name) and f.id == "print"]
    assert not [f for f in calls if ast.unparse(f) in ("sys.stdout.write", "sys.stderr.write")]


@pytest.mark.parametrize(
    "path",
    # calib.show can be called, which takes a few lines; the command line's init is its program.
    [
        p
        for p in CALIB.rglob("__init__.py")
        if p.parent.name in ORDER[3:-1] and p.parent.name != "show"
    ],
    ids=ident,
)
def test_a_folder_s_init_is_its_docstring(path):
    body = parse(path).body
    assert len(body) == 1
    assert isinstance(body[0], ast.Expr)


@pytest.mark.parametrize(
    "path",
    sorted(
        path
        for place in ("calib", "docs", "scripts", "tests", "urdf", "README.md", "pyproject.toml")
        for path in (ROOT / place, *(ROOT / place).rglob("*"))
        if path.suffix in {".py", ".md", ".html", ".js", ".urdf", ".csv", ".toml"}
    ),
    ids=ident,
)
def test_no_file_mentions_a_place_on_someone_s_machine(path):
    text = path.read_text(encoding="utf-8")
    assert not re.findall(r"(?<![\w.:/}])/(?:home|root|Users|work|mnt|opt)/\S+", text)


def test_the_checks_see_what_they_look_for():
    tree = ast.parse(
        "from calib.cli import fit\ndef f():\n    import calib.show.scene\n"
        "if TYPE_CHECKING:\n    from calib.errors import CalibError\n"
    )
    assert list(imports(tree, top_only=True)) == ["calib.cli.fit"]
    assert set(imports(tree, top_only=False)) == {
        "calib.cli.fit",
        "calib.show.scene",
        "calib.errors",
    }
