"""The benchmark: its stages are functions of calib, its tables those of the page, and no part is slower than there."""

from __future__ import annotations

import importlib
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

import benchmark_page
from benchmark_commands import COMMANDS
from benchmark_ratios import LIMIT, PARTS, Ratio, _slowed, reference, stated_ratios
from benchmark_stages import IMPORTS, OTHER, STAGES, Clock

PAGE = """
<!-- times -->

| command | time |
|---|---|
| one | 1 s |
| two | 2 s |

<!-- end of times -->
after
"""


@pytest.mark.parametrize("stage", STAGES)
def test_the_functions_of_a_stage_exist(stage: str):
    for module, path in STAGES[stage]:
        owner = importlib.import_module(module)
        for part in path.split("."):
            owner = getattr(owner, part)
        assert callable(owner)


def test_time_counts_for_the_outermost_stage():
    clock = Clock()
    inner = clock.timed("inner", lambda: clock.stage)
    outer = clock.timed("outer", inner)
    assert outer() == "outer"
    assert inner() == "inner"
    assert clock.stage == OTHER
    with clock.stage_of(IMPORTS):
        assert inner() == IMPORTS
    assert set(clock.seconds) == {OTHER, IMPORTS, "inner", "outer"}


def test_a_row_that_is_not_measured_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    monkeypatch.setattr(benchmark_page, "PAGE", page)
    rows = [["two", "3 s"], ["three", "4 s"]]
    benchmark_page.write_table("times", ["command", "time"], rows, keep=True)
    assert benchmark_page.cells_of("times") == [["one", "1 s"], ["two", "3 s"], ["three", "4 s"]]
    assert page.read_text().endswith("<!-- end of times -->\nafter\n")
    benchmark_page.write_table("times", ["command", "time"], rows, keep=False)
    assert benchmark_page.cells_of("times") == rows
    # Rows of other columns are not those of this table.
    titles = ["command", "time", "memory"]
    benchmark_page.write_table("times", titles, [["one", "1 s", "2 MB"]], keep=True)
    assert benchmark_page.cells_of("times") == [["one", "1 s", "2 MB"]]


def test_the_page_has_every_part_and_command():
    assert set(stated_ratios()) == set(PARTS)
    rows = {row[0] for row in benchmark_page.cells_of("commands")}
    assert rows <= {*COMMANDS, '`python -c "import calib"`'}


@pytest.mark.slow
def test_what_is_slower_by_a_quarter_is_noticed():
    for factor in (1.0, 1.25):
        ratio = Ratio.of(partial(_slowed, reference, factor))
        ratio.measure()
        ratio.measure()
        assert (ratio.value > LIMIT) == (factor > LIMIT)


@pytest.mark.slow
@pytest.mark.skipif("coverage" in sys.modules, reason="what counts lines slows calib down")
def test_no_part_is_slower_by_a_fifth_than_the_page_says():
    """If the change is meant: scripts/benchmark.py --only ratios --write."""
    script = ROOT / "scripts" / "benchmark_ratios.py"
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
