from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest


def load(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.fixture
def folder(examples) -> Path:
    return examples.folder


def same_errors(evaluated: Any, fitted: Any) -> None:
    for rows in ("estimation", "validation"):
        for key, value in fitted[rows].items():
            assert evaluated[rows][key] == pytest.approx(value, abs=1e-9, rel=0)


def test_the_nominal_urdf_with_the_json_is_the_fit(examples, folder: Path):
    done = examples.starting("calib evaluate robot.urdf data.csv --calibration result.json")
    assert (done.code, done.err) == (0, "")
    assert "mm in tool0, as the result has it." in done.lines[0]
    assert "the URDF as it is:" in done.lines
    assert "with the joint origins of result.json:" in done.lines
    assert done.lines[-1] == "Written: errors.json"
    errors = load(folder / "errors.json")["errors"]
    same_errors(errors["calibration"], load(folder / "result.json")["errors"]["calibrated"])
    assert errors["urdf"]["validation"]["rms_m"] > 2e-3


def test_the_corrected_urdf_with_the_json_is_the_fit(call, folder: Path, tmp_path: Path):
    done = call(
        folder, "evaluate", "corrected.urdf", "data.csv", "--calibration", "result.json",
        "--json", tmp_path / "e.json", "--quiet",
    )  # fmt: skip
    assert (done.code, done.out, done.err) == (0, "", "")
    evaluated = load(tmp_path / "e.json")
    fitted = load(folder / "result.json")["errors"]["calibrated"]
    same_errors(evaluated["errors"]["urdf"], fitted)
    same_errors(evaluated["errors"]["calibration"], fitted)
    assert evaluated["frames"]["registered"] == []
    assert evaluated["robot"]["base"] == "base"


def test_the_link_carries_the_target(examples):
    done = examples.starting("calib evaluate target.urdf")
    assert (done.code, done.err) == (0, "")
    assert done.lines[0].endswith("mm in tool0, as the URDF's link 'calib_target' has it.")


def test_a_target_as_given_and_registered(call, examples, folder: Path):
    given = examples.starting("calib evaluate robot.urdf data.csv --base base --target")
    assert given.lines[0] == "Target at (-70.000, 70.000, 22.500) mm in tool0, as given."
    found = call(folder, "evaluate", "robot.urdf", "data.csv", "--base", "base")
    assert found.lines[0].endswith("mm in tool0, registered to the rows.")
    both = call(
        folder, "evaluate", "robot.urdf", "data.csv", "--base", "base", "--frame", "estimate"
    )
    assert both.lines[1] == "Measurement frame: registered to the rows."
    for done in (given, found, both):
        assert (done.code, done.err) == (0, "")
        rows = [line.split()[0] for line in done.lines if " rows " in line]
        assert rows == ["Position", "estimation", "validation", "all"]
        assert "Try that" not in done.out


def test_a_wrong_base_is_named(call, folder: Path):
    done = call(folder, "evaluate", "robot.urdf", "data.csv")
    assert done.code == 0
    assert "only 2.3 mm if the points are in the frame of 'base': try --base base." in " ".join(
        done.out.split()
    )


def test_another_base_than_the_results_is_refused(call, folder: Path):
    for option, link in (("base", "world"), ("tip", "ee_link")):
        done = call(
            folder, "evaluate", "robot.urdf", "data.csv", f"--{option}", link,
            "--calibration", "result.json",
        )  # fmt: skip
        wanted = {"base": "base", "tip": "tool0"}[option]
        assert (done.code, done.out) == (1, "")
        assert done.err == (
            f"calib: result.json is the result for --{option} {wanted}, and '{link}' was given; leave out "
            f"--{option}, or --calibration.\n"
        )


def test_only_one_set_is_not_said_twice(call, shop):
    header, *rows = (shop / "data.csv").read_text(encoding="utf-8").splitlines()
    (shop / "some.csv").write_text("\n".join([header, *rows[:20]]), encoding="utf-8")
    done = call(shop, "evaluate", "robot.urdf", "some.csv", "--base", "base")
    assert [line.split()[0] for line in done.lines if " rows " in line][1:] == ["estimation"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--calibration", "no.json"), "calibration result 'no.json' does not exist; check"),
        (("--calibration", "data.csv"), "data.csv: this is not a JSON file: "),
        (("--calibration", "view.json"), "view.json: its 'schema' is None; a result of calib"),
        (("--calibration", "view.json", "--json", "view.json"), "is also an input of this command"),
        (("--json", "no/e.json"), "the folder 'no' does not exist; make it first."),
    ],
)
def test_errors_are_one_line(call, shop, words: tuple[str, ...], said: str):
    (shop / "view.json").write_text("{}", encoding="utf-8")
    done = call(shop, "evaluate", "robot.urdf", "data.csv", *words)
    assert (done.code, done.out) == (1, "")
    assert done.err.startswith("calib: ")
    assert said in done.err
    assert done.err.count("\n") == 1
