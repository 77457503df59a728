"""Tests that notice: random mutants of calib's core, each against the fast tests of its folder.

    python scripts/mutants.py --count 200 -o run.jsonl   # goes on where the file ends

A mutant is a module with one change: another operator or comparison, a sign or a `not` dropped, a
constant by a factor, two arguments swapped. It dies when a test fails. A survivor lacks a test, or
is equivalent (a cache, a tolerance, a boundary that no number meets): a person has to judge.
Tests run in copies of the checkout, in a temporary folder.
"""

# mutmut and cosmic-ray have neither a seeded draw, nor tests by module, nor factors on constants.

from __future__ import annotations

import argparse
import ast
import fnmatch
import hashlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from itertools import accumulate, islice, pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

#: The modules that decide numbers and verdicts.
FITTING = (
    "numerics/*",
    "model/*",
    "data/kinds",
    "fit/registration/*",
    "fit/estimate/*",
    "fit/estimate/special_cases/*",
)
JUDGING = ("fit/selection/*", "diagnosis/*", "result/*", "uncertainty/*")
COMPENSATING = tuple(
    f"verbs/compensate/{name}"
    for name in (
        "compensate",
        "expected",
        "inverse",
        "nominal_actual",
        "pose_covariance",
        "solutions",
    )
)

#: An operator between its operands.
OPERATOR = re.compile(r"not\s+in|is\s+not|[^\s()]+")

#: What takes the place of an operator: of an order, that with the boundary, and the opposite.
SUMS = {"+": ["-"], "-": ["+"], "*": ["/"], "/": ["*"], "//": ["/"], "%": ["//"], "**": ["*"]}
BOOLEANS = {"&": ["|"], "|": ["&"], "and": ["or"], "or": ["and"]}
ORDERS = {"<": ["<=", ">="], "<=": ["<", ">"], ">": [">=", "<="], ">=": [">", "<"]}
EQUALITIES = {"==": ["!="], "!=": ["=="], "is": ["is not"], "is not": ["is"]}
REPLACEMENTS = SUMS | BOOLEANS | ORDERS | EQUALITIES | {"in": ["not in"], "not in": ["in"]}

#: Functions whose value is the same with swapped arguments.
SYMMETRIC = ("min", "max", "np.minimum", "np.maximum", "np.hypot", "np.array_equal")

#: Factors on constants; whole numbers up to 2, which are indices and counts, change by one.
FACTORS = (0.1, 0.5, 2.0, 10.0)

#: Fields of the syntax tree that decide nothing: type hints, decorators, messages of errors.
SKIPPED = ("annotation", "returns", "decorator_list", "exc", "msg")

#: What tests do not need of the checkout.
NOT_COPIED = shutil.ignore_patterns(".*", "__pycache__", "site", "demo", "*.jsonl")

#: The longest that the tests of a mutant may compute, however busy the machine is, and that they may wait [s].
LIMIT = 600
PATIENCE = 7200.0


@dataclass(frozen=True, slots=True)
class Place:
    """A part of a module that can be changed."""

    path: str  # Of the module in the checkout
    kind: str  # Name of the class of `ast`: "BinOp", "Compare", "BoolOp", "UnaryOp", "Call", ...
    start: int  # The first byte that is replaced
    end: int  # The byte behind the last one
    texts: list[str]  # Each of which may take its place


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change of one module, and what the tests found of it."""

    path: str
    kind: str
    start: int
    end: int
    text: str  # What takes the place of these bytes
    digest: str  # Of the unchanged module
    line: int  # From 1
    before: str  # The lines as they are
    after: str  # The lines as changed
    # Tests of its "own file", or of its "folder"; "" for a survivor
    killed_by: str = field(default="", compare=False)
    test: str = field(default="", compare=False)  # The first that failed, or "time limit"


def expressions(tree: ast.AST) -> Iterator[ast.expr]:
    """Yield what decides something, see `SKIPPED`; no f-strings, no type aliases."""
    for name, value in ast.iter_fields(tree):
        for node in value if isinstance(value, list) else [value]:
            if name in SKIPPED or not isinstance(node, ast.AST) or isinstance(node, ast.JoinedStr):
                continue
            if isinstance(node, ast.stmt) and re.match(
                r"__all__|\w+: TypeAlias", ast.unparse(node)
            ):
                continue
            if isinstance(node, ast.expr):
                yield node
            yield from expressions(node)


def places(path: str) -> Iterator[Place]:
    """Yield the places of a module."""
    data = (ROOT / path).read_bytes()
    line_starts = [0, *accumulate(map(len, data.splitlines(keepends=True)))]

    def span(node: ast.expr) -> tuple[int, int]:
        # Columns of `ast` count bytes.
        last, column = node.end_lineno or 0, node.end_col_offset or 0
        return line_starts[node.lineno - 1] + node.col_offset, line_starts[last - 1] + column

    for node in expressions(ast.parse(data)):
        kind, (start, end) = type(node).__name__, span(node)
        for (_, low), (high, _) in pairwise(map(span, _operands(node))):
            if match := OPERATOR.search(data[low:high].decode()):
                texts = REPLACEMENTS.get(match[0], [])
                yield Place(path, kind, low + match.start(), low + match.end(), texts)
        if isinstance(node, ast.UnaryOp):
            yield Place(path, kind, start, start + (3 if isinstance(node.op, ast.Not) else 1), [""])
        elif isinstance(node, ast.Constant):
            yield Place(path, kind, start, end, _other_numbers(node.value))
        elif isinstance(node, ast.Call) and ast.unparse(node.func) not in SYMMETRIC:
            for (first, comma), (second, last) in pairwise(map(span, node.args)):
                swapped = data[second:last] + data[comma:second] + data[first:comma]
                yield Place(path, kind, first, last, [swapped.decode()])


def _operands(node: ast.expr) -> list[ast.expr]:
    """Return the operands with operators between them."""
    if isinstance(node, ast.BinOp):
        return [node.left, node.right]
    if isinstance(node, ast.Compare):
        return [node.left, *node.comparators]
    return node.values if isinstance(node, ast.BoolOp) else []


def _other_numbers(value: object) -> list[str]:
    """Return what a constant is changed to; nothing for one that is no number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return []
    if value == 0:
        return ["1"]
    if isinstance(value, int) and value <= 2:
        return [str(value + 1), str(value - 1)]
    return [repr(type(value)(value * factor)) for factor in FACTORS]


