"""Run a calib command and tell where its time goes: python scripts/benchmark_stages.py STAGES.json calibrate ur3 ...

Time counts for the outermost of the functions below that runs; imports count as imports, whoever asks for them. What
none of them accounts for is `other`. Work of other processes counts for the function that waits for it.
"""

from __future__ import annotations

import importlib._bootstrap as bootstrap
import json
import resource
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any

#: Functions of each stage, as module and name.
STAGES: Mapping[str, tuple[tuple[str, str], ...]] = {
    "reading": (
        ("calib.cli.loading", "load"),
        ("calib.cli.loading", "load_with_data"),
    ),
    "mistakes": (
        ("calib.diagnosis.usual_mistakes", "find_usual_mistake"),
        ("calib.diagnosis.picture_mistakes", "mistakes_of_pictures"),
        ("calib.diagnosis.camera_changes", "changes_between_pictures"),
    ),
    "choosing": (("calib.fit.selection.selection", "select"),),
    "fitting": (
        ("calib.fit.estimate.fitting", "fit"),
        ("calib.fit.selection.row_weights", "with_better_weights"),
    ),
    "validating": (
        ("calib.fit.selection.cross_validation", "cross_validation"),
        ("calib.fit.selection.cross_validation", "nominal_cross_validation"),
    ),
    "result": (("calib.result.calibrate", "_assemble"),),
    "verdict": (("calib.result.collected_evidence", "add_verdicts"),),
    "planning": (("calib.verbs.plan.plan", "plan"),),
    "corners": (("calib.boards.detection.detect", "detect"),),
    "robots": (("calib.verbs.fleet.fleet", "run_fleet"),),
    "writing": (
        ("calib.result.calibration", "Calibration.write_urdf"),
        ("calib.result.calibration", "Calibration.write_json"),
        ("calib.result.calibration", "Calibration.write_report"),
        ("calib.result.calibration", "Calibration.summary"),
        ("calib.verbs.calibrate.report", "write_report"),
        ("calib.verbs.calibrate.write_urdf", "write_urdf"),
        ("calib.basics.files", "write_atomically"),
    ),
}

#: The stage of imports, and that of what no stage accounts for.
IMPORTS, OTHER = "imports", "other"


class Clock:
    """Seconds of each stage; one runs at a time."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.stage = OTHER
        self._began = time.perf_counter()

    def turn_to(self, stage: str) -> None:
        """End the stage that runs, and begin another."""
        now = time.perf_counter()
        self.seconds[self.stage] = self.seconds.get(self.stage, 0.0) + now - self._began
        self.stage, self._began = stage, now

    @contextmanager
    def stage_of(self, stage: str) -> Iterator[None]:
        """Count a block as a stage."""
        before = self.stage
        self.turn_to(stage)
        try:
            yield
        finally:
            self.turn_to(before)

    def timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose time counts for a stage, unless another one has called it."""

        @wraps(function)
        def run(*arguments: object, **named: object) -> object:
            if self.stage != OTHER:
                return function(*arguments, **named)
            with self.stage_of(stage):
                return function(*arguments, **named)

        return run


def time_module(clock: Clock, module: ModuleType) -> None:
    """Put timed functions in the place of those of a module, before another module can take them from there."""
    for stage, functions in STAGES.items():
        for name, path in functions:
            if name == module.__name__:
                *outer, last = path.split(".")
                owner: Any = module
                for part in outer:
                    owner = getattr(owner, part)
                setattr(owner, last, clock.timed(stage, getattr(owner, last)))


def watch_imports(clock: Clock) -> None:
    """Count imports from now on, and time the functions of `STAGES` as soon as their module is there."""
    find_and_load = bootstrap._find_and_load  # type: ignore[attr-defined]
    modules = {module for functions in STAGES.values() for module, _ in functions}
    seen: set[str] = set()

    def watched(name: str, import_: object) -> object:
        if clock.stage == IMPORTS:
            module = find_and_load(name, import_)
        else:
            with clock.stage_of(IMPORTS):
                module = find_and_load(name, import_)
        if name in modules and name not in seen:
            seen.add(name)
            time_module(clock, sys.modules[name])
        return module

    bootstrap._find_and_load = watched  # type: ignore[attr-defined]


def peak_memory() -> float:
    """Return the most memory that this process has taken [MB]: `ru_maxrss` may be that of the one that started it."""
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> None:
    """Run the command, and write its most memory and the seconds of its stages."""
    output, *arguments = sys.argv[1:]
    sys.argv = ["calib", *arguments]
    clock = Clock()
    watch_imports(clock)
    try:
        from calib.__main__ import main as calib

        calib()
    finally:
        clock.turn_to(OTHER)
        figures = {"megabytes": peak_memory(), "stages": clock.seconds}
        Path(output).write_text(json.dumps(figures), encoding="utf-8")


if __name__ == "__main__":
    main()
