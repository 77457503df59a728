"""No file that calib reads can have it run anything: what could is not called anywhere in it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

CALIB = Path(__file__).parents[1] / "calib"

#: Modules that make objects, or programs, out of bytes.
MODULES = {
    "pickle",
    "cPickle",
    "dill",
    "cloudpickle",
    "marshal",
    "shelve",
    "joblib",
    "code",
    "codeop",
}
#: These hand jobs to calib's own processes, through pipes of their own; no file goes through them.
PIPES = {"identify/executors.py", "identify/processes.py"}
CALLS = {"eval", "exec", "compile", "__import__", "execfile"}
LOADERS = {
    "yaml.load",
    "yaml.load_all",
    "pickle.load",
    "pickle.Unpickler",
    "yaml.unsafe_load",
    "yaml.full_load",
    "os.system",
    "os.popen",
}


def faults(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            module = node.module if isinstance(node, ast.ImportFrom) else None
            names = {(module or alias.name).partition(".")[0] for alias in node.names}
            yield from (f"line {node.lineno}: import of {name}" for name in names & MODULES)
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        keywords = {k.arg: ast.unparse(k.value) for k in node.keywords}
        if called in CALLS or called in LOADERS:
            yield f"line {node.lineno}: {called}"
        if called.endswith("load") and keywords.get("allow_pickle", "False") != "False":
            yield f"line {node.lineno}: {called} with allow_pickle"
        if keywords.get("shell", "False") != "False":
            yield f"line {node.lineno}: {called} with a shell"


@pytest.mark.parametrize(
    "path", sorted(CALIB.rglob("*.py")), ids=lambda p: str(p.relative_to(CALIB))
)
def test_nothing_is_evaluated(path: Path):
    found = list(faults(ast.parse(path.read_text(encoding="utf-8"))))
    if path.relative_to(CALIB).as_posix() in PIPES:
        found = [fault for fault in found if "import of pickle" not in fault]
    assert found == []


@pytest.mark.parametrize(
    "text",
    [
        "eval('1')",
        "exec(x)",
        "import pickle",
        "from pickle import loads",
        "yaml.load(x, Loader)",
        "np.load(f, allow_pickle=True)",
        "subprocess.run(x, shell=True)",
        "os.system('x')",
        "pickle.load(file)",
    ],
)
def test_the_test_sees_them(text: str):
    assert len(list(faults(ast.parse(text)))) == 1
