"""Progress on a terminal, and none anywhere else."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

import pytest

from calib.cli.progress import progress_bar, stages_bar

CODE = """
from calib.cli.progress import progress_bar, stages_bar
with progress_bar("Fitting", quiet=QUIET) as advance:
    if advance:
        [advance(k, 3) for k in range(4)]
with stages_bar(quiet=QUIET) as advance:
    if advance:
        [advance(what, k, 2) for what in ("Choosing poses", "Forecasting") for k in range(3)]
"""


def on_a_terminal(code: str) -> str:
    """What a program writes on stderr where that is a terminal."""
    terminal, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", code], stderr=theirs, env={**os.environ, "TERM": "xterm"}
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
    return seen.decode()


def test_a_bar_for_each_stage():
    seen = on_a_terminal(CODE.replace("QUIET", "False"))
    for what in ("Fitting", "Choosing poses", "Forecasting"):
        assert what in seen
    assert "100%" in seen


def test_whoever_wants_none_gets_none():
    assert on_a_terminal(CODE.replace("QUIET", "True")) == ""


@pytest.mark.parametrize("quiet", [False, True])
def test_nothing_is_drawn_where_there_is_no_terminal(capsys, quiet):
    with progress_bar("Fitting", quiet=quiet) as advance:
        assert advance is None
    with stages_bar(quiet=quiet) as advance:
        assert advance is None
    assert capsys.readouterr().err == ""
