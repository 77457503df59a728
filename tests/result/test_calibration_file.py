from __future__ import annotations

import itertools
import json
import platform
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib
from calib.basics.json_files import plain
from calib.basics.records import json_key, keys_of
from calib.boards.board import Board
from calib.camera.camera import UNKNOWN, Camera
from calib.camera.camera_file import camera_toml
from calib.data.cell import Cell
from calib.data.record import Record
from calib.errors import FileError, ModelError
from calib.example import paper_urdf
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.result.calibration_file import (
    _boards_table,
    _cameras_table,
    _read_boards,
    _read_cameras,
    read_result,
    uncertainty_table,
    write_result,
)
from calib.robot.gravity import Payload
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.calibrate.report import summary
from calib.verbs.evaluate.evaluation import evaluate
from tests.parts import of_an_earlier_version
from tests.places import ROOT

DOC = ROOT / "docs" / "result-json.md"

#: Tables whose keys are not those of the document: names of others.
FREE = ("checksums", "call.cell", "call.files", "call.plugins")


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every key of nested tables, ``a.b`` and ``a[].b``, with its value; lists of plain values are one value."""
    if isinstance(value, dict) and path not in FREE:
        for key, entry in value.items():
            yield from leaves(entry, f"{path}.{key}" if path else key)
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for entry in value:
            yield from leaves(entry, f"{path}[]")
    else:
        yield path, value


@pytest.fixture(scope="module")
def everything(make_scene: Callable[..., Any]) -> Calibration:
    """A result that says all that a result can.

    Poses with covariances, repeats, an outlier and a suspect, ties, a held joint, auto.
    """
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
    covariances = np.tile(np.diag(np.repeat([2e-5, 1e-4], 3) ** 2), (40, 1, 1))
    m = replace(
        m,
        joints=joints,
        points=points,
        rotations=rotations,
        covariances=covariances,
        sets=sets,
        orientation="kuka",
    )
    cell = Cell(
        estimate_frame=True,
        held={"wrist_3_joint": 0.4},
        frozen=("d2",),
        ties={"a3": ("a2", 1.0)},
        payload=Payload(1.0, np.array([0.0, 0.0, 0.1])),
        record=Record(order="4711", temperature_C=(20.5, 21.0)),
    )
    result = calibrate(robot, m, cell=cell)
    assert result.non_geometric is not None
    assert result.rows.outliers
    assert result.rows.suspects
    assert result.noise.repeats is not None
    assert result.noise.pose_noise is not None
    return result


def differences(one: Any, other: Any, path: str = "") -> list[str]:
    """Where two values differ, field by field, to 1e-12."""
    if isinstance(one, np.ndarray):
        same = one.shape == other.shape and np.allclose(one, other, 1e-12, 1e-12, equal_nan=True)
        return [] if same else [path]
    if is_dataclass(one):
        if type(one) is not type(other):
            return [path]
        names = [
            f.name
            for f in fields(one)
            if f.name not in ("fit_in_memory", "path") and f.name[0] != "_"
        ]
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
    assert differences(Calibration(**{f.name: getattr(c, f.name) for f in fields(c)}), read) == []
    assert summary(read) == c.summary()
    assert set(read.zeros.errors) == set(c.cross_validation.errors_without_outliers.units)


def test_everything_is_read_back(everything: Calibration, tmp_path: Path):
    read = Calibration.read_json(everything.write_json(tmp_path / "r.json"))
    assert differences(everything, read) == []
    assert read.fit_in_memory is None
    with pytest.raises(ModelError, match="read from a file, which holds neither"):
        _ = read.fit.measurements


def test_a_result_of_an_earlier_version_has_no_record(
    everything_json: dict[str, Any], tmp_path: Path
):
    path = tmp_path / "earlier.json"
    table = of_an_earlier_version(everything_json)
    del table["record"]
    path.write_text(json.dumps(table), encoding="utf-8")
    assert everything_json["record"]["temperature_C"] == [20.5, 21.0]
    assert read_result(path).record == Record()


@pytest.fixture(scope="module")
def everything_json(
    everything: Calibration, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Any]:
    path = write_result(everything, tmp_path_factory.mktemp("result") / "result.json")
    loaded: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return loaded


def test_a_result_that_does_not_say_how_orientations_were_given(
    everything_json: dict[str, Any], tmp_path: Path
):
    assert everything_json["inputs"]["measurements"]["orientation"] == "kuka"
    table = of_an_earlier_version(everything_json)
    del table["inputs"]["measurements"]["orientation"]
    (tmp_path / "r.json").write_text(json.dumps(table), encoding="utf-8")
    assert read_result(tmp_path / "r.json").source.orientation == ""


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
    assert result_json["schema"] == 7
    for who, sets in c.errors.items():
        for name, errors in sets.items():
            stored = result_json["errors"][who][name]
            assert set(stored) == {"m"}
            assert stored["m"]["n"] == errors["m"].n
            assert stored["m"]["max"] == errors["m"].max
            assert stored["m"]["mean"] == errors["m"].mean
            assert stored["m"]["rms"] == errors["m"].rms
            np.testing.assert_array_equal(stored["m"]["span_axis"], errors["m"].span_axis)
    assert c.cross_validation is not None
    assert (
        result_json["cross_validation"]["errors"]["m"]["rms"] == c.cross_validation.errors["m"].rms
    )
    assert result_json["cross_validation"]["without_outliers"]["m"]["n"] == 30 - len(
        c.rows.outliers
    )
    assert [p["name"] for p in result_json["parameters"]] == list(c.model.names)
    assert [p["value"] for p in result_json["parameters"]] == [p.value for p in c.parameters]
    np.testing.assert_array_equal(result_json["covariance"], c.covariance)
    np.testing.assert_array_equal(result_json["frames"]["target_m"], c.target)
    np.testing.assert_array_equal(
        result_json["rows"]["residual_calibrated"], c.rows.residual_calibrated
    )
    assert c.trust.robustness is not None
    assert result_json["robustness"]["weights_lowered"] is True
    assert result_json["robustness"]["moved_max_m"] == c.trust.robustness.moved_max
    assert result_json["robustness"]["full"]["m"]["rms"] == c.trust.robustness.errors_full["m"].rms
    assert result_json["rows"]["numbers"] == list(range(1, 36))
    assert result_json["rows"]["weights"] == c.rows.weights.tolist()
    assert result_json["rows"]["sets"] == ["estimate"] * 30 + ["validate"] * 5
    assert c.verdict is not None
    told = result_json["verdict"]
    assert (told["use"], told["reasons"][0]["code"]) == (c.verdict.use, "gain")
    assert result_json["versions"]["calib"] == calib.__version__
    # The instructions that need the newest processor, as each set has those before it.
    instructions = np.show_config("dicts")["SIMD Extensions"]
    newest = (instructions.get("found") or instructions.get("baseline", []))[-1:]
    assert result_json["versions"]["cpu"].split() == [platform.machine(), *newest]


def documented(heading: str) -> set[str]:
    """The keys of the tables under a heading of the document, groups and braces expanded."""
    page = DOC.read_text(encoding="utf-8")
    groups = {
        name: ",".join(re.findall(r"`(\w+)`", keys))
        for name, keys in re.findall(r"^\| ([A-Z]+) \| (.*) \|$", page, re.MULTILINE)
    } | {"ROBOT": "nominal,urdf,calibration,larger"}
    section = page.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    keys = set()
    for path in re.findall(r"^\| `([^`]+)` \|", section, re.MULTILINE):
        for name, own in groups.items():
            path = re.sub(rf"([{{,])({name})([,}}])", rf"\g<1>{own}\g<3>", path)
            path = re.sub(rf"\b{name}\b", f"{{{own}}}", path)
        pieces = re.split(r"\{([^}]*)\}", path)
        choices = [p.split(",") if i % 2 else [p] for i, p in enumerate(pieces)]
        keys |= {"".join(parts) for parts in itertools.product(*choices)}
    return keys


#: Tables and lists that may be missing or empty.
WHOLE = {
    "cross_validation", "verdict", "non_geometric", "non_geometric.payload", "non_geometric.cross_validation",
    "noise.repeats",
    "noise.prior_std", "parameters", "outliers", "suspects", "observability.unidentifiable", "model.candidates",
    "model.ties", "robot.held", "robot.coupling", "robot.branches", "inputs.robots", "chains",
    "expected.board", "non_geometric.expected.board", "non_geometric.expected.validation_board",
    "robustness", "outside", "verdict.reasons",
    "verdict.reasons[].values", "plugins", "frames.optics", "frames.nominal.optics", "non_geometric.frames.optics",
    "cameras", "boards", "nominal_cameras", "nominal_boards", "frames.stated_places", "non_geometric.stated_places",
    "pose_validation", "non_geometric.pose_validation", "uncertainty.non_geometric", "forecast.urdf",
    "forecast.non_geometric", "expected.undetermined", "drift",
}  # fmt: skip


def test_the_document_has_every_key_of_a_file_and_no_other(everything_json: dict[str, Any]):
    found = {path for path, _ in leaves(everything_json)}
    assert found - documented("Keys") - WHOLE == set()
    missing = {
        path
        for path in documented("Keys") - found
        if not path.startswith(
            (
                "outside",
                "model.ties",
                "robot.held",
                "robot.coupling",
                "robot.branches",
                "inputs.robots",
                "chains",
                "drift.",
                "forecast.",
                "uncertainty.non_geometric.",
                "expected.board",
                "non_geometric.payload",
                "noise.sigma_given",
                "plugins",
                "cameras",
                "boards",
                "nominal_",
            )
        )
        and ".optics[]" not in path
        and ".stated_places[]" not in path
        and "pose_validation." not in path
        and not path.startswith("expected.undetermined.")
    }
    assert all("prior_std." in path for path in missing), (
        missing
    )  # no model has every family of errors


def test_a_result_read_back_meets_every_row_as_the_fit_did(case: Any, tmp_path: Path):
    """Geometry and non-geometric model, from the nominal and the corrected URDF, for every kind of measurement."""
    scene, c = case
    stored = read_result(c.write_json(tmp_path / "r.json"))
    held = stored.nominal.held
    assert held == dict(c.nominal.held)
    corrected = Robot.load(c.write_urdf(tmp_path / "c.urdf"), "base", "tool0", held=held)
    for robot in (scene.robot, corrected):
        bare = Cell(held=held)
        again = evaluate(stored.corrected(robot), c.fit.measurements, bare, known=stored.setup)
        assert again.registered == ()
        np.testing.assert_array_equal(again.used, c.rows.channels.used)
        np.testing.assert_allclose(again.residual, c.rows.residual_calibrated, rtol=0, atol=1e-9)
        assert (stored.non_geometric is None) == (c.non_geometric is None)
        if stored.non_geometric is not None:
            nominal = stored.uncorrected(robot)
            non_geometric = evaluate(
                nominal, c.fit.measurements, bare, non_geometric=stored.non_geometric
            )
            assert non_geometric.registered == ()
            np.testing.assert_allclose(
                non_geometric.residual, c.non_geometric.residual, rtol=0, atol=1e-9
            )
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


@pytest.mark.parametrize("text", ["{}", "[]", "null", '{"schema": 2}'])
def test_another_schema(tmp_path: Path, text: str):
    path = tmp_path / "r.json"
    path.write_text(text, encoding="utf-8")
    said = r"r\.json: its 'schema' is (None|2); a result of calib .* has 7\..*calib calibrate ROBOT DATA --json r"
    with pytest.raises(FileError, match=said):
        read_result(path)


@pytest.mark.parametrize(
    ("path", "bad"),
    [
        ("robot.tip", "nowhere"),
        ("robot.held", [{"joint": "a", "value": "b", "unit": "rad"}]),
        ("robot.coupling", [{"joint": "a", "reading": "b", "factor": 1.0}]),
        ("robot.ranges", []),
        ("frames.T_tip_target.0.0.0", None),
        ("frames.targets", 7),
        ("frames.T_frame_base", ...),
        ("inputs.urdf.text", "<robot/>"),
        ("covariance.0", None),
        ("covariance.0.1", None),
        ("x.0", None),
        ("parameters.0.name", "a9"),
        ("parameters.0.data_gradient", None),
        ("model.terms.0.place", "nowhere"),
        ("non_geometric.x", [1.0]),
        ("non_geometric.payload", {"mass_kg": -1.0, "com_m": [0.0, 0.0, 0.0]}),
        ("rows.numbers", [1, 2]),
        ("rows.residual_nominal", "far"),
        ("verdict.use", "do not usd"),
        ("verdict.use", None),
        ("verdict", None),
        ("non_geometric.verdict", None),
        ("inputs.urdf.sha256", "0" * 64),
        ("robot.origins.2.xyz_m.0", 0.25),
        ("robot.origins.1.rpy_rad.2", 0.25),
        ("robot.joints.0", "another"),
        ("errors.calibrated.estimation.m.rms", 1e-6),
        ("frames.target_m.0", 0.3),
    ],
)
def test_a_damaged_result(everything_json: dict[str, Any], tmp_path: Path, path: str, bad: Any):
    damaged = of_an_earlier_version(everything_json)
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


# A file that was changed


@pytest.fixture(scope="module")
def contents(everything: Calibration, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("result") / "result.json"
    return write_result(everything, path).read_bytes()


def bent(contents: bytes, random: np.random.Generator) -> bytes:
    """The file with one digit changed, or one bit flipped anywhere in it, each in half of all cases."""
    spoilt = bytearray(contents)
    if random.random() < 0.5:
        digits = [k for k, byte in enumerate(contents) if chr(byte).isdigit()]
        k = random.choice(digits)
        spoilt[k] = ord("0") + (spoilt[k] - ord("0") + random.integers(1, 10)) % 10
    else:
        spoilt[random.integers(len(contents))] ^= 1 << int(random.integers(8))
    return bytes(spoilt)


@pytest.mark.parametrize("count", [12, pytest.param(600, marks=pytest.mark.slow)])
def test_flipped_bits_and_digits_are_refused_or_without_effect(
    everything: Calibration, contents: bytes, tmp_path: Path, count: int
):
    random = np.random.default_rng([44, count])
    path = tmp_path / "r.json"
    refused = 0
    for _ in range(count):
        path.write_bytes(bent(contents, random))
        try:
            read = read_result(path)
        except FileError:
            refused += 1
            continue
        assert differences(everything, read) == []
    assert refused > 0.9 * count


@pytest.mark.parametrize("everything_of_the_run", [True, False])
def test_a_missing_line_is_noticed(
    everything_json: dict[str, Any], tmp_path: Path, everything_of_the_run: bool
):
    """Without its checksums a file with a run's id is not one of an earlier version."""
    table = of_an_earlier_version(everything_json)
    expected = r"earlier\.json: 'checksums' is missing\. Take the file as it was written"
    table["run"] = everything_json["run"]
    if everything_of_the_run:
        table |= {key: everything_json[key] for key in ("checksums", "outputs")}
        del table["record"]
        expected = r"earlier\.json: 'record' was changed after calib wrote the file"
    path = tmp_path / "earlier.json"
    path.write_text(json.dumps(table), encoding="utf-8")
    with pytest.raises(FileError, match=expected):
        read_result(path)


