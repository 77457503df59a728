"""Every message that calib raises, and whether a test provokes it.

    make coverage                                         # the tests under coverage, the totals, then this
    .venv/bin/python scripts/error_messages.py            # the messages that no test provokes
    .venv/bin/python scripts/error_messages.py --check    # the same; exit 1 if there is any
    .venv/bin/python scripts/error_messages.py --sentences  # and all other sentences that no test says
    .venv/bin/python scripts/error_messages.py --totals   # lines and branches; exit 1 below 95 %

A refusal is a ``raise`` of an error with a text. It is provoked if a test ran the ``raise`` and each statement of
the function that words the text: where ``if`` chooses among two hints, both. A sentence is any other statement with
four words or more in a row: a caution, a finding, a line of a report. The data is `.coverage`, as `make coverage`
leaves it.
"""

from __future__ import annotations

import argparse
import ast
import json
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from coverage import Coverage

_ROOT = Path(__file__).resolve().parent.parent

#: Errors with a text that are no refusals: typer's way to end with a status.
_NO_REFUSALS = ("typer.Exit",)

#: Words in a row that make a sentence.
_FEWEST_WORDS = 4

#: The least share of lines and of branches that the tests run [%].
_WANTED = 95.0

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True, slots=True)
class Refusal:
    """A ``raise`` with a text.

    Attributes:
        path: The module.
        line: Line of the ``raise``.
        kind: The error raised, as written.
        lines: First lines of all statements that word its text, that of the ``raise`` included.
        text: The text as written in the code; empty where another module words it.
    """

    path: Path
    line: int
    kind: str
    lines: tuple[int, ...]
    text: str

    @property
    def where(self) -> str:
        """The place, as an editor takes it."""
        return f"{self.path.relative_to(_ROOT)}:{self.line}"


def refusals(path: Path) -> list[Refusal]:
    """Every ``raise`` with a text in a module, in the order of its lines."""
    source = path.read_text(encoding="utf-8")
    if "raise " not in source:
        return []
    tree = ast.parse(source)
    every = functions_of(tree)
    functions = {function.name: function for function in every}
    constants = {
        name: _text(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign)
        for name in _targets(node)
    }
    found = []
    for function in every:
        for node in _own(function):
            call = node.exc if isinstance(node, ast.Raise) else None
            if not isinstance(node, ast.Raise) or not isinstance(call, ast.Call):
                continue
            if not call.args and not call.keywords:
                continue
            kind = ast.unparse(call.func)
            if kind not in _NO_REFUSALS:
                worded = dict(_worded(node, function, functions))
                own = [call, *(one for one, direct in worded.items() if direct)]
                texts = [*map(_text, own), *(constants.get(name, "") for name in _names(call))]
                text = " | ".join(filter(None, texts))
                lines = tuple(dict.fromkeys([node.lineno, *(one.lineno for one in worded)]))
                found.append(Refusal(path, node.lineno, kind, lines, text))
    return sorted(found, key=lambda refusal: refusal.line)


