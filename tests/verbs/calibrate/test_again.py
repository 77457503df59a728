"""Results made again from their records."""

from __future__ import annotations

import csv
import hashlib
import json
import random
import shutil
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import calib
from calib.basics.json_files import read_json
from calib.errors import CalibError, FileError
from calib.result.calibration_file import EXPECTED, SCHEMA, write_table
from calib.verbs.calibrate.again import ResultFile, What, again, compare_tables
from tests.cli_fixtures import calib as calib_program
from tests.plugin_files import SOURCE, registries_kept, write_plugin

WORDS = ("robot.urdf", "data.csv", "--base", "base", "--tip", "tool0", "--model", "zeros")

Call = Callable[..., Any]


@pytest.fixture
def made(shop: Path, call: Call) -> Path:
    """A folder with a result of its robot and table, without cross-validation."""
    done = call(shop, "calibrate", *WORDS, "--no-validate", "--json", "result.json", "--quiet")
    assert done.code == 0
    return shop


def load(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def bits(value: Any, path: str = "") -> Iterator[tuple[str, bytes]]:
    """Every number of nested JSON as its eight bytes, by its place: what a test of calib's comparison reads itself."""
    if isinstance(value, dict):
        for key, entry in value.items():
            if key not in ("time", "seconds", "call", "checksums"):
                yield from bits(entry, f"{path}/{key}")
    elif isinstance(value, list):
        for k, entry in enumerate(value):
            yield from bits(entry, f"{path}/{k}")
    elif isinstance(value, (int, float)):
        yield path, struct.pack("<d", value)


def rewritten(path: Path, change: Callable[[Any], None]) -> None:
    """Change a result file as if calib had written it so, with its checksums."""
    from calib.result.calibration_file import _checksums

    table = load(path)
    del table["checksums"]
    change(table)
    write_table(table | {"checksums": _checksums(table)}, path, overwrite=True)


def test_the_record_has_what_the_call_said(made: Path):
    record = load(made / "result.json")["call"]
    assert (record["robot"], record["table"]) == ("robot.urdf", "data.csv")
    assert record["cell"] == {"base": "base", "tip": "tool0", "model": "zeros"}
    assert (record["solver"], record["robust"], record["validate"]) == ("lm", True, False)
    for name in ("robot.urdf", "data.csv"):
        assert record["files"][name] == hashlib.sha256((made / name).read_bytes()).hexdigest()


def test_a_result_made_again_is_equal_to_the_last_bit(made: Path, call: Call):
    done = call(made, "calibrate", "--again", "result.json", "--json", "second.json")
    assert (done.code, done.err) == (0, "")
    first, second = load(made / "result.json"), load(made / "second.json")
    assert dict(bits(first)) == dict(bits(second))
    assert first["outputs"] == second["outputs"]
    assert second["call"] == first["call"]


def test_the_comparison_counts_what_an_independent_reader_finds(made: Path, call: Call):
    call(made, "calibrate", "--again", "result.json", "--no-robust", "--json", "other.json")
    tables = [
        read_json(made / name, "result", SCHEMA, EXPECTED) for name in ("result.json", "other.json")
    ]
    _, differences = compare_tables(*tables)
    found = {each.path.replace("[", "/").replace("]", "").replace(".", "/") for each in differences}
    first, second = (dict(bits(load(made / name))) for name in ("result.json", "other.json"))
    assert {path[1:] for path in first if first[path] != second.get(path)} <= found


def test_files_are_found_beside_the_result_and_in_the_current_folder(
    made: Path, call: Call, tmp_path: Path
):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert call(elsewhere, "calibrate", "--again", made / "result.json").code == 0
    shutil.move(made / "result.json", elsewhere)
    assert call(made, "calibrate", "--again", elsewhere / "result.json").code == 0
    # A file of the same name in the current folder has another content: the one with the hash counts.
    (elsewhere / "data.csv").write_text("q [deg]\n1\n", encoding="utf-8")
    assert call(made, "calibrate", "--again", elsewhere / "result.json").code == 0


def test_a_file_that_is_gone_is_named_with_the_folders(made: Path, call: Call):
    (made / "data.csv").rename(made / "renamed.csv")
    done = call(made, "calibrate", "--again", "result.json")
    assert done.code == 1
    assert "data.csv" in done.err
    done = call(made, "calibrate", "robot.urdf", "renamed.csv", "--again", "result.json")
    assert done.code == 0


def with_other_digit(path: Path) -> None:
    """Move the first measured point by 0.1 mm."""
    text = path.read_text(encoding="utf-8")
    assert "-149.02" in text
    path.write_text(text.replace("-149.02", "-149.12"), encoding="utf-8")


def test_a_table_that_was_changed_is_said_with_what_it_moves(
    made: Path, call: Call, monkeypatch: pytest.MonkeyPatch
):
    before = hashlib.sha256((made / "data.csv").read_bytes()).hexdigest()
    with_other_digit(made / "data.csv")
    now = hashlib.sha256((made / "data.csv").read_bytes()).hexdigest()
    assert call(made, "calibrate", "--again", "result.json").code == 3
    monkeypatch.chdir(made)
    made_again = again("result.json")
    (change,) = made_again.changes
    assert (change.what, change.name) == (What.INPUT, "data.csv")
    assert (change.before, change.now) == (before, now)
    assert not made_again.is_equal
    assert not made_again.has_same_urdf
    # Of 30 rows one moved by 0.1 mm: the zeros by a part of their standard deviations.
    assert 1e-3 < made_again.moved[0].in_std < 0.5
    first, second = (values(result) for result in (made_again.before, made_again.result))
    for pair in made_again.moved:
        difference = abs(second[pair.before.name] - first[pair.before.name])
        assert pair.in_std == pytest.approx(difference / pair.before.std)


def values(result: calib.Calibration) -> dict[str, float]:
    """The values of the parameters by name."""
    return {parameter.name: parameter.value for parameter in result.parameters}


def test_another_robot_is_an_input_that_changed(made: Path, monkeypatch: pytest.MonkeyPatch):
    path = made / "robot.urdf"
    path.write_text(path.read_text(encoding="utf-8").replace("0.1519", "0.1520"), encoding="utf-8")
    monkeypatch.chdir(made)
    made_again = again("result.json")
    assert [(each.what, each.name) for each in made_again.changes] == [(What.INPUT, "robot.urdf")]
    assert not made_again.is_equal


def test_another_version_is_said_and_is_no_difference(made: Path, call: Call):
    def change(table: Any) -> None:
        table["versions"] |= {"numpy": "1.0.0", "blas": "openblas 0.0.1 Atom"}

    rewritten(made / "result.json", change)
    done = call(made, "calibrate", "--again", "result.json")
    assert done.code == 0
    assert "1.0.0" in done.out
    assert "openblas 0.0.1 Atom" in done.out


def test_a_key_that_one_version_lacks_is_no_difference(made: Path, call: Call):
    def change(table: Any) -> None:
        table["versions"]["calib"] = "0.0.9"
        del table["scale"]

    rewritten(made / "result.json", change)
    assert call(made, "calibrate", "--again", "result.json").code == 0
    rewritten(made / "result.json", lambda table: table["versions"].update(calib=calib.__version__))
    assert call(made, "calibrate", "--again", "result.json").code == 3


def test_options_count_over_those_of_the_record(made: Path, call: Call):
    done = call(
        made, "calibrate", "--again", "result.json", "--model", "frames", "--no-robust",
        "--json", "frames.json",
    )  # fmt: skip
    assert done.code == 3
    record = load(made / "frames.json")["call"]
    assert record["cell"] == {"base": "base", "tip": "tool0", "model": "frames"}
    assert (record["robust"], record["validate"]) == (False, False)
    first = ResultFile.read(made / "result.json")
    second = ResultFile.read(made / "frames.json")
    changes = first.compared(second.result, second.call, {}).changes
    assert [(each.name, each.before, each.now) for each in changes] == [
        ("robust", "true", "false"),
        ("cell.model", '"zeros"', '"frames"'),
    ]


def test_the_cell_is_that_of_the_record_whatever_its_file_says_now(shop: Path, call: Call):
    call(shop, "calibrate", "robot.urdf", "data.csv", "--cell", "cell.toml", "--no-validate",
         "--json", "result.json", "--quiet")  # fmt: skip
    assert call(shop, "calibrate", "--again", "result.json").code == 0
    cell = shop / "cell.toml"
    cell.write_text(cell.read_text(encoding="utf-8") + "\n# a remark\n", encoding="utf-8")
    done = call(shop, "calibrate", "--again", "result.json")
    assert done.code == 0
    assert "cell.toml" in done.out
    cell.unlink()
    assert call(shop, "calibrate", "--again", "result.json").code == 0


def test_reading_is_that_of_the_record(shop: Path, call: Call):
    words = ("robot.urdf", "joints.csv", "--points", "tracker.txt", "--base", "base")
    call(shop, "calibrate", *words, "--model", "zeros", "--no-validate", "--json", "result.json")
    assert load(shop / "result.json")["call"]["points"] == "tracker.txt"
    assert call(shop, "calibrate", "--again", "result.json").code == 0
    data = (shop / "data.csv").read_text(encoding="utf-8")
    (shop / "plain.csv").write_text(data.replace(" [deg]", ""), encoding="utf-8")
    words = ("robot.urdf", "plain.csv", "--joint-unit", "deg", "--base", "base")
    call(shop, "calibrate", *words, "--model", "zeros", "--no-validate", "--json", "r.json")
    assert load(shop / "r.json")["call"]["joint_unit"] == "deg"
    assert call(shop, "calibrate", "--again", "r.json").code == 0


def test_intervals_are_made_again_in_any_number_of_processes(made: Path, call: Call):
    words = ("--bootstrap", "40", "--seed", "3", "--profile", "wrist_1_joint.zero")
    call(made, "calibrate", *WORDS, "--no-validate", *words, "--json", "intervals.json")
    assert call(made, "calibrate", "--again", "intervals.json").code == 0
    done = call(
        made, "calibrate", "--again", "intervals.json", "--seed", "4", "--json", "other.json"
    )
    assert done.code == 3
    assert load(made / "other.json")["call"]["seed"] == 4


def test_a_plugin_of_the_record_is_loaded(made: Path, call: Call):
    sha256 = hashlib.sha256(write_plugin(made).read_bytes()).hexdigest()
    words = (*WORDS[:-1], "zeros+ripple", "--no-validate", "--plugin", "my_plugin.py")
    with registries_kept():
        call(made, "calibrate", *words, "--json", "p.json")
    assert load(made / "p.json")["call"]["plugins"] == {"my_plugin.py": sha256}
    with registries_kept():
        assert call(made, "calibrate", "--again", "p.json").code == 0
    with registries_kept():
        write_plugin(made, SOURCE + "# a remark")
        done = call(made, "calibrate", "--again", "p.json")
    assert done.code == 0
    assert "my_plugin.py" in done.out


def test_one_input_alone_is_refused(made: Path, call: Call):
    done = call(made, "calibrate", "robot.urdf", "--again", "result.json")
    assert done.code == 1
    with pytest.raises(CalibError):
        again(made / "result.json", robot="ur3")


@pytest.mark.parametrize("words", [(), ("robot.urdf",)])
def test_without_a_record_both_inputs_are_needed(shop: Path, call: Call, words: tuple[str, ...]):
    assert call(shop, "calibrate", *words).code == 2


def test_an_input_of_the_record_is_not_overwritten(made: Path, call: Call):
    done = call(made, "calibrate", "--again", "result.json", "-o", "robot.urdf", "--force")
    assert done.code == 1
    done = call(made, "calibrate", "--again", "result.json", "--json", "result.json", "--force")
    assert done.code == 1


def test_a_file_without_a_record_says_so(made: Path):
    rewritten(made / "result.json", lambda table: table.pop("call"))
    with pytest.raises(FileError, match="record"):
        again(made / "result.json")


@pytest.mark.slow
def test_budget_and_forecast_are_made_again(made: Path, call: Call):
    call(made, "calibrate", *WORDS, "--json", "whole.json")
    table = load(made / "whole.json")
    assert table["forecast"] is not None
    assert table["uncertainty"] is not None
    assert call(made, "calibrate", "--again", "whole.json").code == 0


def test_what_was_given_in_memory_has_to_be_given_again(made: Path, call: Call):
    robot = calib.Robot.load(made / "robot.urdf", base="base", tip="tool0")
    table = calib.Measurements.read(made / "data.csv", robot.joint_names)
    result = calib.calibrate(robot, table, model="zeros", validate=False)
    result.write_json(made / "memory.json")
    record = load(made / "memory.json")["call"]
    assert (record["robot"], record["table"], record["files"]) == ("", "", {})
    with pytest.raises(CalibError, match="in memory"):
        again(made / "memory.json")
    made_again = again(made / "memory.json", robot, table)
    assert made_again.is_equal
    assert made_again.changes == ()
    # The record has the links of the robot's chain, so that its files alone are to be named.
    assert record["cell"] == {"base": "base", "tip": "tool0", "model": "zeros"}
    done = call(made, "calibrate", "robot.urdf", "data.csv", "--again", "memory.json")
    assert done.code == 0
    other = replace(table, points=table.points + 1e-4)
    made_again = again(made / "memory.json", robot, other)
    assert not made_again.is_equal


def test_paths_given_in_python_are_in_the_record(made: Path):
    result = calib.calibrate(
        made / "robot.urdf", made / "data.csv", base="base", tip="tool0", model="zeros",
        validate=False,
    )  # fmt: skip
    result.write_json(made / "python.json")
    assert again(made / "python.json").is_equal
    call_of = result.method.call
    assert call_of is not None
    assert call_of.cell.base == "base"


def test_parameters_of_ones_own_are_in_no_file(made: Path):
    parameter = calib.calibrate(
        made / "robot.urdf", made / "data.csv", base="base", model="zeros", validate=False
    ).model.parameters[0]
    result = calib.calibrate(
        made / "robot.urdf", made / "data.csv", base="base", model=[parameter], validate=False
    )
    result.write_json(made / "own.json")
    with pytest.raises(CalibError, match="Python"):
        again(made / "own.json")


@pytest.mark.slow
def test_auto_with_validation_is_made_again_to_the_last_bit(shop: Path, call: Call):
    words = ("robot.urdf", "data.csv", "--base", "base", "--tip", "tool0")
    call(shop, "calibrate", *words, "-o", "first.urdf", "--json", "result.json")
    done = call(shop, "calibrate", "--again", "result.json", "-o", "second.urdf")
    assert done.code == 0
    assert (shop / "first.urdf").read_bytes() == (shop / "second.urdf").read_bytes()


def test_rows_with_their_order_may_stand_in_any_order(shop: Path):
    with (shop / "data.csv").open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    numbered = [[*row, str(k)] for k, row in enumerate(rows)]
    found = []
    for name, order in (("a", numbered), ("b", random.Random(5).sample(numbered, len(numbered)))):
        table = shop / f"{name}.csv"
        with table.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows([[*head, "order"], *order])
        result = calib.calibrate(shop / "robot.urdf", table, base="base", model="zeros")
        found.append(dict(bits(load(result.write_json(shop / f"{name}.json")))))
    assert len(found[0]) > 500
    assert found[0] == found[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "environment",
    [{"OPENBLAS_NUM_THREADS": "4", "PYTHONHASHSEED": "77"}, {"OPENBLAS_CORETYPE": "Nehalem"}],
)
def test_other_processes_give_the_same(
    shop: Path, monkeypatch: pytest.MonkeyPatch, environment: dict[str, str]
):
    calib_program(shop, "calibrate", *WORDS[:-1], "dh", "--json", "result.json")
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    done = calib_program(shop, "calibrate", "--again", "result.json", "--json", "again.json")
    first, second = (load(shop / name) for name in ("result.json", "again.json"))
    kernels = [table["versions"]["blas"] for table in (first, second)]
    # Another kernel, if this processor has one, moves the last bits and nothing else.
    assert done.code == (0 if kernels[0] == kernels[1] else 3)
    for a, b in zip(first["parameters"], second["parameters"], strict=True):
        assert abs(a["value"] - b["value"]) <= 1e-9 * (a["std"] or 1.0)
