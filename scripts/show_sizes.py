"""Seconds and bytes of every figure of every hard case: each is to take less than 2 s and 300 kB.

    python scripts/show_sizes.py [CASE ...] [--kind png] [--rows 100000] [--keep FOLDER]

The cases are those of the tests, `tests/show/calibrations.py`; ``many_rows`` has 100,000 rows here.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

from calib.identify.result import Calibration
from calib.show.figures import KINDS, drawings, rendered

_CASES = Path(__file__).resolve().parents[1] / "tests" / "show" / "calibrations.py"

#: What one figure may take [s], [bytes].
_SECONDS, _BYTES = 2.0, 300_000


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
        for label, make in things(found, options.kind):
            began = time.perf_counter()
            data = make()
            took = time.perf_counter() - began
            over = took > _SECONDS or len(data) > _BYTES
            bad += over
            seconds, size = seconds + took, size + len(data)
            print(_line(label, took, len(data)) + ("  <-- too much" if over else ""))
            if options.keep is not None:
                folder = options.keep / name
                folder.mkdir(parents=True, exist_ok=True)
                (folder / f"{label}.{options.kind}").write_bytes(data)
        print(_line("all", seconds, size))
    return 1 if bad else 0


def things(found: Calibration, kind: str) -> Iterator[tuple[str, Callable[[], bytes]]]:
    """What is measured of a calibration: names, and what makes the bytes."""
    for drawing in drawings(found):
        yield drawing.name, lambda drawing=drawing: rendered(drawing, kind)  # type: ignore[misc]


def _line(label: str, seconds: float, size: int) -> str:
    """One line of the table."""
    return f"  {label:<30}{seconds:>8.2f} s{size / 1e3:>10.0f} kB"


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
