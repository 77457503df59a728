"""Groups of options: each field is an option, and lists in help texts are those of the registries."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

from calib.basics.arrays import Array
from calib.basics.records import Option, changes, keep_checked, key, key_rows, read_record
from calib.basics.units import parse_point
from calib.basics.value_forms import MM, POINT_MM
from calib.cli.options import (
    CellOptions,
    ColumnChoice,
    FitOptions,
    SolverOptions,
    TableOptions,
    field_parameters,
)
from calib.cli.verb import Verb, verb
from calib.data import kinds
from calib.data.forms.column_options import ColumnOptions
from calib.errors import CalibError, FileError, ModelError
from calib.model.families import joint_families
from calib.model.parameter_sets import MODELS
from calib.numerics.solvers import SOLVERS
from calib.program import app as program
from calib.verbs.convert.convert import FORMATS


@verb("What it does.")
def shown(
    robot: str,
    cell_options: FitOptions,
    table_options: TableOptions,
    robust: Annotated[bool, typer.Option(help="Give outliers no weight.")] = True,
) -> None:
    given = [cell_options.given.get(name) for name in ("tip", "hold", "fix_target", "repeats")]
    typer.echo((robot, *given, table_options.points_unit, robust))
    if robot == "none":
        raise FileError("none is not there.")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["a"], 0, "('a', None, None, None, None, None, True)"),
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
            "('b', ['t'], ['j=1 m', 'k=2 m'], True, None, None, False)",
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
        (
            ["a", "--target", "t", "--target", "u"],
            2,
            "Option '--target' is given 2 times. Give it once.",
        ),
        (["a", "--target=t", "b", "--target=t"], 2, "Option '--target' is given 2 times."),
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


def run(kind: Any, *words: str) -> Any:
    """Run a verb that takes one group; returns what it was given, or the result of a failed call."""
    given = []

    def take(group):
        given.append(group)

    take.__annotations__ = {"group": kind}
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(cls=Verb)(verb("What it does.")(take))
    done = CliRunner().invoke(app, words)
    return given[0] if given else done


@dataclass(frozen=True)
class Bench:
    """A record with a key of its own, as a new one of a cell would be."""

    height: float = key("height_mm", MM, "Height of the bench.", default=0.75)
    corner: Array | None = key(
        "corner_mm",
        POINT_MM,
        "A corner of the bench.",
        default=None,
        absent="the origin",
        option=Option("--corner", metavar='"X Y Z UNIT"', parse=parse_point),
    )

    def __post_init__(self) -> None:
        keep_checked(self, "bench")


@dataclass(frozen=True)
class BenchOptions:
    given: dict[str, Any]

    @classmethod
    def parameters(cls):
        return field_parameters(Bench)

    @classmethod
    def of_typed(cls, typed):
        return cls({name: value for name, value in typed.items() if value is not None})


def test_a_new_key_is_one_field_from_which_file_message_option_and_documentation_follow():
    table = {"corner_mm": [1, 2, 3]}
    np.testing.assert_allclose(read_record(Bench, table).corner, [1e-3, 2e-3, 3e-3], rtol=1e-15)
    with pytest.raises(CalibError, match=r"'corner_mm' is \[1\]; it must be three numbers \[mm\]"):
        read_record(Bench, {"corner_mm": [1]})
    with pytest.raises(CalibError, match=r"unknown key \(did you mean 'corner_mm'\?\)"):
        read_record(Bench, {"coner_mm": [1]})
    given = run(BenchOptions, "--corner", "1 2 3 cm").given
    assert changes(Bench(), given)["corner"].tolist() == [0.01, 0.02, 0.03]
    said = " ".join(run(BenchOptions, "--help").output.split())
    assert '--corner "X Y Z UNIT" A corner of the bench. Default: the origin.' in said
    row = ("corner_mm", "three numbers [mm]", "the origin", "A corner of the bench. (`--corner`)")
    assert row in key_rows(Bench)


def test_a_group_takes_the_options_of_its_groups_and_names():
    names = {parameter.name for parameter in CellOptions.parameters()}
    assert {"cell", "base", "camera_on", "hold"} <= names
    assert not {"model", "payload", "freeze", "tracker"} & names
    assert {"model", "payload", "freeze", "priors"} <= {p.name for p in FitOptions.parameters()}
    options = run(FitOptions, "--fix-target", "--freeze", "d2", "--priors", "off")
    assert options.given == {"fix_target": True, "freeze": ["d2"], "priors": "off"}


def test_zero_is_a_value_that_was_given():
    typed = {"cell": None, "a": 0.0, "b": 0, "c": None, "d": False, "e": [], "f": True}
    assert dict(CellOptions.of_typed(typed).given) == {"a": 0.0, "b": 0, "f": True}


def test_two_options_of_one_link_must_agree():
    assert CellOptions(None, {"base": "a", "camera_on": "a"}).cell().base == "a"
    with pytest.raises(
        CalibError, match="--base is 'a' and --camera-on is 'b': they mean the same"
    ):
        CellOptions(None, {"base": "a", "camera_on": "b"}).cell()


def test_a_payload_keeps_the_centre_of_mass_of_the_file(tmp_path: Path):
    path = tmp_path / "cell.toml"
    path.write_text("[payload]\nmass_kg = 3\ncom_mm = [0, 0, 100]\n")
    given = FitOptions(path, {"payload": " 500g"}).cell().payload
    assert given.mass == 0.5
    np.testing.assert_array_equal(given.com, [0.0, 0.0, 0.1])
    alone = FitOptions(None, {"payload": "1.5e3 g"}).cell().payload
    assert alone.mass == 1.5
    np.testing.assert_array_equal(alone.com, np.zeros(3))


def test_options_add_to_names_and_joints_of_the_file_and_win(tmp_path: Path):
    path = tmp_path / "cell.toml"
    path.write_text('freeze = ["a1"]\npriors = "data"\nprior_length_mm = 2\n[held]\nlift = "1 m"\n')
    typed = {"freeze": ["d2"], "hold": ["lift=0.3 m", "pan=1 deg"], "priors": "given"}
    cell = FitOptions(path, typed).cell()
    assert cell.frozen == ("a1", "d2")
    assert cell.held == {"lift": 0.3, "pan": pytest.approx(np.radians(1.0))}
    assert (cell.priors.source, cell.priors.of("length")) == ("given", 2e-3)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: FitOptions(None, {"hold": ["lift"]}).cell(), "--hold was given 'lift'; it must be 'joint=value' with"),
        (lambda: FitOptions(None, {"hold": ["lift=3"]}).cell(), "--hold 'lift=3' is '3'; a joint's value needs a unit"),
        (lambda: FitOptions(None, {"payload": "5"}).cell(), '--payload was given as "5"; it must be a mass, not below'),
        (lambda: FitOptions(None, {"frame": "u"}).cell(), "--frame is 'u'; it must be 'known', 'estimate' or some of"),
        (lambda: FitOptions(None, {"target": "1 2 mm"}).cell(), '--target was given as "1 2 mm"; it must be 3 numbers'),
        (lambda: ColumnChoice(["kuk"]).parsed(), "--columns was given 'kuk'; it must be"),
        (lambda: ColumnChoice(["kuka", "fanuc"]).parsed(), "--columns was given 'kuka', 'fanuc'"),
        (lambda: ColumnChoice(["a=b", "a=c"]).parsed(), "--columns was given 'a=c'"),
    ],
)  # fmt: skip
def test_words_that_mean_nothing_are_refused_in_one_line(call, said: str):
    with pytest.raises(CalibError, match=re.escape(said)) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_columns_by_name_and_by_brand():
    assert ColumnChoice().parsed() == ColumnOptions()
    words = ["E1=rail [mm]", " KUKA ", "a=b=c"]
    assert ColumnChoice(words, "fanuc", "deg mm").parsed() == ColumnOptions(
        {"E1": "rail [mm]", "a=b": "c"}, "kuka", "fanuc", "deg mm"
    )