def mutant_of(place: Place, text: str) -> Mutant | None:
    """Return the mutant with this text at a place; None if it is no Python, or no change."""
    data = (ROOT / place.path).read_bytes()
    start, end = place.start, place.end
    changed = data[:start] + text.encode() + data[end:]
    try:
        ast.parse(changed)
    except SyntaxError:
        return None
    rows = slice(data[:start].count(b"\n"), data[:end].count(b"\n") + 1)
    before, after = (
        " ".join(line.decode().strip() for line in version.splitlines()[rows])
        for version in (data, changed)
    )
    digest = hashlib.sha256(data).hexdigest()[:12]
    mutant = Mutant(place.path, place.kind, start, end, text, digest, rows.start + 1, before, after)
    return mutant if changed != data else None


def draw(only: str, seed: int) -> Iterator[Mutant]:
    """Yield mutants at random: first the kind, then the place, then the change.

    Args:
        only: A part of the modules' paths, or a pattern of it.
        seed: The same seed gives the same mutants in the same order while the code is the same.
    """
    rng, by_kind = random.Random(seed), dict[str, list[Place]]()
    paths: list[Path] = []
    for pattern in (*FITTING, *JUDGING, *COMPENSATING):
        found = sorted(ROOT.glob(f"calib/{pattern}.py"))
        if not found:
            raise SystemExit(f"No module is called calib/{pattern}.py any more.")
        paths += found
    paths.sort()
    names = [path.relative_to(ROOT).as_posix() for path in paths]
    for name in fnmatch.filter(names, f"*{only}*"):
        for place in places(name):
            by_kind.setdefault(place.kind, []).append(place)
    for kind in sorted(by_kind):
        rng.shuffle(by_kind[kind])
    while kinds := sorted(kind for kind, left in by_kind.items() if left):
        place = by_kind[rng.choice(kinds)].pop()
        mutant = mutant_of(place, rng.choice(place.texts)) if place.texts else None
        if mutant is not None:
            yield mutant


def environment(root: Path) -> dict[str, str]:
    """Return the variables with which Python runs the tests of a copy."""
    changes = {"PYTHONPATH": str(root), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    return os.environ | changes


def compile_tests(root: Path, mutants: list[Mutant]) -> None:
    """Compile the tests of mutants, and all that they import, once for all runs: half of a run is compilation."""
    folders = {tests_of(mutant.path) for mutant in mutants}
    paths = {mutant.path for mutant in mutants} | {one for one in folders if (root / one).exists()}
    subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "--collect-only",
            "-q",
            "-pno:cacheprovider",
            *sorted(paths),
        ],
        cwd=root,
        env=environment(root) | {"PYTHONDONTWRITEBYTECODE": ""},
        stdout=subprocess.DEVNULL,
        check=True,
    )


