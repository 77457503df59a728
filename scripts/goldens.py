"""Run calib's commands on small data, keep the numbers that come out, and compare them with those of another run.

python scripts/goldens.py -o new.json [--data FOLDER] [--only PATTERN] [--against old.json] [--ignore-text]
python scripts/goldens.py --compare old.json new.json [--ignore-text]
python scripts/goldens.py --list

The calib that runs is the one that Python imports, so PYTHONPATH chooses the checkout. Numbers come from the files
that a command writes (result JSON, tables, URDFs by their forward kinematics) and, as `text`, from what it prints.
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
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from goldens_inputs import CASES, prepare
from goldens_numbers import KEPT, LOOSE, STRICT, content, differences, lines, tidy

TEXT_VERBS = {
    "demo",
    "inspect",
    "evaluate",
    "compare",
    "workspace",
    "plan",
    "compensate",
    "convert",
    "base-frame",
    "simulate",
}


# The cases


def api_calibrate() -> dict[str, Any]:
    """From a URDF and a table to errors, parameters and predictions, all in memory."""
    import calib

    robot = calib.Robot.load("robot.urdf", base="base", tip="tool0")
    table_ = calib.Measurements.read("data.csv", robot.joint_names)
    result = calib.calibrate(robot, table_, cell=calib.Cell(estimate_frame=True, model="dh"))
    result.write_json("api.json")
    result.write_urdf("api.urdf")
    return {
        "predicted": tidy(
            np.asarray(result.predict(np.tile(np.linspace(-1, 1, 7)[:, None], 6))).tolist()
        )
    }


def api_survey() -> dict[str, Any]:
    """A base frame from sweeps."""
    import calib
    from calib.circle_points.sweeps import read_sweeps

    survey = calib.base_frame(
        read_sweeps("sweeps.csv"), calib.Robot.load("robot.urdf", base="base", tip="tool0")
    )
    return {"frame": tidy(np.asarray(survey.frame.T_tracker_base).tolist())}


def api_workspace() -> dict[str, Any]:
    """Samples of the workspace and their densest part."""
    import calib
    from calib.regions.region import Density

    robot = calib.Robot.load("robot.urdf", base="base", tip="tool0")
    points = calib.workspace(robot, [-0.07, 0.07, 0.022], count=2**13)
    return {
        "volume": Density.of(points).region(0.9).volume,
        "points": tidy(np.asarray(points).tolist()),
    }


API: dict[str, Callable[[], dict[str, Any]]] = {
    "api/calibrate": api_calibrate,
    "api/survey": api_survey,
    "api/workspace": api_workspace,
}


def all_cases() -> dict[str, list[str]]:
    """The words of every command, by the name of its case; those of the API have none."""
    text = CASES.read_text(encoding="utf-8").split("\n# Files\n")[0]
    pairs = (line.split(": ", 1) for line in text.splitlines() if line and not line.startswith("#"))
    return {name: shlex.split(words) for name, words in pairs} | {name: [] for name in API}


def needed(wanted: list[str], cases: dict[str, list[str]]) -> set[str]:
    """The cases that are wanted, and those before them whose files they read."""
    chosen = set(wanted)
    for name in reversed(cases):
        if name in chosen:
            chosen |= {other for other in cases if makes(cases[other], cases[name])}
    return chosen


def makes(words: list[str], reader: list[str]) -> bool:
    """Whether a command writes a file that another one reads."""
    written = {
        f
        for option, f in itertools.pairwise(words)
        if option in ("-o", "--json", "--truth", "--truth-urdf", "--cell-out")
    }
    own = {f for option, f in itertools.pairwise(reader) if option in ("-o", "--json")}
    return words is not reader and any(
        f in w.split("/")[0].split(":=") for f in written - own for w in reader
    )


def run_one(name: str, words: list[str]) -> dict[str, Any]:
    """Run a case in this folder; its exit code, what it wrote, and the numbers that it printed."""
    before = {p: p.stat().st_mtime_ns for p in Path().rglob("*") if p.is_file()}
    done: dict[str, Any] = {}
    out, errors = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(errors),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        if words:
            from calib.cli import main

            sys.argv = ["calib", *words]
            try:
                main()
            except SystemExit as stopped:
                done["exit"] = int(stopped.code or 0)
        else:
            try:
                done.update(API[name]())
            except Exception as error:  # noqa: BLE001  a difference like any other
                done["exit"] = f"{type(error).__name__}: {error}"
    if done.get("exit") not in (None, 0, 3):
        print(f"  {errors.getvalue().strip()[-300:]}", file=sys.stderr)
    made = sorted(
        p for p in Path().rglob("*") if p.is_file() and p.stat().st_mtime_ns != before.get(p)
    )
    done["files"] = {str(p): content(p) for p in made if p.suffix in KEPT and p.name != "made.json"}
    if words and words[0] in TEXT_VERBS:
        done["text"] = lines(out.getvalue())
    return done


def run(pattern: str, data: Path | None) -> dict[str, Any]:
    """Run the cases whose name matches, and keep what they leave."""
    cases = all_cases()
    cases = {n: w for n, w in cases.items() if data or not n.startswith("real/")}
    wanted = [n for n in cases if re.search(pattern, n)]
    todo = needed(wanted, cases)
    found: dict[str, Any] = {}
    home = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        prepare(Path(), data)
        for name in (n for n in cases if n in todo):
            began = time.monotonic()
            done = run_one(name, cases[name])
            if name in wanted:
                found[name] = done
            took = time.monotonic() - began
            print(
                f"{name}: exit {done.get('exit', '-')}, {took:.1f} s {verdicts(done)}",
                file=sys.stderr,
                flush=True,
            )
        os.chdir(home)
    return found


def verdicts(done: dict[str, Any]) -> str:
    """The verdicts of the results that a case wrote."""
    tables = [v.get("verdict") for v in done["files"].values() if isinstance(v, dict)]
    return ", ".join(t["use"] for t in tables if isinstance(t, dict))


def compare(first: dict[str, Any], second: dict[str, Any], ignore_text: bool) -> list[str]:
    """Every difference between two runs."""
    cases, found = all_cases(), []
    for name in sorted(first.keys() | second.keys()):
        if name not in first or name not in second:
            found.append(f"{name}: only in the {'second' if name in second else 'first'}")
            continue
        chain = needed([name], cases)
        likely = (
            any(
                cases[n][:1] in (["fit"], ["demo"], ["fleet"]) or "--study" in cases[n]
                for n in chain
            )
            or name in API
        )
        found += differences(
            name, first[name], second[name], LOOSE if likely else STRICT, ignore_text
        )
    return found


def main() -> None:
    """Read the command line, run, write, compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, help="JSON file for the numbers")
    parser.add_argument(
        "--data", type=Path, help="folder of real data; without it their cases are left out"
    )
    parser.add_argument("--only", default="", help="regular expression: cases whose name has it")
    parser.add_argument(
        "--against",
        type=Path,
        help="compare the run with this one; cases that did not run are left out",
    )
    parser.add_argument(
        "--compare", type=Path, nargs=2, help="compare two runs that were stored, and run nothing"
    )
    parser.add_argument(
        "--ignore-text", action="store_true", help="compare files alone, not what was printed"
    )
    parser.add_argument(
        "--ignore-new",
        action="store_true",
        help="keys and files that only the second run has are no difference",
    )
    parser.add_argument("--list", action="store_true", help="name the cases")
    asked = parser.parse_args()
    if asked.list:
        print("\n".join(f"{name}: {' '.join(words)}" for name, words in all_cases().items()))
        return
    if asked.compare:
        first, second = (json.loads(p.read_text(encoding="utf-8")) for p in asked.compare)
    else:
        second = run(asked.only, asked.data.resolve() if asked.data else None)
        if asked.output:
            body = ",\n".join(
                f"{json.dumps(k)}: {json.dumps(v, separators=(',', ':'))}"
                for k, v in second.items()
            )
            asked.output.write_text("{\n" + body + "\n}\n", encoding="utf-8")
        if not asked.against:
            return
        first = {
            k: v
            for k, v in json.loads(asked.against.read_text(encoding="utf-8")).items()
            if k in second
        }
    found = compare(first, second, asked.ignore_text)
    if asked.ignore_new:
        found = [line for line in found if not line.endswith(": only in the second")]
    print("\n".join([*found, f"{len(found)} differences in {len(second)} cases"]))
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
