from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib
from calib.data import paper_measurements, paper_urdf
from calib.errors import FileError, UrdfError
from calib.identify.calibration import Calibration, calibrate
from calib.identify.evaluation import evaluate
from calib.identify.result_file import evaluation_table, read_result, write_result, write_table
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.readback import random_joint_values
from calib.model.robot import Robot, read_only

DOC = Path(__file__).parents[2] / "docs" / "result-json.md"

NUMBER = (int, float)
THREE = "three numbers"

#: The contract: what other programs may rely on, as the design promises it.
CONTRACT: dict[str, Any] = {
    "schema": int,
    **{
        f"errors.{who}.{rows}.{key}": kind
        for who in ("nominal", "calibrated")
        for rows in ("estimation", "validation")
        for key, kind in (("n", int), ("max_m", NUMBER), ("mean_m", NUMBER), ("rms_m", NUMBER))
    },
    "cross_validation.method": str,
    "cross_validation.folds": int,
    "cross_validation.rms_m": NUMBER,
    "cross_validation.mean_m": NUMBER,
    "cross_validation.max_m": NUMBER,
    "parameters[].name": str,
    "parameters[].unit": str,
    "parameters[].nominal": NUMBER,
    "parameters[].value": NUMBER,
    "parameters[].delta": NUMBER,
    "parameters[].std": NUMBER,
    "parameters[].low": NUMBER,
    "parameters[].high": NUMBER,
    "parameters[].identifiable": bool,
    "outliers[].row": int,
    "outliers[].residual_m": NUMBER,
    "outliers[].score": NUMBER,
    "observability.rank": int,
    "observability.columns": int,
    "observability.condition": NUMBER,
    "observability.indices": dict,
    "observability.unidentifiable": list,
    "model.set": str,
    "model.candidates": list,
    "solver.name": str,
    "solver.iterations": int,
    "solver.evaluations": int,
    "solver.seconds": NUMBER,
    "solver.status": str,
    "solver.message": str,
    "solver.history": list,
    "verdict.use": str,
    "verdict.reasons": list,
    "inputs.urdf.name": str,
    "inputs.urdf.sha256": str,
    "inputs.measurements.name": str,
    "inputs.measurements.sha256": str,
    "versions.calib": str,
    "versions.pin": str,
}


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every key of nested tables, ``a.b`` and ``a[].b``, with its value; lists of plain values are one value."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from leaves(entry, f"{path}.{key}" if path else key)
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for entry in value:
            yield from leaves(entry, f"{path}[]")
    else:
        yield path, value


def at(table: Any, path: str) -> list[Any]:
    """The values at a path of `leaves`, also where they are tables."""
    values = [table]
    for part in path.split("."):
        key = part.removesuffix("[]")
        values = [value[key] for value in values]
        if part.endswith("[]"):
            values = list(itertools.chain(*values))
    return values