def test_what_was_edited_is_named(everything_json: dict[str, Any], tmp_path: Path):
    table = json.loads(json.dumps(everything_json))
    table["verdict"]["use"] = "use"
    table["x"][0] *= 1.0 + 1e-15
    path = tmp_path / "r.json"
    path.write_text(json.dumps(table), encoding="utf-8")
    with pytest.raises(FileError, match=r"r\.json: 'x', 'verdict' were changed") as caught:
        read_result(path)
    assert "--accept" in str(caught.value)


@pytest.mark.parametrize("style", ["pretty", "sorted", "windows", "javascript", "own key"])
def test_a_file_may_be_written_anew_with_all_digits(
    everything: Calibration, everything_json: dict[str, Any], tmp_path: Path, style: str
):
    text = json.dumps(everything_json, indent=4)
    if style == "sorted":
        text = json.dumps(everything_json, sort_keys=True, separators=(",", ":"))
    elif style == "windows":
        text = "\ufeff" + text.replace("\n", "\r\n")
    elif style == "javascript":
        text = re.sub(r"(?<=\d)\.0(?=[,\n])", "", text)
        assert len(text) < len(json.dumps(everything_json, indent=4))
    elif style == "own key":
        text = json.dumps({**everything_json, "remark": "before the new gripper"})
    path = tmp_path / "r.json"
    path.write_bytes(text.encode())
    assert differences(everything, read_result(path)) == []