def sentences(path: Path) -> list[tuple[int, str]]:
    """Line and text of every other statement of a module that says four words or more in a row."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    known = {line for refusal in refusals(path) for line in refusal.lines}
    said: dict[int, str] = {}
    for function in functions_of(tree):
        for node in _own(function):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                continue
            simple = isinstance(node, ast.stmt) and not hasattr(node, "body")
            text = _text(node) if simple else ""
            if len(text.split()) >= _FEWEST_WORDS and node.lineno not in known:  # type: ignore[attr-defined]
                said[node.lineno] = text  # type: ignore[attr-defined]
    return sorted(said.items())


def functions_of(tree: ast.Module) -> list[Function]:
    """All functions of a module, methods and nested ones too."""
    return [node for node in ast.walk(tree) if isinstance(node, Function)]


@cache
def _own(function: Function) -> tuple[ast.AST, ...]:
    """Everything inside of a function that is not inside of a function in it, in the order of its lines."""
    found: list[ast.AST] = []
    waiting: list[ast.AST] = list(function.body)
    while waiting:
        node = waiting.pop()
        if not isinstance(node, Function):
            found.append(node)
            waiting.extend(ast.iter_child_nodes(node))
    return tuple(sorted(found, key=lambda node: getattr(node, "lineno", 0)))


def _worded(
    node: ast.Raise, function: Function, functions: dict[str, Function]
) -> Iterator[tuple[ast.stmt, bool]]:
    """The statements that word an error, and whether they are its text or of a name in its text."""
    earlier = [one.lineno for one in _own(function) if isinstance(one, ast.Raise)]
    began = max((line for line in earlier if line < node.lineno), default=function.lineno)
    wanted = [(name, began, True) for name in _names(node)]
    seen: set[str] = set()
    while wanted:
        name, after, direct = wanted.pop()
        if name in seen:
            continue
        seen.add(name)
        for one in _own(function):
            if not isinstance(one, ast.Assign | ast.AugAssign) or name not in _targets(one):
                continue
            if after < one.lineno < node.lineno and one.value is not None:
                yield from [(one, direct)] if _is_said(one) else []
                wanted += [(part, function.lineno, False) for part in _names(one.value)]
        if name in functions and functions[name] is not function:
            parts = (ast.Assign, ast.AugAssign, ast.Return)
            own = _own(functions[name])
            yield from ((one, direct) for one in own if isinstance(one, parts) and _is_said(one))


def _names(node: ast.AST) -> list[str]:
    """The names in a piece of code."""
    return [part.id for part in ast.walk(node) if isinstance(part, ast.Name)]


def _is_said(node: ast.AST) -> bool:
    """Whether a piece of code has words in it, two or more."""
    return any(" " in part.strip() for part in _text(node).split(" | "))


def _targets(node: ast.Assign | ast.AugAssign) -> set[str]:
    """The names that a statement gives values to."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    return {part.id for one in targets for part in ast.walk(one) if isinstance(part, ast.Name)}


def _text(node: ast.AST) -> str:
    """The words in a piece of code: its strings in the order they stand, ``{}`` for values, a bar between two."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    if isinstance(node, ast.JoinedStr):
        return "".join(
            _text(part) if isinstance(part, ast.Constant) else "{}" for part in node.values
        )
    parts: Iterable[ast.AST] = ast.iter_child_nodes(node)
    return " | ".join(filter(None, (_text(part) for part in parts)))


def modules() -> list[Path]:
    """Every module of calib."""
    return sorted((_ROOT / "calib").rglob("*.py"))


def _every_line(path: Path) -> set[int]:
    """The numbers of all lines of a module that was never imported."""
    return set(range(1, 1 + len(path.read_text(encoding="utf-8").splitlines())))


def _measured(data: str) -> dict[str, Any]:
    """Coverage's own account of calib, as its JSON report has it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "coverage.json")
        cover = Coverage(data_file=data)
        cover.load()
        cover.json_report(outfile=str(path))
        report: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return report


def main() -> None:
    """Print what no test provokes, or the totals."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--data", default=".coverage", help="coverage's data file")
    parser.add_argument("--check", action="store_true", help="exit 1 if a message is not provoked")
    parser.add_argument("--sentences", action="store_true", help="list other sentences too")
    parser.add_argument(
        "--totals", action="store_true", help="lines and branches; exit 1 below 95 %%"
    )
    asked = parser.parse_args()
    if not Path(asked.data).is_file():
        sys.exit(f"{asked.data}: there is no coverage data; run 'make coverage' first.")
    report = _measured(asked.data)
    if asked.totals:
        total = report["totals"]
        lines = 100.0 * total["covered_lines"] / total["num_statements"]
        branches = 100.0 * total["covered_branches"] / total["num_branches"]
        print(f"calib: tests run {lines:.2f} % of the lines and {branches:.2f} % of the branches.")
        sys.exit(min(lines, branches) < _WANTED)
    files = {Path(name).resolve(): found for name, found in report["files"].items()}
    count = silent = 0
    for path in modules():
        missing = set(files[path]["missing_lines"]) if path in files else _every_line(path)
        for refusal in refusals(path):
            count += 1
            left = [line for line in refusal.lines if line in missing]
            if left:
                silent += 1
                print(f"{refusal.where}: {refusal.kind}: lines {left}: {refusal.text}")
        if asked.sentences:
            for line, text in sentences(path):
                if line in missing:
                    print(f"{path.relative_to(_ROOT)}:{line}: {text}")
    print(
        f"{count} messages are raised; tests provoke {count - silent}, and {silent} are not provoked."
    )
    sys.exit(bool(asked.check and silent))


if __name__ == "__main__":
    main()
