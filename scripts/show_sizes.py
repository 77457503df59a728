"""Seconds and bytes of every figure, the report and the page of every hard case, and which take too much.

    python scripts/show_sizes.py [CASE ...] [--kind png] [--rows 100000] [--keep FOLDER]

A figure is to take less than 2 s and 300 kB, the report 10 s and 3 MB, the page 10 s and 7 MB.

The cases are those of the tests, `tests/show/calibrations.py`; ``many_rows`` has 100,000 rows here.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType

from calib.identify.result import Calibration
from calib.show.figures import KINDS, drawings, rendered
from calib.show.pictures import write_page
from calib.show.report import report_bytes

_CASES = Path(__file__).resolve().parents[1] / "tests" / "show" / "calibrations.py"


@dataclass(frozen=True, slots=True)
class Thing:
    """What is measured.

    Attributes:
        name: Of its file.
        make: Makes its bytes.
        seconds: What it may take [s].
        most: What it may take [bytes].
    """

    name: str
    make: Callable[[], bytes]
    seconds: float
    most: int


def main() -> int:
    """Print a line for each figure and a sum for each case; 1 if any is too slow or too large."""
    cases = _cases()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", nargs="*", help=f"of {', '.join(cases.CASES)}; default all")
    parser.add_argument("--kind", choices=KINDS, default="png")
    parser.add_argument("--rows", type=int, default=100_000, help="of the case many_rows")
    parser.add_argument("--keep", type=Path, help="folder to write the figures to")
    options = parser.parse_args()
    unknown = set(options.case) - set(cases.CASES)
    if unknown:
        parser.error(f"no such case: {', '.join(sorted(unknown))}")
    bad = 0
    for name in options.case or cases.CASES:
        found = cases.many_rows(options.rows) if name == "many_rows" else cases.made(name)
        print(f"{name}: {len(found.measurements):,} rows, {len(found.parameters)} parameters")
        seconds, size = 0.0, 0
        for thing in things(found, options.kind):
            began = time.perf_counter()
            data = thing.make()
            took = time.perf_counter() - began
            over = took > thing.seconds or len(data) > thing.most
            bad += over
            seconds, size = seconds + took, size + len(data)
            print(_line(thing.name, took, len(data)) + ("  <-- too much" if over else ""))
            if options.keep is not None:
                folder = options.keep / name
                folder.mkdir(parents=True, exist_ok=True)
                (folder / thing.name).write_bytes(data)
        print(_line("all", seconds, size))
    return 1 if bad else 0


def things(found: Calibration, kind: str) -> Iterator[Thing]:
    """What is measured of a calibration."""
    for drawing in drawings(found):
        yield Thing(f"{drawing.name}.{kind}", partial(rendered, drawing, kind), 2.0, 300_000)
    yield Thing("report.html", partial(report_bytes, found, ".html"), 10.0, 3_000_000)
    yield Thing("view.html", partial(_page, found), 10.0, 7_000_000)


def _page(found: Calibration) -> bytes:
    """The page of both robots."""
    with tempfile.TemporaryDirectory() as folder:
        return write_page(found, Path(folder) / "view.html").read_bytes()


def _line(label: str, seconds: float, size: int) -> str:
    """One line of the table."""
    return f"  {label:<34}{seconds:>8.2f} s{size / 1e3:>10.0f} kB"


def _cases() -> ModuleType:
    """The tests' module of hard cases."""
    spec = importlib.util.spec_from_file_location("calibrations", _CASES)
    if spec is None or spec.loader is None:
        message = f"{_CASES} cannot be loaded."
        raise ImportError(message)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


if __name__ == "__main__":
    sys.exit(main())
