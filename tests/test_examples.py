"""The programs of scripts/examples/: short, shown with their output in docs/examples.md, and run in an empty folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.places import ROOT

EXAMPLES = ROOT / "scripts" / "examples"
PROGRAMS = sorted(path.name for path in EXAMPLES.glob("*.py"))
PAGE = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")

#: A program has fewer lines than this, docstring and blank lines included.
LINES = 60

#: A section of the page: its program, and what that prints.
SECTION = re.compile(
    r"^```\{literalinclude\} \.\./scripts/examples/(\S+)\n.*?^```text\n(.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
NUMBER = re.compile(r"-?\d+(?:\.(\d+))?")

#: Figures differ a little between processors: by this share, or by one in the last digit that is shown.
SHARE = 0.02


def test_they_are_numbered_from_one():
    assert [int(name[:2]) for name in PROGRAMS] == list(range(1, 12))


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_is_short_and_asserts_something(name: str):
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    assert text.count("\n") < LINES
    assert re.search(r"^ *assert ", text, re.MULTILINE)
    assert "sys.argv" not in text


def test_the_page_shows_every_program_in_order_with_a_link():
    assert [program for program, _ in SECTION.findall(PAGE)] == PROGRAMS
    for name in PROGRAMS:
        assert f"[{name}](../scripts/examples/{name})" in PAGE
    assert "examples" in (ROOT / "docs" / "index.rst").read_text(encoding="utf-8").split()


def wrong_lines(shown: str, printed: str) -> list[str]:
    """The printed lines that differ from the page's in their words, or in a figure by more than `SHARE`."""
    lines, expected = printed.splitlines(), shown.splitlines()
    assert len(lines) == len(expected), printed
    return [line for line, other in zip(lines, expected, strict=True) if not alike(line, other)]


def alike(line: str, expected: str) -> bool:
    words, expected_words = (NUMBER.sub("#", text).split() for text in (line, expected))
    if words != expected_words:
        return False
    for found, wanted in zip(NUMBER.finditer(line), NUMBER.finditer(expected), strict=True):
        last_digit = 10.0 ** -len(wanted[1] or "")
        value = float(wanted[0])
        if abs(float(found[0]) - value) > max(SHARE * abs(value), 1.01 * last_digit):
            return False
    return True


def test_lines_with_other_words_or_figures_are_seen():
    assert not wrong_lines("a: 0.052 mm\n", "a: 0.053 mm\n")
    assert not wrong_lines("12.50 mm, row 3\n", "12.62 mm, row 3\n")
    assert wrong_lines("a: 0.052 mm\n", "a: 0.055 mm\n")
    assert wrong_lines("a: 0.052 mm\n", "b: 0.052 mm\n")


def files(folder: Path) -> dict[Path, int]:
    """The files below a folder with their times of change, but for Python's own."""
    return {
        path: path.stat().st_mtime_ns
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_runs_in_an_empty_folder_and_prints_what_the_page_shows(
    name: str, tmp_path: Path
):
    # What libraries keep for themselves goes into `caches`; a program has no business in the others.
    places = {place: tmp_path / place for place in ("work", "home", "temporary", "caches")}
    for place in places.values():
        place.mkdir()
    environment = {
        "HOME": places["home"],
        "TMPDIR": places["temporary"],
        "MPLCONFIGDIR": places["caches"],
        "DASK_CONFIG": places["caches"],
    }
    before = files(EXAMPLES)
    run = subprocess.run(
        [sys.executable, EXAMPLES / name],
        cwd=places["work"],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert not wrong_lines(dict(SECTION.findall(PAGE))[name], run.stdout)
    assert not files(places["home"])
    assert not files(places["temporary"])
    assert files(EXAMPLES) == before
    for file in re.findall(r"^written: ([\w.]+)", run.stdout, re.MULTILINE):
        assert (places["work"] / file).is_file()
