"""Feed every reader of calib with files that were made wrong; see `fuzzing` for how.

    python scripts/fuzz.py --reader urdf --count 10000 --seed 0 --workers 2
    python scripts/fuzz.py --reader urdf --seed 0 --only 4711      one case again, in this process

Without ``--reader`` all of them. The bar: no exception but CalibError, none over 2 s of processor time or 500 MB.
What falls below it is written into ``--out``. The exit code is 1 if anything did.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from fuzzing import Reader, Tally, fuzzed, judged, mutated, saved

#: Each has a mapping READERS, by name.
_MODULES = ("fuzz_models", "fuzz_tables")


def readers() -> dict[str, Reader]:
    """All readers by name."""
    found: dict[str, Reader] = {}
    for name in _MODULES:
        if importlib.util.find_spec(name) is not None:
            found.update(importlib.import_module(name).READERS)
    return found


def main() -> int:
    """Run what the command line asks for."""
    known = readers()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--reader", action="append", choices=sorted(known), help="default all")
    parser.add_argument("--count", type=int, default=10_000, help="cases for each reader")
    parser.add_argument("--first", type=int, default=0, help="index of the first case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", type=int, help="run this case alone and print what happens")
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "calib-fuzz")
    asked = parser.parse_args()
    chosen = [known[name] for name in asked.reader or sorted(known)]
    if asked.only is not None:
        for reader in chosen:
            data = mutated(reader, asked.seed, asked.only)
            start = time.process_time()
            kind, text = judged(reader, data)
            print(f"{reader.name}: {kind} in {time.process_time() - start:.2f} s\n{text}")
        return 0
    print(f"{'reader':<20}{'cases':>8}{'accepted':>10}{'refused':>9}{'findings':>10}", end="")
    print(f"{'slowest [s]':>13}{'memory [MB]':>13}{'printed':>9}", flush=True)
    found = 0
    for reader in chosen:
        indices = range(asked.first, asked.first + asked.count)
        tally = fuzzed(reader, indices, asked.seed, asked.workers, _shown(reader.name))
        saved(reader, asked.seed, tally, asked.out)
        found += len(tally.findings)
        print(f"{reader.name:<20}{tally.cases:>8}{tally.accepted:>10}{tally.refused:>9}", end="")
        print(
            f"{len(tally.findings):>10}{tally.slowest[0]:>13.2f}{tally.memory / 1e6:>13.0f}", end=""
        )
        print(f"{len(tally.printed):>9}", flush=True)
        for text, count in Counter(_last_line(t) for t in tally.findings.values()).most_common(20):
            first = next(i for i, t in tally.findings.items() if _last_line(t) == text)
            print(f"    {count} x {text[:150]} (case {first})", flush=True)
    if found:
        print(f"The findings are in {asked.out}.")
    return int(found > 0)


def _last_line(text: str) -> str:
    """What an exception says of itself."""
    return text.strip().splitlines()[-1]


def _shown(name: str) -> Callable[[Tally], None]:
    """A function that prints how far a reader is, to a terminal only."""

    def show(tally: Tally) -> None:
        if sys.stderr.isatty():
            text = f"\r{name}: {tally.cases} cases, {len(tally.findings)} findings "
            print(text, end="", file=sys.stderr, flush=True)

    return show


if __name__ == "__main__":
    sys.exit(main())