def run(root: Path, arguments: list[str]) -> str:
    """Run tests of a copy; returns the first one that fails, "time limit", or "" if all pass."""
    process = subprocess.Popen(
        [sys.executable, "-m", "pytest", "-xq", "--tb=no", "-pno:cacheprovider", *arguments],
        cwd=root,
        env=environment(root) | {"PYTHONDONTWRITEBYTECODE": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (LIMIT, LIMIT + 5)),
    )
    try:
        output, _ = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)  # with all that the tests started
        process.wait()
        return "time limit"
    if process.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return "time limit"
    if process.returncode in (0, 5):  # 5: there is no test
        return ""
    failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", output, re.MULTILINE)
    return failed[1] if failed else "an error"


def tests_of(module: str) -> str:
    """Return the folder of the tests of a module: that of the same name in tests/."""
    return Path("tests", *Path(module).parts[1:-1]).as_posix()


def judged(root: Path, mutant: Mutant, sound: set[str]) -> Mutant:
    """Run the examples and the own tests of a mutant's module, then all others of its folder.

    The test that fails has to pass without the mutant; `sound` are those that are known to.
    """
    path = root / mutant.path
    folder = tests_of(mutant.path)
    if not (root / folder).exists():  # nothing notices anything
        return mutant
    own = f"{folder}/test_{path.name}"
    first = [mutant.path, own] if (root / own).exists() else [mutant.path]
    data, times = path.read_bytes(), path.stat()
    path.write_bytes(data[: mutant.start] + mutant.text.encode() + data[mutant.end :])
    os.utime(path, (0, 0))  # what was compiled of the module is not that of this second
    for name, arguments in (("own file", first), ("folder", [folder, f"--ignore={own}"])):
        if test := run(root, arguments):
            mutant = replace(mutant, killed_by=name, test=test)
            break
    path.write_bytes(data)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    if "::" in mutant.test and mutant.test not in sound:
        if run(root, [mutant.test]) == mutant.test:
            raise SystemExit(f"Without a mutant a test fails: {mutant.test}")
        sound.add(mutant.test)
    found = mutant.killed_by or "SURVIVED"
    print(f"{mutant.path}:{mutant.line} {mutant.kind}: {found} {mutant.test}", flush=True)
    return mutant


def survey(mutants: list[Mutant], workers: int, file: Path) -> None:
    """Judge mutants, and append each to the file as it is done."""
    remaining = iter(mutants)  # shared by the workers
    sound: set[str] = set()

    def work(root: Path) -> None:
        try:
            for mutant in remaining:
                line = json.dumps(asdict(judged(root, mutant, sound))) + "\n"
                with file.open("a", encoding="utf-8") as lines:
                    lines.write(line)
        finally:
            list(remaining)  # what ends one worker ends all

    with tempfile.TemporaryDirectory() as parent, ThreadPoolExecutor(workers) as pool:
        roots = [Path(parent, str(k)) for k in range(workers)]
        shutil.copytree(ROOT, roots[0], ignore=NOT_COPIED)
        compile_tests(roots[0], mutants)
        for root in roots[1:]:
            shutil.copytree(roots[0], root)
        try:
            list(pool.map(work, roots))
        finally:
            list(remaining)  # after Ctrl-C none is begun


def read(file: Path) -> dict[Mutant, Mutant]:
    """Return what a file has found of each mutant, at last."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return {mutant: mutant for mutant in (Mutant(**json.loads(line)) for line in lines)}


def report(mutants: list[Mutant]) -> None:
    """Print the survivors, and how many died of what."""
    for one in sorted(mutants, key=lambda mutant: (mutant.path, mutant.line)):
        if not one.killed_by:
            print(f"\n{one.path}:{one.line} ({one.kind})\n  - {one.before}\n  + {one.after}")
    counts = Counter(mutant.killed_by or "survived" for mutant in mutants)
    print(f"\nOf {len(mutants)}: " + ", ".join(f"{n} {what}" for what, n in counts.most_common()))


def main() -> None:
    """Draw, run and report."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--count", type=int, default=60, help="how many mutants (default: 60)")
    parser.add_argument("--seed", type=int, default=1, help="of the draw (default: 1)")
    parser.add_argument("--workers", type=int, default=1, help="how many at a time (default: 1)")
    parser.add_argument("--only", default="", metavar="PATTERN", help="part of the modules' paths")
    parser.add_argument("--again", action="store_true", help="run the file's survivors once more")
    parser.add_argument("-o", "--output", type=Path, default=Path("mutants.jsonl"))
    options = parser.parse_args()
    mutants = list(islice(draw(options.only, options.seed), options.count))
    known = read(options.output)
    done = {mutant for mutant in known.values() if mutant.killed_by or not options.again}
    left = [mutant for mutant in mutants if mutant not in done]
    survey(left, options.workers, options.output)
    known = read(options.output)
    report([known[mutant] for mutant in mutants])


if __name__ == "__main__":
    main()