@pytest.fixture(scope="module")
def written(default_result: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    # Suspects too, so that every key of the document appears.
    suspicious = replace(default_result, suspects=default_result.outliers[:1])
    return write_result(suspicious, tmp_path_factory.mktemp("result") / "result.json")


@pytest.fixture(scope="module")
def result_json(written: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(written.read_text(encoding="utf-8"))
    return loaded


@pytest.mark.parametrize(("path", "kind"), CONTRACT.items())
def test_the_contract(result_json: dict[str, Any], path: str, kind: Any):
    values = at(result_json, path)
    assert values
    for value in values:
        assert isinstance(value, kind), (path, value)
        assert isinstance(value, bool) == (kind is bool)


def test_the_values_are_those_of_the_calibration(
    result_json: dict[str, Any], default_result: Calibration
):
    c = default_result
    assert result_json["schema"] == 1
    for who, sets in c.errors.items():
        for name, errors in sets.items():
            stored = result_json["errors"][who][name]
            assert stored["n"] == errors.n
            assert stored["max_m"] == errors.max
            assert stored["mean_m"] == errors.mean
            assert stored["rms_m"] == errors.rms
            np.testing.assert_array_equal(stored["span_xyz_m"], errors.span_axis)
    assert c.cross_validation is not None
    assert result_json["cross_validation"]["rms_m"] == c.cross_validation.errors.rms
    assert result_json["cross_validation"]["without_outliers"]["n"] == 30 - len(c.outliers)
    assert [p["name"] for p in result_json["parameters"]] == list(c.model.names)
    assert [p["value"] for p in result_json["parameters"]] == [p.value for p in c.parameters]
    np.testing.assert_array_equal(result_json["covariance"], c.covariance)
    np.testing.assert_array_equal(result_json["frames"]["target_m"], c.target)
    np.testing.assert_array_equal(
        [row["residual_calibrated_m"] for row in result_json["rows"]], c.residual_calibrated
    )
    assert [row["row"] for row in result_json["rows"]] == list(range(1, 36))
    assert [row["weight"] for row in result_json["rows"]] == c.weights.tolist()
    assert [row["set"] for row in result_json["rows"]] == ["estimate"] * 30 + ["validate"] * 5
    assert c.verdict is not None
    assert result_json["verdict"] == {"use": c.verdict.use, "reasons": list(c.verdict.reasons)}
    assert result_json["versions"]["calib"] == calib.__version__


def test_the_inputs_are_named_by_their_bytes(result_json: dict[str, Any]):
    for key, path in (("urdf", paper_urdf()), ("measurements", paper_measurements())):
        assert result_json["inputs"][key]["name"] == path.name
        assert result_json["inputs"][key]["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_numbers_agree_with_each_other(result_json: dict[str, Any]):
    for p in result_json["parameters"]:
        assert p["low"] < p["value"] < p["high"]
        assert p["value"] - p["nominal"] == pytest.approx(p["delta"], abs=1e-15)
        assert p["unit"] in ("m", "rad")
    o = result_json["observability"]
    assert o["columns"] == len(o["singular_values"]) == len(result_json["parameters"])
    assert o["rank"] + len(o["unidentifiable"]) == o["columns"]
    assert len(result_json["solver"]["history"]) == result_json["solver"]["iterations"]
    norms = np.linalg.norm([r["residual_calibrated_m"] for r in result_json["rows"]], axis=1)
    assert norms[:30].max() == pytest.approx(
        result_json["errors"]["calibrated"]["estimation"]["max_m"], rel=1e-14
    )


def documented(heading: str) -> dict[str, str]:
    """The keys of the table under a heading of the document, braces expanded, each with its type."""
    section = DOC.read_text(encoding="utf-8").split(f"\n## {heading}\n")[1].split("\n## ")[0]
    keys = {}
    for path, kind in re.findall(r"^\| `([^`]+)` \| ([^|]+) \|", section, re.MULTILINE):
        pieces = re.split(r"\{([^}]*)\}", path)
        choices = [p.split(",") if i % 2 else [p] for i, p in enumerate(pieces)]
        for parts in itertools.product(*choices):
            assert "".join(parts) not in keys
            keys["".join(parts)] = kind
    return keys


#: What the words of the document's column "type" mean; "as above" is looked at where it is explained.
TYPES = {
    "text": lambda v: isinstance(v, str),
    "integer": lambda v: isinstance(v, int) and not isinstance(v, bool),
    "number": lambda v: isinstance(v, NUMBER) and not isinstance(v, bool),
    "true, false": lambda v: isinstance(v, bool),
    "3 numbers": lambda v: len(v) == 3 and all(isinstance(x, float) for x in v),
    "p numbers": lambda v: len(v) == 27 and all(isinstance(x, float) for x in v),
    "p lists of p numbers": lambda v: np.shape(v) == (27, 27),
    "list of texts": lambda v: isinstance(v, list) and all(isinstance(x, str) for x in v),
    "list of numbers": lambda v: all(isinstance(x, float) for x in v),
    "list": lambda v: isinstance(v, list),
    "table": lambda v: isinstance(v, dict),
    "as above": lambda _: True,
}


def test_the_document_has_every_key_of_a_file_and_no_other(result_json: dict[str, Any]):
    tables = {"cross_validation", "verdict"}  # described as a whole too, for they may be null
    found = {path for path, _ in leaves(result_json)}
    assert set(documented("Keys")) - tables == found


def test_the_document_tells_the_types(result_json: dict[str, Any]):
    for path, kind in documented("Keys").items():
        fits = TYPES[kind.removesuffix(", null")]
        for value in at(result_json, path):
            assert fits(value) or (value is None and kind.endswith(", null")), (path, value)


def test_the_document_has_every_key_of_an_evaluation(
    ur3: Robot, table: Measurements, default_result: Calibration, tmp_path: Path
):
    plain = evaluate(ur3, table)
    both = evaluation_table(plain, evaluate(default_result.robot, table))
    stored = json.loads(write_table(both, tmp_path / "e.json").read_text(encoding="utf-8"))
    keys = documented("What `calib evaluate --json` writes")
    assert set(keys) == {path for path, _ in leaves(stored)}
    assert stored["schema"] == "evaluation 1"
    assert stored["frames"]["registered"] == ["target"]
    assert stored["errors"]["urdf"]["all"]["n"] == 35
    assert "calibration" not in evaluation_table(plain)["errors"]
    with pytest.raises(FileError, match="its 'schema' is 'evaluation 1'; a result of calib"):
        read_result(tmp_path / "e.json")


def test_numbers_that_do_not_exist_are_null(ur3: Robot, table: Measurements, tmp_path: Path):
    seen = table.select(table.estimation)
    bare = calibrate(ur3, seen, solver="paper", validate=False)
    text = write_result(bare, tmp_path / "r.json").read_text(encoding="utf-8")
    assert "NaN" not in text
    assert "Infinity" not in text
    stored = json.loads(text)
    empty = stored["errors"]["nominal"]["validation"]
    assert empty["n"] == 0
    assert empty["max_m"] is empty["mean_m"] is empty["rms_m"] is None
    assert empty["span_xyz_m"] == [None] * 3
    assert stored["cross_validation"] is None
    assert stored["verdict"] is None
    assert stored["frames"]["target_given_m"] is None
    assert stored["noise"]["prior_length_m"] is stored["noise"]["prior_angle_rad"] is None
    nominal = {p["name"]: p["nominal"] for p in stored["parameters"]}
    assert nominal["target_x"] is None
    assert nominal["a2"] == pytest.approx(-0.24365)
    assert stored["suspects"] == []
    assert at(stored, "outliers[].row") == [o.row for o in bare.outliers]
    # Lists may be empty and tables null, but no key is missing.
    known = set(documented("Keys")) | {"suspects", "outliers"}
    assert {path for path, _ in leaves(stored)} <= known


def test_arrays_become_lists_and_odd_numbers_null(tmp_path: Path):
    odd = {
        "a": np.array([[1.0, np.nan], [np.inf, 2.0]]),
        "b": (np.int64(3), np.float64(-np.inf)),
        "c": "µm",
        "d": True,
    }
    path = write_table(odd, tmp_path / "t.json")
    text = path.read_text(encoding="utf-8")
    assert json.loads(text) == {
        "a": [[1.0, None], [None, 2.0]],
        "b": [3, None],
        "c": "µm",
        "d": True,
    }
    assert "µm" in text
    assert text.endswith("}\n")


def test_an_existing_file_is_kept_unless_asked(default_result: Calibration, tmp_path: Path):
    path = tmp_path / "r.json"
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(FileError, match=r"r\.json' exists already; add --force"):
        default_result.write_json(path)
    assert path.read_text(encoding="utf-8") == "mine"
    assert default_result.write_json(path, overwrite=True) == path
    assert read_result(path).tip == "tool0"


def test_read_back_it_makes_the_same_robot(
    written: Path, ur3: Robot, default_result: Calibration, tmp_path: Path
):
    stored = read_result(written)
    q = random_joint_values(ur3, 200, 7)
    wanted = default_result.robot.poses(q)
    corrected = Robot.load(default_result.write_urdf(tmp_path / "c.urdf"), "base", "tool0")
    for robot in (ur3, corrected, Robot.load(paper_urdf())):
        again = stored.corrected(robot)
        assert (again.base, again.tip) == ("base", "tool0")
        assert np.abs(again.poses(q) - wanted).max() < 1e-12
    np.testing.assert_array_equal(stored.target, default_result.target)
    np.testing.assert_allclose(stored.T_frame_base, np.eye(4), atol=1e-15)
    assert not stored.target.flags.writeable
    assert not stored.origins["elbow_joint"].flags.writeable


def test_an_estimated_frame_is_read_back(ur3: Robot, table: Measurements, tmp_path: Path):
    T = np.array([[0.0, -1, 0, 1], [0, 0, -1, 2], [1, 0, 0, 3], [0, 0, 0, 1]])  # pitch of 90 deg
    moved = replace(table, points=read_only(table.points @ T[:3, :3].T + T[:3, 3]))
    result = calibrate(ur3, moved, cell=Cell(estimate_frame=True), validate=False)
    stored = read_result(write_result(result, tmp_path / "r.json"))
    np.testing.assert_allclose(stored.T_frame_base, result.T_frame_base, atol=1e-12)
    cell = Cell(target=stored.target, T_frame_base=stored.T_frame_base)
    again = evaluate(stored.corrected(ur3), moved, cell)
    for name in ("estimation", "validation"):
        wanted = result.errors["calibrated"][name]
        assert again.errors[name].rms == pytest.approx(wanted.rms, abs=1e-9)
        assert again.errors[name].max == pytest.approx(wanted.max, abs=1e-9)


def test_a_robot_without_the_joints_is_refused(written: Path, panda_or_other: Robot):
    with pytest.raises(UrdfError, match="has no joint 'shoulder_pan_joint'"):
        read_result(written).corrected(panda_or_other)


@pytest.fixture(scope="module")
def panda_or_other() -> Robot:
    return Robot.load("panda", base="panda_link0", tip="panda_link8")


@pytest.mark.parametrize(
    "data", [b"", b"{", b"\xff\xfe\x00", b"set,x [mm]\n1,2\n", b"[" * 100_000, b"{'a': 1}"]
)
def test_what_is_not_json(tmp_path: Path, data: bytes):
    path = tmp_path / "r.json"
    path.write_bytes(data)
    with pytest.raises(FileError, match=r"r\.json: this is not a JSON file: ") as caught:
        read_result(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["{}", "[]", "3", '"text"', "null", '{"schema": 2}'])
def test_another_schema(tmp_path: Path, text: str):
    path = tmp_path / "r.json"
    path.write_text(text, encoding="utf-8")
    said = r"r\.json: its 'schema' is (None|2); a result of calib .* has 1. Give the file that"
    with pytest.raises(FileError, match=said):
        read_result(path)


@pytest.mark.parametrize(
    ("path", "bad"),
    [
        ("robot", None),
        ("robot.base", ...),
        ("robot.origins", 3),
        ("robot.origins", [{"joint": "a"}]),
        ("robot.origins", [{"joint": ["a"], "xyz_m": [0, 0, 0], "rpy_rad": [0, 0, 0]}]),
        ("frames", ...),
        ("frames.target_m", [1.0, 2.0]),
        ("frames.target_m", [1.0, 2.0, None]),
        ("frames.target_m", "here"),
        ("frames.frame_base_xyz_m", ...),
        ("frames.frame_base_rpy_rad", [[1.0, 2.0, 3.0]]),
        ("frames.frame_base_rpy_rad", [1.0, 2.0, float("nan")]),
    ],
)
def test_a_damaged_result(result_json: dict[str, Any], tmp_path: Path, path: str, bad: Any):
    damaged = json.loads(json.dumps(result_json))
    *folders, key = path.split(".")
    place = damaged
    for folder in folders:
        place = place[folder]
    if bad is ...:
        del place[key]
    else:
        place[key] = bad
    file = tmp_path / "r.json"
    file.write_text(json.dumps(damaged), encoding="utf-8")
    with pytest.raises(
        FileError, match=r"r\.json: the result is incomplete or damaged \("
    ) as caught:
        read_result(file)
    assert "\n" not in str(caught.value)


def test_a_result_that_is_not_there(tmp_path: Path):
    with pytest.raises(FileError, match=r"calibration result '.*none\.json' does not exist"):
        read_result(tmp_path / "none.json")
