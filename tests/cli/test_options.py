"""Errors on the command line: one line on stderr, the exit status, the trace for those who ask."""

from __future__ import annotations

import pytest
import typer
from typer.testing import CliRunner

from calib.cli.exit_status import ExitStatus
from calib.cli.options import FitOptions, Robust, TableOptions, Verb, reporting, verb
from calib.errors import FileError, VerdictError

FAULT = "calib: a fault of calib itself: IndexError: list index out of range. Report it with what --debug shows.\n"


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


@verb("What it does.")
def shown(robot: str, setup: FitOptions, table: TableOptions, robust: Robust = True) -> None:
    typer.echo(
        (robot, setup.tip, setup.hold, setup.fix_target, setup.repeats, table.points_unit, robust)
    )
    if robot == "none":
        raise FileError("none is not there.")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["a"], 0, "('a', None, None, False, None, None, True)"),
        (
            [
                "b",
                "--tip",
                "t",
                "--hold",
                "j=1 m",
                "--hold",
                "k=2 m",
                "--fix-target",
                "--no-robust",
            ],
            0,
            "('b', 't', ['j=1 m', 'k=2 m'], True, None, None, False)",
        ),
        (["c", "--points-unit", "mm", "--repeats", "average"], 0, "'average', 'mm', True)"),
        (["none"], 1, "calib: none is not there."),
        (
            ["a", "--repeats", "best"],
            2,
            "'best' is not one of 'weighted', 'average', 'independent'.",
        ),
        (["a", "--priors", "best"], 2, "'best' is not one of 'data', 'given', 'off'."),
        (["--help"], 0, "What it does."),
        (["a", "--tip", "t", "--tip", "u"], 2, "Option '--tip' is given 2 times. Give it once."),
        (["a", "--tip=t", "b", "--tip=t"], 2, "Option '--tip' is given 2 times."),
        (["a", "--robust", "--no-robust"], 2, "'--robust/--no-robust' is given 2 times."),
        (["a", "--fix-target", "--fix-target"], 0, "('a', None, None, True, None, None, True)"),
    ],
)
def test_classes_of_options_stand_for_their_fields(words, code, said):
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(cls=Verb)(shown)
    done = CliRunner().invoke(app, words)
    assert done.exit_code == code
    assert said in " ".join(done.output.split())
