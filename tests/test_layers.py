"""The house is built in one direction, without circles: counted over all imports, late ones and those for types too."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

from tests.places import ROOT

CALIB = ROOT / "calib"
MODULES = sorted(CALIB.rglob("*.py"))

#: The core, from below: each room may import from those before it, and from itself.
CORE = (
    "version",
    "errors",
    "basics",
    "example",
    "boards",
    "robot",
    "camera",
    "numerics",
    "model",
    "data",
    "instruments",
    "fit",
    "diagnosis",
    "result",
    "uncertainty",
    "show",
    "cli",
)

#: The verbs, each with those that it may use. All use the core, and the core knows no verb.
VERBS: dict[str, set[str]] = {
    "app": {"history", "inspect", "measure", "view"},
    "bag": set(),
    "base_frame": set(),
    "board": set(),
    "calibrate": {"view"},
    "certificate": {"evaluate"},
    "check": {"detect", "evaluate", "plan"},
    "compare": {"view"},
    "compensate": set(),
    "convert": set(),
    "demo": {"calibrate", "view"},
    "detect": set(),
    "evaluate": {"detect"},
    "fleet": {"calibrate"},
    "history": set(),
    "inspect": {"compensate", "plan"},
    "joints": {"compensate"},
    "measure": {"calibrate", "compensate", "detect", "plan", "workspace"},
    "plan": {"compensate", "view", "workspace"},
    "simulate": {"measure", "plan"},
    "view": {"evaluate"},
    "workspace": set(),
}

#: Above the verbs: the program with all of them.
ABOVE = ("program", "__main__")

#: What a person's own machine calls its folders.
SOMEWHERE = re.compile(r"(?<![\w.:/}])/(?:home|root|Users|work|mnt|opt)/\S+")


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(module: str) -> str:
    """The folder, or the module beside the folders, that a dotted name belongs to; '' for calib itself."""
    return [*module.split("."), ""][1]


def verb(module: str) -> str:
    """The verb whose folder a module is in; '' elsewhere."""
    parts = [*module.split("."), "", ""]
    return parts[2] if parts[1] == "verbs" else ""


@cache
def trees() -> dict[str, ast.Module]:
    """The syntax tree of each module by its dotted name; of two hundred modules it takes a while."""
    return {module_name(path): ast.parse(path.read_text(encoding="utf-8")) for path in MODULES}


def imports(tree: ast.Module) -> Iterator[str]:
    """The modules of calib that are imported anywhere in a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name.split(".")[0] == "calib")
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in line {node.lineno}"
            if (node.module or "").split(".")[0] == "calib":
                # from calib.verbs.view import scene imports a module, from calib.errors import X does not
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    yield inner if inner in trees() else str(node.module)
                    if node.module == "calib":
                        yield "calib"  # and with it, by name, everything that it hands out


@cache
def graph() -> dict[str, set[str]]:
    """What each module imports of calib."""
    return {name: set(imports(tree)) for name, tree in trees().items()}


def test_every_room_has_its_place():
    assert {room(name) for name in trees()} - {"", "verbs"} == {*CORE, *ABOVE}
    assert {verb(name) for name in trees()} - {""} == set(VERBS)


def is_allowed(name: str, imported: str) -> bool:
    """Whether a module may import another one."""
    here, there = room(name), room(imported)
    if name == "calib":  # hands out names of every room, on first use
        return True
    if here in ABOVE:
        return there not in ABOVE or ABOVE.index(there) <= ABOVE.index(here)
    if here == "verbs":
        return there in CORE or verb(imported) in {verb(name), *VERBS[verb(name)]}
    return there in CORE and CORE.index(there) <= CORE.index(here)


def test_the_core_knows_no_verb_and_a_verb_uses_the_core_and_the_verbs_listed_beside_it():
    wrong = {
        f"{name} imports {imported}"
        for name, found in graph().items()
        for imported in found
        if not is_allowed(name, imported)
    }
    assert not wrong


def test_every_listed_verb_is_used():
    used: dict[str, set[str]] = {name: set() for name in VERBS}
    for name, found in graph().items():
        if verb(name):
            used[verb(name)] |= {verb(imported) for imported in found} - {"", verb(name)}
    assert used == VERBS


def shown_modules(tree: ast.Module) -> Iterator[tuple[bool, str]]:
    """The modules that `shown_by` names in a module, and whether a method of a class does so."""
    methods = [
        node
        for kind in tree.body
        if isinstance(kind, ast.ClassDef)
        for method in kind.body
        for node in ast.walk(method)
    ]
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "shown_by":
            (module,) = node.args
            assert isinstance(module, ast.Constant)
            yield node in methods, f"calib.{module.value}"


def test_only_methods_of_values_name_the_modules_that_show_them():
    found = [pair for tree in trees().values() for pair in shown_modules(tree)]
    assert len(found) > 10
    assert all(is_method and module in trees() for is_method, module in found)


def test_words_of_a_verb_are_its_own():
    """English stays above: other rooms do not import a verb's texts, but for the 3-D page, which all share."""
    outside = {
        f"{name} imports {imported}"
        for name, found in graph().items()
        for imported in found
        if imported.split(".")[-1].endswith("text")
        and verb(imported)
        and verb(name) != verb(imported)
    }
    assert not outside


def test_boards_could_be_a_package_of_their_own():
    wrong = {
        f"{name} imports {imported}"
        for name, found in graph().items()
        if room(name) == "boards"
        for imported in found
        if room(imported) not in ("boards", "basics", "errors")
    }
    assert not wrong


def uses_opencv(tree: ast.Module) -> bool:
    """Whether a module imports OpenCV, by a statement or by its name as a text, or what boards import it with."""
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Constant) and node.value == "cv2":
            names.append("cv2")
    return any(f"{name}.".startswith(("cv2.", "calib.boards.opencv.")) for name in names)


def test_opencv_is_used_inside_boards_alone():
    using = {name for name, tree in trees().items() if uses_opencv(tree)}
    assert using
    assert {room(name) for name in using} == {"boards"}


def test_no_module_imports_itself_in_a_circle():
    assert sum(len(found) for found in graph().values()) > 50
    TopologicalSorter(graph()).prepare()  # raises CycleError, which names the circle


def test_only_the_command_line_prints():
    printing = {
        f"{name}, line {node.lineno}"
        for name, tree in trees().items()
        if room(name) != "cli" and not name.endswith("command") and name != "calib.__main__"
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
        "from calib.cli import options\ndef f():\n    import calib.show.scene.scene\n"
        "if TYPE_CHECKING:\n    from calib.errors import CalibError\n"
    )
    assert set(imports(tree)) == {"calib.cli.options", "calib.show.scene.scene", "calib.errors"}
    for line in (
        "import cv2",
        "import cv2.aruco",
        "from cv2 import aruco",
        "import_module('cv2')",
        "from calib.boards.opencv import opencv",
        "from calib.boards import opencv",
        "import calib.boards.opencv as opencv",
    ):
        assert uses_opencv(ast.parse(f"def f():\n    {line}\n")), line
    assert not uses_opencv(ast.parse("from calib.boards.board import Board\nx = 'cv2.fisheye'\n"))
