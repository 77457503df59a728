"""Groups of options: each field is an option, and lists in help texts are those of the registries."""

from __future__ import annotations

import re

import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

from calib.cli.options import FitOptions, Robust, SolverOptions, TableOptions
from calib.cli.verb import Verb, verb
from calib.data import kinds
from calib.errors import FileError, ModelError
from calib.model.error_model import MODELS
from calib.model.families import joint_families
from calib.numerics.solvers import SOLVERS
from calib.program import app as program
from calib.verbs.convert.convert import FORMATS


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


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("calibrate", joint_families()),
        ("calibrate", kinds.names()),
        ("calibrate", tuple(SOLVERS)),
        ("calibrate", tuple(MODELS)),
        ("convert", tuple(FORMATS)),
    ],
)
def test_help_lists_what_is_registered(command: str, names: tuple[str, ...]):
    done = CliRunner().invoke(program, [command, "--help"])
    words = set(re.findall(r"[\w-]+", done.output))
    assert done.exit_code == 0
    assert set(names) <= words


def test_no_placeholder_is_left_in_any_help():
    for command in get_command(program).commands:
        done = CliRunner().invoke(program, [command, "--help"])
        assert done.exit_code == 0
        assert not re.findall(r"\{[a-z]+\}", done.output)


def test_an_unknown_solver_is_refused_with_the_names_that_there_are():
    for name in SOLVERS:
        SolverOptions(solver=name).check()
    with pytest.raises(ModelError, match=r"no solver 'scipi' \(did you mean 'scipy'\?\)"):
        SolverOptions(solver="scipi").check()
