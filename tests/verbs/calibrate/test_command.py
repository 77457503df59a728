from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from tests.places import ROOT

DOCS = ROOT / "docs"


def load(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def values(result: Any) -> dict[str, float]:
    return {p["name"]: p["value"] for p in result["parameters"]}


@pytest.fixture(scope="module")
def reference(examples) -> Any:
    return load(examples.folder / "result.json")


def test_it_says_what_it_found_and_what_it_wrote(examples):
    done = examples.starting("calib calibrate robot.urdf data.csv --base base --tip tool0")
    assert (done.code, done.err) == (0, "")
    assert "\nVerdict: use\n" in done.out
    assert done.lines[-3:] == [
        "Written: corrected.urdf",
        "Written: result.json",
        "Written: view.html",
    ]
    for name in ("corrected.urdf", "result.json", "view.html"):
        assert (examples.folder / name).stat().st_size > 5_000
    assert b"calib_target" not in (examples.folder / "corrected.urdf").read_bytes()
    assert b"calib_target" in (examples.folder / "target.urdf").read_bytes()


def test_the_corrected_urdf_differs_in_origins_and_the_run_alone(examples):
    before = (examples.folder / "robot.urdf").read_text(encoding="utf-8").splitlines()
    after = (examples.folder / "corrected.urdf").read_text(encoding="utf-8").splitlines()
    after.remove(f"<!-- calib run: {load(examples.folder / 'result.json')['run']} -->")
    changed = [a for b, a in zip(before, after, strict=True) if a != b]
    assert 6 <= len(changed) <= 7
    assert all("<origin" in line for line in changed)


def test_the_cell_file_and_freeze_on_the_line(examples):
    done = examples.starting("calib calibrate robot.urdf data.csv --cell cell.toml")
    assert (done.code, done.out, done.err) == (0, "", "")
    result = load(examples.folder / "frozen.json")
    model = result["model"]
    assert (model["set"], model["frozen"], model["candidates"]) == ("dh", ["d2", "d3"], [])
    assert not {"d2", "d3"} & values(result).keys()
    assert result["frames"]["target_given_m"] == pytest.approx([-0.07, 0.07, 0.0225])


def same_errors(evaluated: Any, result: Any) -> None:
    for rows in ("estimation", "validation"):
        for key, value in result["errors"]["calibrated"][rows].items():
            assert evaluated[rows][key] == pytest.approx(value, abs=1e-9, rel=0)


def test_ctrl_c_while_files_are_written_says_which_are(call, shop, monkeypatch):
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("calib.verbs.calibrate.report.write_report", interrupted)
    words = ("robot.urdf", "data.csv", "--base", "base", "--model", "zeros", "--no-validate")
    outputs = ("-o", "c.urdf", "--json", "r.json", "--report", "r.html")
    done = call(shop, "calibrate", *words, *outputs)
    assert (done.code, done.out) == (130, "")
    assert done.err == (
        "calib: interrupted; no file was left half written. Written before: c.urdf, r.json.\n"
    )
    assert (shop / "c.urdf").exists()
    assert (shop / "r.json").exists()
    none = call(shop, "calibrate", *words, "--report", "r.html")
    assert none.err == "calib: interrupted; no file was left half written.\n"


def test_a_wrong_base_is_named_and_no_urdf_is_written(call, shop):
    done = call(shop, "fit", "robot.urdf", "data.csv", "-o", "c.urdf", "--model", "zeros")
    assert done.code == 3
    assert "\nVerdict: do not use\n" in done.out
    assert "the points are in the frame of 'base': try --base base." in " ".join(done.out.split())
    assert not (shop / "c.urdf").exists()
    assert done.err.startswith(
        "calib: the verdict on this calibration is: do not use (other_base): "
    )
    assert done.err.count("\n") == 1


def quick(call, folder: Path, *words: str, base: str = "base") -> Any:
    """A fit without cross-validation; its result."""
    done = call(
        folder, "fit", "robot.urdf", "data.csv", "--base", base, "--no-validate", "--quiet",
        "--json", "q.json", *words,
    )  # fmt: skip
    assert (done.code, done.out, done.err) == (0, "", "")
    return load(folder / "q.json")


@pytest.mark.parametrize(
    ("model", "count", "has"),
    [
        ("paper", 27, "alpha1"),
        ("hayati", 28, "beta2"),
        ("placement", 39, "elbow_joint.rx"),
        ("zeros", 9, "elbow_joint.zero"),
        ("frames", 3, "target_x"),
    ],
)
def test_every_model(call, shop, reference, model: str, count: int, has: str):
    result = quick(call, shop, "--model", model)
    assert result["model"]["set"] == model
    assert result["cross_validation"] is result["verdict"] is None
    found = values(result)
    assert abs(len(found) - count) <= 1  # whether the last row's own beta is counted is the model's
    assert has in found
    if model == "paper":
        assert found == pytest.approx(values(reference), abs=1e-9)
    rms = result["errors"]["calibrated"]["validation"]["m"]["rms"]
    assert rms < {"zeros": 2e-3, "frames": 4e-3}.get(model, 3.5e-4)


@pytest.mark.parametrize(
    ("words", "largest_rms"),
    [
        (("--solver", "scipy"), 3e-4),
        (("--solver", "paper"), 1e-3),
        (("--priors", "given"), 3.5e-4),
        (("--priors", "off"), 3.5e-4),
        (("--no-robust",), 3.5e-4),
    ],
)
def test_solvers_priors_and_weights(call, shop, reference, words: tuple[str, ...], largest_rms):
    result = quick(call, shop, *words)
    assert result["errors"]["calibrated"]["validation"]["m"]["rms"] < largest_rms
    if words[-1] != "paper":
        assert 11 in [outlier["row"] for outlier in result["outliers"]]
    noise = result["noise"]
    assert (noise["prior_std"] == {}) == (words[-1] in ("off", "paper"))
    if words[-1] == "given":
        assert noise["prior_std"] == {"length_m": 0.003, "angle_rad": 0.015, "zero_rad": 0.015}
    if words[-1] == "scipy":
        assert result["solver"]["name"] == "scipy"
        assert values(result) == pytest.approx(values(reference), abs=1e-5)
    if words[-1] == "--no-robust":
        assert noise["sigma"]["m"] > 1.5 * reference["noise"]["sigma"]["m"]


def test_auto_is_the_default_and_says_what_it_tried(examples, reference):
    """The paper's 30 rows carry DH, and neither more placements nor errors of the joints' state."""
    model = reference["model"]
    chosen = {c["set"]: c["chosen"] for c in model["candidates"]}
    assert model["set"] == "dh"
    assert chosen["dh"] == "geometry"
    assert {"frames", "zeros", "placement", "dh"} <= chosen.keys()
    assert any("+gravity" in name for name in chosen)
    assert not any(chosen[name] for name in chosen if name != "dh")
    assert reference["non_geometric"] is None
    text = examples.starting("calib calibrate robot.urdf data.csv --base base --tip tool0").out
    assert re.search(r"^  dh .*  the URDF$", text, re.MULTILINE)


#: A row of a table of intervals: name, value, two ends by the covariance and two others, unit.
INTERVALS = re.compile(
    r"^(\w+) +(-?[\d.]+) +(-?[\d.]+) \.\. +(-?[\d.]+) +(-?[\d.]+) \.\. +(-?[\d.]+) (mm|deg)$",
    re.MULTILINE,
)


def test_bootstrap_and_profile_are_printed_and_written(examples):
    done = examples.starting(
        "calib calibrate robot.urdf data.csv --base base --no-validate --bootstrap"
    )
    result = load(examples.folder / "intervals.json")
    found, names = result["bootstrap"], [p["name"] for p in result["parameters"]]
    assert (found["samples"], found["seed"], found["stopped"]) == (200, 1, 0)
    assert [p["name"] for p in found["parameters"]] == names
    _, by_bootstrap, by_profile = re.split(
        r"^Bootstrap: .*|^Profile .*", done.out, flags=re.MULTILINE
    )
    rows = {name: (numbers, unit) for name, *numbers, unit in INTERVALS.findall(by_bootstrap)}
    assert list(rows) == names
    for p, sampled in zip(result["parameters"], found["parameters"], strict=True):
        numbers, unit = rows[p["name"]]
        shown = [p["value"], p["low"], p["high"], sampled["low"], sampled["high"]]
        factor = 1e3 if unit == "mm" else 180.0 / math.pi
        assert [float(n) for n in numbers] == pytest.approx([factor * v for v in shown], abs=6e-4)
        assert sampled["low"] < p["value"] < sampled["high"]
        # 30 rows, two of them wild: the same to within what 200 samples and 27 parameters blur.
        assert 0.5 < (sampled["high"] - sampled["low"]) / (p["high"] - p["low"]) < 2.0
    assert 1.0 < found["expected"]["measured_rms_m"] / result["expected"]["measured_rms_m"] < 1.5
    (row,) = INTERVALS.findall(by_profile)
    (written,) = result["profiles"]
    p = result["parameters"][names.index("alpha2")]
    assert row[0] == written["name"] == "alpha2"
    assert [written["low"], written["high"]] == pytest.approx([p["low"], p["high"]], rel=1e-3)
    assert [float(n) for n in row[4:6]] == pytest.approx(
        [math.degrees(written[end]) for end in ("low", "high")], abs=6e-4
    )


def test_the_same_seed_gives_the_same_samples(call, shop):
    words = ("--model", "zeros", "--bootstrap", "50", "--force", "--seed")
    first, again, other = (quick(call, shop, *words, seed) for seed in ("5", "5", "6"))
    assert first["bootstrap"] == again["bootstrap"]
    assert first["bootstrap"]["parameters"] != other["bootstrap"]["parameters"]
    assert first["parameters"] == other["parameters"]
    assert "profiles" not in first


def test_points_in_a_list_of_their_own(call, shop, reference):
    done = call(
        shop, "fit", "robot.urdf", "joints.csv", "--points", "tracker.txt", "--base", "base",
        "--no-validate", "--quiet", "--json", "q.json",
    )  # fmt: skip
    assert (done.code, done.out, done.err) == (0, "", "")
    result = load(shop / "q.json")
    assert values(result) == pytest.approx(values(reference), abs=1e-12)
    assert result["inputs"]["measurements"]["name"] == "joints.csv + tracker.txt"


def test_names_units_line_ends_and_file_names_as_they_come(run, shop, reference):
    """A table as a robot's log gives it: Windows line ends, a byte order mark, columns of its own, odd file names."""
    header, *rows = (shop / "data.csv").read_text(encoding="utf-8").splitlines()
    joints = [name for name in header.split(",") if name.endswith("[deg]")]
    names = header.replace(" [mm]", " mm")
    for k, name in enumerate(joints, 1):
        names = names.replace(name, f"J{k}")
    text = "\r\n".join(["# Messung von Hand", names + ",Bemerkung", *[r + ",ü" for r in rows], ""])
    (shop / "meß werte µ.csv").write_bytes(text.encode("utf-8-sig"))
    (shop / "mein roboter é.urdf").write_bytes((shop / "robot.urdf").read_bytes())
    (shop / "neue dateien").mkdir()
    columns = [f"--columns=J{k}={name}" for k, name in enumerate(joints, 1)]
    columns += [f"--columns={c} mm={c} [mm]" for c in "xyz"]
    done = run(
        shop, "fit", "mein roboter é.urdf", "meß werte µ.csv", "--base", "base", *columns,
        "-o", "neue dateien/korrigiert ü.urdf", "--json", "neue dateien/r.json", "--no-validate",
    )  # fmt: skip
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "Columns not used: 'Bemerkung'."
    assert "Written: neue dateien/korrigiert ü.urdf" in done.lines
    result = load(shop / "neue dateien" / "r.json")
    assert values(result) == pytest.approx(values(reference), abs=1e-12)
    assert result["inputs"]["measurements"]["name"] == "meß werte µ.csv"
    (urdf,) = (shop / "neue dateien").glob("*.urdf")
    assert b"<robot" in urdf.read_bytes()


def test_every_way_that_an_output_is_refused_before_the_work(call, shop):
    before = {path: path.read_bytes() for path in shop.iterdir()}
    (shop / "folder").mkdir()
    calls = {
        ("-o", "robot.urdf", "--force"): "robot.urdf is also an input of this command",
        ("--json", "folder/../data.csv", "--force"): "data.csv is also an input of this command",
        ("-o", "a", "--view", "a"): "a is also another output of this command",
        ("-o", "cell.toml"): "exists already; overwrite it (--force, in Python overwrite=True) or choose another name",
        ("-o", "folder", "--force"): "is a folder; name a file inside it",
        ("-o", "none/c.urdf"): "does not exist; create it",
    }  # fmt: skip
    for words, said in calls.items():
        done = call(shop, "fit", "robot.urdf", "data.csv", *words)
        assert (done.code, done.out) == (1, ""), words
        assert done.err.startswith("calib: "), words
        assert said in done.err
        assert done.err.count("\n") == 1
    (shop / "folder").rmdir()
    assert {path: path.read_bytes() for path in shop.iterdir()} == before


def test_force_overwrites(call, shop):
    (shop / "q.json").write_text("old", encoding="utf-8")
    assert quick(call, shop, "--force", "--model", "zeros")["model"]["set"] == "zeros"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("none", "data.csv"), "'none' is neither a file here nor a robot whose name calib knows"),
        (("robot.urdf", "none.csv"), "The table 'none.csv' does not exist; check the name and"),
        (("robot.urdf", "data.csv", "--base", "bass"), "no link 'bass' (did you mean 'base'?)"),
        (("robot.urdf", "data.csv", "--model", "best"), "There is no parameter set 'best'"),
        (("robot.urdf", "data.csv", "--hold", "lift=1 m"), "the joint 'lift', to be held at 1, is"),
        (("robot.urdf", "joints.csv", "--base", "base"), "measured points need a column 'x [mm]'"),
        (("robot.urdf", "data.csv", "--fix-target"), "The target is marked as known"),
        (("robot.urdf", "data.csv", "--target", "1 2 3"), 'given as "1 2 3"; it must be 3 numbers'),
        (("robot.urdf", "data.csv", "--freeze", "d9"), "No model has the parameters 'd9'; 'calib"),
        (("robot.urdf", "data.csv", "--seed", "3"), "--seed is for the samples of --bootstrap;"),
        (("robot.urdf", "data.csv", "--columns", "J1"), "--columns was given 'J1'; it must be"),
        (("data.csv", "robot.urdf"), "ROBOT comes first, then DATA."),
        (("panda", "data.csv"), "data.csv, line 1: no column for the joints 'panda_joint1'"),
    ],
)
def test_errors_are_one_line(call, shop, words: tuple[str, ...], said: str):
    done = call(shop, "fit", *words, "-o", "c.urdf")
    assert (done.code, done.out) == (1, "")
    assert done.err.startswith("calib: ")
    assert said in done.err
    assert done.err.count("\n") == 1
    assert not (shop / "c.urdf").exists()


@pytest.mark.slow
def test_debug_shows_the_trace_before_the_line(run, shop):
    done = run(shop, "fit", "robot.urdf", "none.csv", "--debug")
    assert done.code == 1
    assert done.err.startswith("Traceback (most recent call last):\n")
    assert done.err.splitlines()[-1].startswith("calib: The table 'none.csv' does not exist")


def test_an_unused_column_that_is_a_joint_hints_at_base_and_tip(call, shop):
    done = call(
        shop,
        "fit",
        "robot.urdf",
        "data.csv",
        "--base",
        "base",
        "--tip",
        "wrist_2_link",
        "--model",
        "zeros",
        "--no-validate",
    )
    assert done.code == 0
    text = " ".join(done.out.split("\n\n")[0].split())
    assert text == (
        "Columns not used: 'wrist_3_joint [deg]'. Not between 'base' and 'wrist_2_link' (--base, --tip): "
        "'wrist_3_joint'."
    )
    assert max(map(len, done.out.splitlines())) <= 100