# Cameras and boards

#: Numbers of a fisheye lens.
FISHEYE = [420.1, 418.0, 641.0, 358.0, -0.02, 0.01, -4e-3, 6e-17]


def as_json(table):
    """What a JSON file holds of a table."""
    return json.loads(json.dumps(plain(table)))


def attributes(value):
    return {field.name: plain(getattr(value, field.name)) for field in fields(value)}


def test_cameras_are_read_back():
    size = {"width": 1280, "height": 720, "lens": "fisheye"}
    cameras = {
        "": Camera(**size),
        "left": Camera(name="eye", values=FISHEYE, sigma=[0.0, *[1.5] * 6, UNKNOWN], **size),
        "right": Camera(values=FISHEYE, **size),
    }
    table = as_json(_cameras_table(cameras))
    assert table[1]["sigma"][-1] is None
    assert table[1]["lens_names"] == ["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"]
    found = _read_cameras(table)
    assert list(found) == ["", "left", "right"]
    for key, camera in cameras.items():
        assert attributes(found[key]) == attributes(camera)
    assert found["left"].sigma[-1] == UNKNOWN
    assert found["right"].sigma is None


def test_boards_are_read_back():
    board = Board(
        name="sheet",
        pattern="charuco",
        columns=7,
        rows=4,
        square=0.02985,
        marker=0.0221,
        dictionary="DICT_5X5_100",
        first_marker=3,
        legacy=True,
        sigma_scale=0.00123,
        sigma_corner=3e-5,
        sigma_warp=2.5e-3,
    )
    table = as_json(_boards_table({"": board}))
    assert (table[0]["square_m"], table[0]["sigma_corner_m"]) == (0.02985, 3e-5)
    assert attributes(_read_boards(table)[""]) == attributes(board)
    cube = Board(
        pattern="body",
        dictionary="DICT_4X4_50",
        tags=((7, ((0.0, 0.0, 0.01), (0.03, 0.0, 0.01), (0.03, 0.03, 0.01), (0.0, 0.03, 0.01))),),
    )
    assert _read_boards(as_json(_boards_table({"": cube})))[""].tags == cube.tags
    # Of a file that is older than a key, the default counts; a key without one must be there.
    del table[0]["legacy"]
    assert not _read_boards(table)[""].legacy
    del table[0]["pattern"]
    with pytest.raises(KeyError):
        _read_boards(table)


