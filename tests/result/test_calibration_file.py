from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib
from calib.calibration import Calibration, calibrate
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import FileError, ModelError, UrdfError
from calib.estimate.statistics import Errors
from calib.example import paper_measurements, paper_urdf
from calib.files import plain
from calib.result.acceptance import acceptance
from calib.result.accuracy import accuracy
from calib.result.calibration import Calibration as Values
from calib.result.calibration_file import ERRORS
from calib.result.calibration_file import read_result, result_table, write_result, write_table
from calib.result.evaluation import evaluate, evaluate_larger
from calib.robot.readback import random_joint_values
from calib.robot.robot import Robot, read_only
from calib.robot.torques import Payload
from calib.text.evaluation import acceptance_table, accuracy_table, evaluation_table
from calib.text.summary import summary

DOC = Path(__file__).parents[2] / "docs" / "result-json.md"

NUMBER = (int, float)


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
def everything(make_scene: Callable[..., Any]) -> Calibration:
    """A result that says all that a result can: poses, repeats, an outlier and a suspect, ties, a held joint, auto."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0", held={"wrist_3_joint": 0.4})
    scene = make_scene(
        51, frames=1, robot=robot, model="dh+gain", other={"gain": 2e-3}, noise=2e-5,
        noise_angle=1e-4, length=3e-4, angle=3e-3,
    )  # fmt: skip
    m = scene.poses(40)
    joints, points = m.joints.copy(), m.points.copy()
    joints[1:4], points[1:4] = joints[0], points[0] + 2e-5 * scene.rng.normal(size=(3, 3))
    rotations = m.rotations.copy()
    rotations[1:4] = rotations[0]
    points[[10, 39]] += 0.03
    sets = ("estimate",) * 34 + ("validate",) * 6
    m = replace(m, joints=joints, points=points, rotations=rotations, sets=sets)
    cell = Cell(
        estimate_frame=True,
        held={"wrist_3_joint": 0.4},
        frozen=("d2",),
        ties={"a3": ("a2", 1.0)},
        payload=Payload(1.0, np.array([0.0, 0.0, 0.1])),
    )
    result = calibrate(robot, m, cell=cell)
    assert result.larger is not None
    assert result.outliers
    assert result.suspects
    assert result.repeats is not None
    return result


def differences(one: Any, other: Any, path: str = "") -> list[str]:
    """Where two values differ, field by field, to 1e-12."""
    if isinstance(one, np.ndarray):
        same = one.shape == other.shape and np.allclose(one, other, 1e-12, 1e-12, equal_nan=True)
        return [] if same else [path]
    if is_dataclass(one):
        if type(one) is not type(other):
            return [path]
        names = [f.name for f in fields(one) if f.name not in ("fit", "path") and f.name[0] != "_"]
        return [
            d for n in names for d in differences(getattr(one, n), getattr(other, n), f"{path}.{n}")
        ]
    if isinstance(one, Mapping):
        if set(one) != set(other):
            return [path]
        return [d for k in one for d in differences(one[k], other[k], f"{path}[{k}]")]
    if isinstance(one, tuple):
        if len(one) != len(other):
            return [path]
        pairs = zip(one, other, strict=True)
        return [d for k, (a, b) in enumerate(pairs) for d in differences(a, b, f"{path}[{k}]")]
    if isinstance(one, float):
        return [] if one == pytest.approx(other, 1e-12, 1e-12, nan_ok=True) else [path]
    return [] if one == other else [path]


def test_a_result_read_back_is_the_one_written(case: Any, tmp_path: Path):
    """Field by field, of every kind of measurement; and so is what is said of it."""
    _, c = case
    read = read_result(c.write_json(tmp_path / "r.json"))
    assert differences(Values(**{f.name: getattr(c, f.name) for f in fields(c)}), read) == []
    assert summary(read) == c.summary()


def test_everything_is_read_back(everything: Calibration, tmp_path: Path):
    read = Calibration.read_json(everything.write_json(tmp_path / "r.json"))
    assert differences(everything, read) == []
    assert read.fit is None
    with pytest.raises(ModelError, match="read from a file, which holds neither"):
        _ = read.measurements


@pytest.fixture(scope="module")
def everything_json(
    everything: Calibration, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Any]:
    path = write_result(everything, tmp_path_factory.mktemp("result") / "result.json")
    loaded: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return loaded


@pytest.fixture(scope="module")
def written(default_result: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(default_result, tmp_path_factory.mktemp("result") / "result.json")


@pytest.fixture(scope="module")
def result_json(written: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(written.read_text(encoding="utf-8"))
    return loaded


def test_the_values_are_those_of_the_calibration(
    result_json: dict[str, Any], default_result: Calibration
):
    c = default_result
    assert result_json["schema"] == 3
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
    assert c.robustness is not None
    assert result_json["robustness"]["weights_lowered"] is True
    assert result_json["robustness"]["moved_max_m"] == c.robustness.moved_max
    assert result_json["robustness"]["full"]["rms_m"] == c.robustness.errors_full.rms
    assert [row["row"] for row in result_json["rows"]] == list(range(1, 36))
    assert [row["weight"] for row in result_json["rows"]] == c.weights.tolist()
    assert [row["set"] for row in result_json["rows"]] == ["estimate"] * 30 + ["validate"] * 5
    assert c.verdict is not None
    told = result_json["verdict"]
    assert (told["use"], told["reasons"][0]["code"]) == (c.verdict.use, "gain")
    assert [one["text"] for one in told["reasons"]] == list(map(str, c.verdict.reasons))
    assert result_json["versions"]["calib"] == calib.__version__


def test_the_inputs_are_named_by_their_bytes(result_json: dict[str, Any]):
    for key, path in (("urdf", paper_urdf()), ("measurements", paper_measurements())):
        assert result_json["inputs"][key]["name"] == path.name
        assert result_json["inputs"][key]["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_numbers_agree_with_each_other(result_json: dict[str, Any]):
    for p in result_json["parameters"]:
        assert p["low"] < p["value"] < p["high"]
        assert p["value"] - p["nominal"] == pytest.approx(p["delta"], abs=1e-15)
        assert p["at_bound"] is False
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
    "number, text": lambda v: isinstance(v, (*NUMBER, str)),
    "true, false": lambda v: isinstance(v, bool),
    "3 numbers": lambda v: len(v) == 3 and all(isinstance(x, float) for x in v),
    "p numbers": lambda v: len(v) > 20 and all(isinstance(x, float) for x in v),
    "p lists of p numbers": lambda v: np.shape(v)[0] == np.shape(v)[1] > 20,
    "1 or 3 numbers": lambda v: len(v) in (0, 1, 3) and all(isinstance(x, float) for x in v),
    "list of texts": lambda v: isinstance(v, list) and all(isinstance(x, str) for x in v),
    "list of numbers": lambda v: all(x is None or isinstance(x, float) for x in v),
    "list": lambda v: isinstance(v, list),
    "6 numbers": lambda v: len(v) == 6,
    "6 lists of p numbers": lambda v: np.shape(v)[0] == 6,
    "lists of numbers": lambda v: np.ndim(v) == 2,
    "table": lambda v: isinstance(v, dict),
    "as above": lambda _: True,
}


#: Tables and lists that may be missing or empty, and that the document describes as a whole too.
WHOLE = {
    "cross_validation", "verdict", "larger", "larger.payload", "larger.cross_validation", "noise.repeats",
    "parameters", "outliers", "suspects", "observability.unidentifiable", "model.candidates", "model.ties",
    "robot.held", "robustness", "outside", "outside[].index", "outside[].joints[].joint",
    "outside[].joints[].prismatic", "outside[].joints[].by", "verdict.reasons", "verdict.reasons[].values",
}  # fmt: skip


def test_the_document_has_every_key_of_a_file_and_no_other(everything_json: dict[str, Any]):
    found = {path for path, _ in leaves(everything_json)}
    assert found - set(documented("Keys")) == set()
    # No model has every family of errors.
    sizes = {path for path in documented("Keys") if "sizes.ecc" in path or "sizes.compl" in path}
    assert set(documented("Keys")) - found - WHOLE == sizes & {
        p for p in sizes if p.startswith("larger")
    }


def test_no_result_has_a_key_that_is_not_documented(case: Any, tmp_path: Path):
    _, c = case
    stored = json.loads(write_result(c, tmp_path / "r.json").read_text(encoding="utf-8"))
    assert {path for path, _ in leaves(stored)} <= set(documented("Keys")) | WHOLE


def test_the_document_tells_the_types(everything_json: dict[str, Any]):
    found: dict[str, list[Any]] = {}
    for path, value in leaves(everything_json):
        found.setdefault(path, []).append(value)
    for path, kind in documented("Keys").items():
        fits = TYPES[kind.removesuffix(", null")]
        values = at(everything_json, path) if path in WHOLE else found.get(path, [])
        for value in values:
            fine = kind.endswith((", null", "as above")) if value is None else fits(value)
            assert fine, (path, value)


WHO = ("nominal", "urdf", "calibration", "larger")


def evaluation_keys() -> set[str]:
    return set(documented("What `calib evaluate --json` writes"))


def test_the_document_has_every_key_of_an_evaluation(
    ur3: Robot, table: Measurements, calibrated: Any, tmp_path: Path
):
    bare = evaluate(ur3, table)
    assert set(evaluation_table({"urdf": bare})["errors"]) == {"urdf"}
    both = evaluation_table(dict.fromkeys(WHO, bare))
    stored = json.loads(write_table(both, tmp_path / "e.json").read_text(encoding="utf-8"))
    with_angles = {
        path for path in evaluation_keys() if path.endswith("_rad") and "frames" not in path
    }
    assert evaluation_keys() - with_angles == {path for path, _ in leaves(stored)}
    _, turned = calibrated("poses")
    found = evaluate(turned.nominal, turned.measurements, turned.cell)
    angles = evaluation_table(dict.fromkeys(WHO, found))
    assert evaluation_keys() == {
        path for path, _ in leaves(json.loads(json.dumps(angles, default=list)))
    }
    assert stored["schema"] == "evaluation 1"
    assert stored["frames"]["registered"] == ["target"]
    assert stored["errors"]["urdf"]["all"]["n"] == 35
    with pytest.raises(FileError, match="its 'schema' is 'evaluation 1'; a result of calib"):
        read_result(tmp_path / "e.json")


def test_the_document_has_every_key_of_an_acceptance_with_its_type(calibrated: Any):
    _, c = calibrated("poses")
    found = evaluate(c.nominal, c.measurements, c.cell)
    accepted = acceptance(found, 1.0, 1.0)
    tables = {
        "accuracy": {"ROBOT": accuracy_table(accuracy(found))},
        "acceptance": acceptance_table(accepted, "urdf", "the robot"),
    }
    stored = json.loads(json.dumps(plain(tables)))
    keys = documented("Accuracy and acceptance in the same file")
    whole = {"acceptance", "acceptance.length", "acceptance.angle"}
    assert {path for path, _ in leaves(stored)} == set(keys) - whole
    types = {**TYPES, "list of integers": lambda v: all(isinstance(x, int) for x in v)}
    for path, kind in keys.items():
        if kind != "as above":
            for value in at(stored, path):
                missing = value is None and kind.endswith(", null")
                assert missing or types[kind.removesuffix(", null")](value), (path, value)


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
    assert stored["noise"]["sizes"] == {}
    assert stored["noise"]["sigma_angle_rad"] is None
    assert stored["larger"] is None
    nominal = {p["name"]: p["nominal"] for p in stored["parameters"]}
    assert nominal["target_x"] is None
    assert nominal["a2"] == pytest.approx(-0.24365)
    assert stored["suspects"] == []
    assert at(stored, "outliers[].row") == [o.row for o in bare.outliers]
    # Lists may be empty and tables null, but no key is missing.
    known = set(documented("Keys")) | WHOLE | {"noise.sizes"}
    assert {path for path, _ in leaves(stored)} <= known


def test_an_existing_file_is_kept_unless_asked(default_result: Calibration, tmp_path: Path):
    path = tmp_path / "r.json"
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(FileError, match=r"r\.json' exists already; add --force"):
        default_result.write_json(path)
    assert path.read_text(encoding="utf-8") == "mine"
    assert default_result.write_json(path, overwrite=True) == path
    assert read_result(path).nominal.tip == "tool0"


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


def test_an_estimated_frame_is_read_back(ur3: Robot, table: Measurements, tmp_path: Path):
    T = np.array([[0.0, -1, 0, 1], [0, 0, -1, 2], [1, 0, 0, 3], [0, 0, 0, 1]])  # pitch of 90 deg
    moved = replace(table, points=read_only(table.points @ T[:3, :3].T + T[:3, 3]))
    result = calibrate(ur3, moved, cell=Cell(estimate_frame=True), validate=False)
    stored = read_result(write_result(result, tmp_path / "r.json"))
    np.testing.assert_allclose(stored.T_frame_base, result.T_frame_base, atol=1e-12)
    again = evaluate(stored.corrected(ur3), moved, known=stored.setup)
    for name in ("estimation", "validation"):
        wanted = result.errors["calibrated"][name]
        assert again.errors[name].rms == pytest.approx(wanted.rms, abs=1e-9)
        assert again.errors[name].max == pytest.approx(wanted.max, abs=1e-9)


def test_a_result_read_back_meets_every_row_as_the_fit_did(case: Any, tmp_path: Path):
    """Geometry and larger model, from the nominal URDF and from the corrected one, for every kind of measurement."""
    scene, c = case
    stored = read_result(c.write_json(tmp_path / "r.json"))
    held = stored.nominal.held
    assert held == dict(c.nominal.held)
    corrected = Robot.load(c.write_urdf(tmp_path / "c.urdf"), "base", "tool0", held=held)
    for robot in (scene.robot, corrected):
        bare = Cell(held=held)
        again = evaluate(stored.corrected(robot), c.measurements, bare, known=stored.setup)
        assert again.registered == ()
        np.testing.assert_array_equal(again.used, c.used)
        np.testing.assert_allclose(again.residual, c.residual_calibrated, rtol=0, atol=1e-9)
        larger = evaluate_larger(stored, robot, c.measurements, bare)
        assert (larger is None) == (c.larger is None)
        if larger is not None:
            assert larger.registered == ()
            np.testing.assert_allclose(larger.residual, c.larger.residual, rtol=0, atol=1e-9)
        q = random_joint_values(robot, 20, 3)
        np.testing.assert_allclose(stored.tip_poses(q), c.tip_poses(q), rtol=0, atol=1e-12)
        for target in c.setup.targets:
            where = {"target": target, "group": c.setup.groups[-1]}
            wanted = c.predict_poses(q, **where)
            np.testing.assert_allclose(stored.predict_poses(q, **where), wanted, rtol=0, atol=1e-12)
            np.testing.assert_allclose(
                stored.position_std(q, **where), c.position_std(q, **where), rtol=1e-9
            )
            np.testing.assert_allclose(stored.position_std(q), c.position_std(q), rtol=1e-9)


def test_ties_and_frozen_parameters_are_read_back(everything: Calibration, tmp_path: Path):
    stored = read_result(everything.write_json(tmp_path / "r.json"))
    assert stored.larger is not None
    assert everything.larger is not None
    assert (dict(stored.ties), stored.frozen) == ({"a3": ("a2", 1.0)}, ("d2",))
    assert not {"a3", "d2"} & set(stored.larger.model.names)
    found = evaluate_larger(stored, everything.nominal, everything.measurements, Cell())
    assert found is not None
    np.testing.assert_allclose(found.residual, everything.larger.residual, rtol=0, atol=1e-9)


def test_another_payload_bends_a_compliant_arm(calibrated: Any, tmp_path: Path):
    _, c = calibrated("compliance")
    stored = read_result(c.write_json(tmp_path / "r.json"))
    q = random_joint_values(c.nominal, 20, 3)
    empty = stored.tip_poses(q, payload=Payload(0.0))
    assert 1e-5 < np.abs(stored.tip_poses(q)[:, :3, 3] - empty[:, :3, 3]).max() < 1e-2
    lighter = evaluate_larger(stored, c.nominal, c.measurements, Cell(payload=Payload(0.0)))
    same = evaluate_larger(stored, c.nominal, c.measurements, Cell())
    assert lighter.errors["all"].rms > 2 * same.errors["all"].rms


def test_a_set_up_that_the_result_lacks_must_be_found(calibrated: Any, tmp_path: Path):
    _, c = calibrated("set-ups")
    stored = read_result(c.write_json(tmp_path / "r.json"))
    groups = tuple("new" if g == "1" else g for g in c.measurements.groups)
    moved = replace(c.measurements, groups=groups)
    with pytest.raises(
        ModelError, match=r"set-ups '0', '1', '2'; the table's 'new' are none.*--frame estimate"
    ):
        evaluate(c.robot, moved, known=stored.setup)
    found = evaluate(c.robot, moved, Cell(estimate_frame=True), known=stored.setup)
    assert found.registered == ("frame",)
    old = np.array([g != "new" for g in groups])
    np.testing.assert_allclose(found.residual[old], c.residual_calibrated[old], rtol=0, atol=1e-9)
    assert found.errors["all"].rms < 1.1 * c.errors["calibrated"]["estimation"].rms


def test_orientations_of_a_target_known_as_a_point_are_registered(calibrated: Any, tmp_path: Path):
    """A result from points says where the target is, not how it is turned."""
    scene, c = calibrated("points")
    stored = read_result(c.write_json(tmp_path / "r.json"))
    assert not stored.setup.oriented
    turned = scene.poses(30)
    found = evaluate(c.robot, turned, known=stored.setup)
    assert found.registered == ("target",)
    assert found.errors["all"].rms_angle < 1e-3
    assert found.errors["all"].rms < 1e-4


def test_a_robot_without_the_joints_is_refused(written: Path, panda_or_other: Robot):
    with pytest.raises(UrdfError, match="has no joint 'shoulder_pan_joint'"):
        read_result(written).corrected(panda_or_other)


@pytest.fixture(scope="module")
def panda_or_other() -> Robot:
    return Robot.load("panda", base="panda_link0", tip="panda_link8")


@pytest.mark.parametrize("data", [b"", b"\xff\xfe\x00", b"set,x [mm]\n1,2\n", b"[" * 100_000])
def test_what_is_not_json(tmp_path: Path, data: bytes):
    path = tmp_path / "r.json"
    path.write_bytes(data)
    with pytest.raises(FileError, match=r"r\.json: this is not a JSON file: ") as caught:
        read_result(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["{}", "[]", "null", '{"schema": 2}'])
def test_another_schema(tmp_path: Path, text: str):
    path = tmp_path / "r.json"
    path.write_text(text, encoding="utf-8")
    said = r"r\.json: its 'schema' is (None|2); a result of calib .* has 3\..*calib fit ROBOT DATA --json r"
    with pytest.raises(FileError, match=said):
        read_result(path)


@pytest.mark.parametrize(
    ("path", "bad"),
    [
        ("robot.tip", "nowhere"),
        ("robot.held", [{"joint": "a", "value": "b", "unit": "rad"}]),
        ("robot.ranges", []),
        ("frames.targets.0.xyz_m", [1.0, 2.0, None]),
        ("frames.targets", []),
        ("frames.set_ups.0.frame_base_xyz_m", ...),
        ("inputs.urdf.text", "<robot/>"),
        ("covariance.0", None),
        ("covariance.0.1", 1e3),
        ("x.0", None),
        ("parameters.0.name", "a9"),
        ("parameters.0.push", None),
        ("model.terms.0.place", "nowhere"),
        ("larger.x", [1.0]),
        ("larger.payload", {"mass_kg": -1.0, "com_m": [0.0, 0.0, 0.0]}),
        ("rows.0.set", "all"),
        ("rows.0.residual_nominal_m", "far"),
    ],
)
def test_a_damaged_result(everything_json: dict[str, Any], tmp_path: Path, path: str, bad: Any):
    damaged = json.loads(json.dumps(everything_json))
    *folders, key = (int(part) if part.isdigit() else part for part in path.split("."))
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
        FileError,
        match=r"r\.json: the result is damaged \(",
    ) as caught:
        read_result(file)
    assert "\n" not in str(caught.value)


def test_a_result_that_is_not_there(tmp_path: Path):
    with pytest.raises(FileError, match=r"calibration result '.*none\.json' does not exist"):
        read_result(tmp_path / "none.json")


def test_every_row_has_the_residuals_of_its_kind(case):
    _, c = case
    widths = {"point": 3, "pose": 3, "distance": 1, "fixed": 3, "plane": 1}
    for row, kind, used in zip(result_table(c)["rows"], c.measurements.kinds, c.used, strict=True):
        assert row["kind"] == kind
        wanted = widths.get(kind, int(used.sum()))
        assert len(row["residual_nominal_m"]) == len(row["residual_calibrated_m"]) == wanted
        assert ("residual_calibrated_rad" in row) == (kind == "pose")


def test_a_distance_is_said_once_for_a_pair(calibrated):
    _, c = calibrated("pairs")
    lengths = [len(row["residual_calibrated_m"]) for row in result_table(c)["rows"]]
    assert lengths == [1, 0] * 76


def test_frames_and_targets_are_those_of_the_result(case):
    _, c = case
    frames = result_table(c)["frames"]
    assert [f["group"] for f in frames["set_ups"]] == list(c.setup.groups)
    assert [t["target"] for t in frames["targets"]] == list(c.setup.targets)
    for f, T, directions in zip(
        frames["set_ups"], c.setup.T_frame_base, c.setup.unknown, strict=True
    ):
        np.testing.assert_array_equal(f["frame_base_xyz_m"], T[:3, 3])
        assert f["estimated"] == list(directions)
    turned = "pose" in c.measurements.kinds
    assert all((t["rpy_rad"] is not None) == turned for t in frames["targets"])


def test_held_joints_with_their_unit(calibrated):
    _, c = calibrated("held")
    assert result_table(c)["robot"]["held"] == [
        {"joint": "wrist_2_joint", "value": 0.8, "unit": "rad"}
    ]
    assert result_table(calibrated("points")[1])["robot"]["held"] == []


def test_the_larger_model_is_whole(calibrated):
    _, c = calibrated("compliance")
    larger = result_table(c)["larger"]
    assert larger["set"] == "dh+compliance"
    assert larger["names"] == [p["name"] for p in larger["parameters"]]
    np.testing.assert_array_equal(larger["x"], c.larger.x)
    assert larger["payload"]["mass_kg"] == 5.0
    np.testing.assert_array_equal(larger["gravity_m_s2"], [0.0, 1.0, -9.75])
    assert "compliance_rad_Nm" in larger["sizes"]
    assert larger["errors"]["validation"]["rms_m"] == c.errors["larger"]["validation"].rms


def test_angles_only_where_there_are_any():
    assert "n_rad" not in ERRORS.table(Errors.of(np.ones((2, 3))))
    table = ERRORS.table(Errors.of(np.ones((2, 6))))
    assert table["n_rad"] == 2
    assert table["max_rad"] == pytest.approx(np.sqrt(3))
    lengths = ERRORS.table(Errors.of(np.ones((2, 1))))
    assert np.all(np.isnan(lengths["rms_xyz_m"]))
