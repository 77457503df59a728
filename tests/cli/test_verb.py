"""Errors on the command line: one line on stderr, the exit status, the trace for those who ask."""

from __future__ import annotations

import pytest
import typer

from calib.cli.exit_status import ExitStatus
from calib.cli.verb import reporting
from calib.errors import FileError, VerdictError

FAULT = "calib: an internal error: IndexError: list index out of range. Report it with what --debug shows.\n"


def test_a_fault_of_calib_is_one_line_and_how_to_report_it(capsys):
    with pytest.raises(typer.Exit) as ended, reporting(debug=False):
        [][0]
    assert ended.value.exit_code == 1
    assert capsys.readouterr().err == FAULT


def test_with_debug_a_fault_keeps_its_trace():
    with pytest.raises(IndexError), reporting(debug=True):
        [][0]


@pytest.mark.parametrize("debug", [False, True])
def test_what_a_user_can_mend_is_one_line_with_a_trace_before_it_if_asked(capsys, debug):
    with pytest.raises(typer.Exit) as ended, reporting(debug=debug):
        raise FileError("a.csv is not there.")
    said = capsys.readouterr().err
    assert ended.value.exit_code == 1
    assert said.endswith("calib: a.csv is not there.\n")
    assert ("Traceback" in said) == debug


def test_a_verdict_that_is_obeyed_has_an_exit_status_of_its_own(capsys):
    with pytest.raises(typer.Exit) as ended, reporting(debug=False):
        raise VerdictError("the verdict is against it.")
    assert ended.value.exit_code == ExitStatus.NOT_ACCEPTED
    assert capsys.readouterr().err == "calib: the verdict is against it.\n"