def test_every_key_of_a_camera_is_in_both_files():
    """A new flag of a camera is a field, and nothing else."""
    camera = Camera(width=640, height=480)
    (table,) = _cameras_table({"": camera})
    toml = camera_toml(camera)
    rows = keys_of(Camera)
    assert {field.name for field, _ in rows} == {"name", "width", "height", "lens"}
    for field, row in rows:
        assert table[json_key(field)] == getattr(camera, field.name)
        assert f"{row.name} = " in toml


def test_the_budget_is_in_the_file_and_is_not_read(default_result: Calibration, tmp_path: Path):
    """Each number is that of the budget; a result read and written again states the same one."""
    path = default_result.write_json(tmp_path / "r.json")
    table = json.loads(path.read_text(encoding="utf-8"))["uncertainty"]
    budget = default_result.budget(non_geometric=False)
    assert table["position_m"] == budget.position
    assert table["non_geometric"] is None
    lines = {line["source"]: line for line in table["lines"]}
    assert list(lines) == [line.source.value for line in budget.lines]
    for line in budget.lines:
        stated = lines[line.source.value]
        assert stated["position_std_m"] == line.position_std
        assert stated["freedom"] == (line.freedom if np.isfinite(line.freedom) else None)
        assert stated["without_m"] == budget.without[line.source]
    variance = sum(line["position_std_m"] ** 2 for line in table["lines"])
    assert variance == pytest.approx(table["position_std_m"] ** 2)
    assert sum(line["share"] for line in table["lines"]) == pytest.approx(1.0)
    again = read_result(path).write_json(tmp_path / "again.json")
    assert json.loads(again.read_text(encoding="utf-8"))["uncertainty"] == table


def test_without_knowledge_of_the_accuracy_there_is_no_budget(default_result: Calibration):
    geometry = replace(default_result.geometry, cross_validation=None)
    wrong = replace(default_result, geometry=geometry)  # a verdict without held-out errors
    assert wrong.unknown_accuracy == "verdict"
    no_verdict = replace(geometry, verdict=None)
    assert replace(wrong, geometry=no_verdict).unknown_accuracy == ""
    few = replace(default_result.noise, freedom=5.0)
    assert replace(wrong, geometry=no_verdict, noise=few).unknown_accuracy == "rows"
    assert default_result.unknown_accuracy == ""
    assert uncertainty_table(wrong) is None
