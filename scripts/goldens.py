"""Run calib's commands on small data, keep the numbers that come out, and compare them with those of another run.

    python scripts/goldens.py -o new.json [--data FOLDER] [--only PATTERN] [--against old.json] [--ignore-text]
    python scripts/goldens.py --compare old.json new.json [--ignore-text] [--renamed larger=non_geometric]
    python scripts/goldens.py --list

The calib that runs is the one that Python imports, so PYTHONPATH chooses the checkout. Numbers come from the files
that a command writes (result JSON, tables, URDFs by their forward kinematics) and, as `text`, from what it prints.
Options may stand in a file, one a line: @renamed.txt.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import itertools
import json
import os
import re
import shlex
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from goldens_compare import LOOSE, STRICT, Comparison, rename
from goldens_numbers import KEPT, file_content, json_content, text_numbers

ROOT = Path(__file__).resolve().parents[1]

#: Commands, a case a line.
CASES = Path(__file__).with_name("goldens_cases.txt")

#: Files that the commands begin with: cells, the paper's points apart from their joint values, and contacts and sweeps
#: of a virtual UR3 (contacts with errors of 3 mrad and 0.3 mm in all placements, sweeps with two gross errors).
INPUTS = Path(__file__).with_name("goldens_data")

#: What a run keeps of its cases, by name.
Kept = Mapping[str, Mapping[str, Any]]

#: Verbs whose text is not kept: it is long, and their files have all of its numbers.
SILENT = ("fit", "fleet")

#: Verbs whose figures depend on the maximum of a restricted likelihood.
LIKELIHOOD = ("fit", "demo", "fleet")

#: Options before a file that a command writes.
WRITING = ("-o", "--json", "--truth", "--truth-urdf", "--cell-out")

#: Exit statuses of commands that did what they should: 3 is a verdict `do not use`, or a failed test.
FINE = (None, 0, 3)


# Cases


def api_calibrate() -> dict[str, Any]:
    """Calibrate from Python, write JSON and URDF, and predict."""
    import calib

    robot = calib.Robot.load("robot.urdf", base="base", tip="tool0")
    table = calib.Measurements.read("data.csv", robot.joint_names)
    result = calib.calibrate(robot, table, cell=calib.Cell(estimate_frame=True, model="dh"))
    result.write_json("api.json")
    result.write_urdf("api.urdf")
    q = np.tile(np.linspace(-1, 1, 7)[:, None], 6)
    return {"predicted": json_content(np.asarray(result.predict(q)).tolist())}


def api_survey() -> dict[str, Any]:
    """Estimate a base frame from sweeps."""
    import calib
    from calib.verbs.base_frame.sweeps import read_sweeps

    robot = calib.Robot.load("robot.urdf", base="base", tip="tool0")
    frame = calib.base_frame(read_sweeps("sweeps.csv"), robot)
    return {"frame": json_content(np.asarray(frame.T_tracker_base).tolist())}


def api_workspace() -> dict[str, Any]:
    """Sample a workspace and find its densest part."""
    import calib
    from calib.verbs.workspace.region import Density
    from calib.verbs.workspace.workspace import workspace_points

    robot = calib.Robot.load("robot.urdf", base="base", tip="tool0")
    points = workspace_points(robot, [-0.07, 0.07, 0.022], count=2**13)
    volume = Density.of(points).region(0.9).volume
    return {"volume": volume, "points": json_content(np.asarray(points).tolist())}


API: dict[str, Callable[[], dict[str, Any]]] = {
    "api/calibrate": api_calibrate,
    "api/survey": api_survey,
    "api/workspace": api_workspace,
}


def all_cases() -> dict[str, list[str]]:
    """Return the words of every command, by the name of its case; those of the API have none."""
    cases = {}
    for line in CASES.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            name, words = line.split(": ", 1)
            cases[name] = shlex.split(words)
    return cases | {name: [] for name in API}


def with_needed(names: Iterable[str], cases: Mapping[str, list[str]]) -> set[str]:
    """Return cases with those before them whose files they read."""
    chosen = set(names)
    for name in reversed(list(cases)):
        if name in chosen:
            chosen |= {other for other in cases if writes_for(cases[other], cases[name])}
    return chosen


def writes_for(writer: list[str], reader: list[str]) -> bool:
    """Return True if a command writes a file that another one reads."""
    if writer is reader:
        return False
    pairs = itertools.pairwise
    files = {file for option, file in pairs(writer) if option in WRITING}
    files -= {file for option, file in pairs(reader) if option in ("-o", "--json")}
    return any(file in word.split("/")[0].split(":=") for file in files for word in reader)


# Runs


def copy_inputs(folder: Path, data: Path | None) -> None:
    """Copy the files that the commands begin with.

    Args:
        folder: Folder of the run.
        data: Folder of real data, each file of which gets its folder's name before its own; None: there are none.
    """
    shutil.copytree(INPUTS, folder, dirs_exist_ok=True)
    shutil.copy(ROOT / "urdf" / "ur3.urdf", folder / "robot.urdf")
    shutil.copy(ROOT / "calib" / "example" / "ur3_leica.csv", folder / "data.csv")
    if data is None:
        return
    for path in data.rglob("*"):
        if path.suffix in (".csv", ".urdf", ".conf"):
            shutil.copy(path, folder / f"{path.parent.name}_{path.name}")
    ur10 = folder / "ipa_ur10_series_C.csv"
    if ur10.is_file():
        head, *rows = ur10.read_text(encoding="utf-8").splitlines()
        part = "\n".join([head, *rows[::15], ""])
        (folder / "ur10_part.csv").write_text(part, encoding="utf-8")


def run(pattern: str, data: Path | None) -> Kept:
    """Run the cases whose name matches a regular expression.

    Args:
        pattern: The expression.
        data: Folder of real data; without it their cases do not run.
    """
    cases = all_cases()
    if data is None:
        cases = {name: words for name, words in cases.items() if not name.startswith("real/")}
    chosen = [name for name in cases if re.search(pattern, name)]
    needed = with_needed(chosen, cases)
    kept = {}
    home = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        copy_inputs(Path(), data)
        for name, words in cases.items():
            if name in needed:
                case = run_case(name, words)
                if name in chosen:
                    kept[name] = case
        os.chdir(home)
    return kept


def run_case(name: str, words: list[str]) -> dict[str, Any]:
    """Run a case in the working folder; return its exit status, and what is kept of its files and text."""
    began = time.monotonic()
    before = modification_times()
    out, errors = io.StringIO(), io.StringIO()
    with (
        warnings.catch_warnings(),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(errors),
    ):
        warnings.simplefilter("ignore")
        kept = run_command(words) if words else run_api(name)
    if kept.get("exit") not in FINE:
        print(f"  {errors.getvalue().strip()[-300:]}", file=sys.stderr)
    written = [
        path for path, changed in modification_times().items() if before.get(path) != changed
    ]
    files = {
        str(path): file_content(path)
        for path in sorted(written)
        if path.suffix in KEPT and path.name != "made.json"
    }
    kept["files"] = files
    if words and words[0] not in SILENT:
        kept["text"] = text_numbers(out.getvalue())
    seconds = time.monotonic() - began
    status = kept.get("exit", "-")
    print(f"{name}: exit {status}, {seconds:.1f} s {verdicts(files)}", file=sys.stderr, flush=True)
    return kept


def run_command(words: list[str]) -> dict[str, Any]:
    """Run a command of calib; return its exit status."""
    from calib.__main__ import main as calib_main

    sys.argv = ["calib", *words]
    try:
        calib_main()
    except SystemExit as stopped:
        return {"exit": int(stopped.code or 0)}
    return {}


def run_api(name: str) -> dict[str, Any]:
    """Run a case of the API; return its figures."""
    try:
        return API[name]()
    except Exception as error:  # noqa: BLE001  a difference like any other
        return {"exit": f"{type(error).__name__}: {error}"}


def modification_times() -> dict[Path, int]:
    """Return the times of the last changes of all files in the working folder [ns]."""
    return {path: path.stat().st_mtime_ns for path in Path().rglob("*") if path.is_file()}


def verdicts(files: Mapping[str, Any]) -> str:
    """Return the verdicts of the results among files."""
    tables = [file.get("verdict") for file in files.values() if isinstance(file, dict)]
    return ", ".join(table["use"] for table in tables if isinstance(table, dict))


# Comparison


def differences(first: Kept, second: Kept, *, ignore_text: bool) -> Iterator[str]:
    """Yield every difference between two runs."""
    cases = all_cases()
    for name in sorted(first.keys() | second.keys()):
        if name not in first or name not in second:
            yield f"{name}: only in the {'second' if name in second else 'first'}"
            continue
        comparison = replace(comparison_of(name, cases), ignore_text=ignore_text)
        yield from comparison.differences(name, first[name], second[name])


def comparison_of(name: str, cases: Mapping[str, list[str]]) -> Comparison:
    """Return how a case is compared: loosely if it, or one whose files it reads, maximises a likelihood."""
    for needed in with_needed([name], cases):
        words = cases[needed]
        if not words or words[0] in LIKELIHOOD:
            return LOOSE
    return STRICT


def renamed(kept: Kept, names: Sequence[tuple[str, str]]) -> Kept:
    """Return a run with other words in keys and short texts; names of cases and files stay."""
    cases = {}
    for name, case in kept.items():
        files = {file: rename(content, names) for file, content in case["files"].items()}
        cases[name] = {**rename({**case, "files": {}}, names), "files": files}
    return cases


def read_run(path: Path) -> Kept:
    """Return a stored run."""
    kept: Kept = json.loads(path.read_text(encoding="utf-8"))
    return kept


def write_run(kept: Kept, path: Path) -> None:
    """Store a run, a case a line."""
    lines = []
    for name, case in kept.items():
        lines.append(f"{json.dumps(name)}: {json.dumps(case, separators=(',', ':'))}")
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


# Command line


def old_and_new(text: str) -> tuple[str, str]:
    """Return the two words of ``OLD=NEW``."""
    old, equals, new = text.partition("=")
    if not (old and equals and new):
        raise argparse.ArgumentTypeError(f"'{text}' is not OLD=NEW")
    return old, new


def parse_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        fromfile_prefix_chars="@",
    )
    add = parser.add_argument
    add("-o", "--output", type=Path, help="JSON file for the numbers")
    add("--data", type=Path, help="folder of real data; without it their cases do not run")
    add("--only", default="", help="regular expression: cases whose name has it")
    add("--against", type=Path, help="stored run to compare with; only cases that ran count")
    add("--compare", type=Path, nargs=2, help="compare two stored runs, and run nothing")
    add("--ignore-text", action="store_true", help="compare files alone, not what was printed")
    add("--ignore-new", action="store_true", help="what only the second run has is no difference")
    add(
        "--renamed",
        type=old_and_new,
        action="append",
        default=[],
        metavar="OLD=NEW",
        help="word of the first run's keys and short texts that is another in the second; repeatable",
    )
    add("--list", action="store_true", help="name the cases")
    return parser.parse_args()


def main() -> None:
    """Run, store and compare."""
    arguments = parse_arguments()
    if arguments.list:
        for name, words in all_cases().items():
            print(f"{name}: {' '.join(words)}")
        return
    if arguments.compare:
        first, second = (read_run(path) for path in arguments.compare)
    else:
        second = run(arguments.only, arguments.data.resolve() if arguments.data else None)
        if arguments.output:
            write_run(second, arguments.output)
        if not arguments.against:
            return
        stored = read_run(arguments.against)
        first = {name: case for name, case in stored.items() if name in second}
    first = renamed(first, arguments.renamed)
    lines = list(differences(first, second, ignore_text=arguments.ignore_text))
    if arguments.ignore_new:
        lines = [line for line in lines if not line.endswith(": only in the second")]
    print("\n".join([*lines, f"{len(lines)} differences in {len(second)} cases"]))
    sys.exit(1 if lines else 0)


if __name__ == "__main__":
    main()
