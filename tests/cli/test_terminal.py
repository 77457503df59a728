"""Colours on a terminal, and not one escape code anywhere else."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys

import pytest

from calib.basics.progress import watching
from calib.cli.terminal import Pace, progress_bar, say, styled
from calib.show.lines import fill

TEXT = """Verdict: use with care
  Few rows.

Position error [mm]               rows       max
Length error [mm]                 rows       max
estimation rows, nominal            30     4.099

1  Accuracy
-----------

Table 1: Errors [mm]
rows  max
---------
30    4.1
Outliers: none. [bold]no mark-up[/bold] :smile: 'x'"""


def on_a_terminal(code: str, *words: str, **surroundings: str) -> str:
    """What a terminal gets of a program's stdout and stderr."""
    terminal, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", code, *words],
        stdout=theirs,
        stderr=theirs,
        env={
            **{k: v for k, v in os.environ.items() if k != "NO_COLOR"},
            "TERM": "xterm",
            **surroundings,
        },
    )
    os.close(theirs)
    seen = b""
    while True:
        try:
            piece = os.read(terminal, 65536)
        except OSError:  # the other side has closed
            break
        if not piece:
            break
        seen += piece
    os.close(terminal)
    assert process.wait(30) == 0
    return seen.decode().replace("\r\n", "\n")


SAY = "import sys; from calib.cli.terminal import say; say(sys.argv[1])"

PROGRESS = """
from calib.cli.terminal import progress_bar, stages_bar
with progress_bar("Fitting", quiet=QUIET) as advance:
    if advance:
        [advance(k, 3) for k in range(4)]
with stages_bar(quiet=QUIET) as advance:
    if advance:
        [advance(what, k, 2) for what in ("Choosing poses", "Forecasting") for k in range(3)]
"""


def test_verdict_and_headings_stand_out():
    styles = dict(styled(TEXT))
    assert styles == {
        **dict.fromkeys(TEXT.split("\n"), ""),
        "Verdict: use with care": "bold yellow",
        "Position error [mm]               rows       max": "bold",
        "Length error [mm]                 rows       max": "bold",
        "1  Accuracy": "bold",
        "-----------": "dim",
        "Table 1: Errors [mm]": "bold",
        "rows  max": "bold",
        "---------": "dim",
    }
    assert "\n".join(line for line, _ in styled(TEXT)) == TEXT


def test_a_terminal_gets_colours_and_the_same_text():
    seen = on_a_terminal(SAY, TEXT, COLUMNS="30")  # narrower than the text: nothing is broken
    assert "\x1b[1;33mVerdict: use with care\x1b[0m" in seen
    assert "\x1b[1m1  Accuracy\x1b[0m" in seen
    assert re.sub(r"\x1b\[[0-9;]*m", "", seen) == TEXT + "\n"
    # no_color leaves bold, and a dumb terminal gets nothing.
    assert "33m" not in on_a_terminal(SAY, TEXT, NO_COLOR="1")
    assert on_a_terminal(SAY, TEXT, TERM="dumb") == TEXT + "\n"


def test_codes_in_names_do_not_reach_a_terminal():
    assert list(styled("from \x1b[31mred\x9b1m.csv")) == [("from \\x1b[31mred\\x9b1m.csv", "")]


def test_elsewhere_the_text_is_printed_as_it_is(capsys):
    say(TEXT)
    assert capsys.readouterr().out == TEXT + "\n"


@pytest.mark.slow
def test_a_bar_for_each_stage():
    seen = on_a_terminal(PROGRESS.replace("QUIET", "False"))
    for what in ("Fitting", "Choosing poses", "Forecasting"):
        assert what in seen
    assert "100%" in seen
    assert on_a_terminal(PROGRESS.replace("QUIET", "True")) == ""


WORKING = """
import time
from calib.basics.progress import Stage, begin, counted, trying
from calib.cli.terminal import work_line
with work_line(quiet=QUIET):
    begin(Stage.MODELS); trying("dh"); trying("dh+gain [x]"); time.sleep(0.3)
    begin(Stage.FOLDS); counted(0, 3); time.sleep(0.2); counted(1, 3); time.sleep(0.3)
    begin(Stage.VERDICT)
"""


@pytest.mark.slow
def test_a_line_says_what_is_done():
    seen = on_a_terminal(WORKING.replace("QUIET", "False"), COLUMNS="100")
    line = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", seen)
    for words in ("models", "2: dh+gain [x]", "cross-validation", "stage: 0 s left | ", "so far"):
        assert words in line
    assert "residuals and verdict" in line
    models, folds = line.split("cross-validation", 1)
    assert "left" not in models  # the number of models is not known
    assert "dh+gain" not in folds
    assert on_a_terminal(WORKING.replace("QUIET", "True")) == ""


LONG = """
import time
from calib.basics.progress import Stage, begin, counted, trying
from calib.cli.terminal import work_line
with work_line(quiet=False):
    begin(Stage.READING); trying("table\\x1b[31m.csv"); time.sleep(0.2)
    begin(Stage.MODELS); trying("placement+gain+eccentricity+compliance+gravity"); time.sleep(0.2)
    begin(Stage.FOLDS); counted(0, 60); time.sleep(0.1); counted(1, 60); time.sleep(0.2)
"""


@pytest.mark.slow
@pytest.mark.parametrize("columns", [50, 80, 120])
@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_it_is_one_line_in_any_terminal(columns, encoding):
    seen = on_a_terminal(LONG, COLUMNS=str(columns), PYTHONIOENCODING=encoding)
    assert seen.count("\n") == 1  # at its end, where it is taken away
    assert seen.isascii() == (encoding == "ascii")
    lines = re.split(r"[\r\n]+", re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", seen))
    assert max(map(len, lines)) <= columns
    for shown in (
        r"reading .* table\\x1b\[31m\.csv \d s",
        r"models .* 1: placement.* \d s",
        r"cross-validation .* stage: \d+ s left \| \d s",
    ):
        assert any(re.search(shown, line) for line in lines), shown


def test_pace():
    pace = Pace(100.0)
    assert pace.left(110.0) is None
    pace.count(0, 4, 110.0)  # what precedes the first part does not count
    assert pace.left(111.0) is None
    pace.count(1, 4, 112.0)
    assert pace.left(112.0) == 6.0
    assert pace.left(113.0) == 5.0
    assert pace.left(120.0) == 0.0
    pace.count(2, 4, 120.0)
    assert pace.left(120.0) == 10.0


def test_lines_break_at_100_columns_and_not_within_names():
    name = "a-name-" * 20
    lines = fill(f"{'word ' * 30}{name}", "  ", "  ").splitlines()
    assert lines[-1] == f"    {name}"
    assert lines[0].startswith("  word")
    assert max(map(len, lines[:-1])) <= 100


MOVING = """
import time
from calib.cli.terminal import moving_bar
with moving_bar("Looking", quiet=QUIET):
    time.sleep(0.3)
"""


@pytest.mark.slow
def test_a_bar_of_work_without_an_amount():
    seen = on_a_terminal(MOVING.replace("QUIET", "False"))
    assert "Looking" in seen
    assert "%" not in seen.replace("  0%", "")
    assert on_a_terminal(MOVING.replace("QUIET", "True")) == ""


def test_who_watches_hears_of_a_bar_s_work():
    heard = []
    with (
        watching(lambda *said: heard.append(said)),
        progress_bar("pictures", quiet=True) as progress,
    ):
        progress(1, 3)
    assert heard == [(None, "", 1, 3)]
