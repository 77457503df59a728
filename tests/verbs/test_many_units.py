"""Kinds with any number of scalars in any units, from a plugin file, through the program from simulation to report."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.units import UNITS
from tests.places import ROOT
from tests.plugin_files import registries_kept

CELL = """
plugins = ["many_units.py"]
base = "base"
tip = "tool0"
target_mm = [50, 50, 50]
model = "dh"
frame_xyz_mm = [0, 0, 2500]
frame_rpy_deg = [180, 0, 0]
"""

#: Units of each kind, and headers of the columns that it measures.
KINDS = {
    "five_wires": (["m"], [f"wire_{k} [mm]" for k in range(1, 6)]),
    "corner": (["px"], ["u [px]", "v [px]"]),
    "mixed": (["m", "rad", "px"], ["x [mm]", "y [mm]", "z [mm]", "tilt [deg]", "column [px]"]),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("units")
    # Not imported here: that would register its kinds for all tests of this process.
    shutil.copy(ROOT / "tests" / "many_units.py", folder)
    (folder / "cell.toml").write_text(CELL)
    return folder


@pytest.fixture
def words(call, folder):
    """A function that makes a call in this process, and takes what it registers out again."""

    def within(text: str) -> str:
        with registries_kept():
            done = call(folder, *text.split())
        assert done.code == 0, done.err
        return done.out

    return within


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_is_simulated_fitted_evaluated_planned_and_read_again(words, folder, kind):
    units, headers = KINDS[kind]
    cell = f"--cell cell.toml --kind {kind} --force"
    simulated = words(f"simulate ur3 {cell} --count 60 --seed 3 -o {kind}.csv")
    assert ("Noise of an image coordinate" in simulated) == ("px" in units)
    header = (folder / f"{kind}.csv").read_text().splitlines()[0].split(",")
    assert header[-len(headers) :] == headers

    words(f"calibrate ur3 {kind}.csv {cell} -o {kind}.urdf --json {kind}.json")
    table = json.loads((folder / f"{kind}.json").read_text())
    assert table["verdict"]["use"] == "use"
    assert [plugin["kinds"] for plugin in table["plugins"]] == [[kind]]
    for sets in (table["cross_validation"]["errors"], table["errors"]["calibrated"]["validation"]):
        assert list(sets) == units
    for unit in units:
        nominal = table["nominal_cross_validation"]["errors"][unit]["rms"]
        assert table["cross_validation"]["errors"][unit]["rms"] < 0.4 * nominal
        assert table["noise"]["sigma"][unit] == pytest.approx(_noise(unit), rel=0.3)

    evaluated = words(
        f"evaluate {kind}.urdf {kind}.csv {cell.replace('--force', '')} --calibration {kind}.json"
    )
    for unit in units:
        rms = table["errors"]["calibrated"]["estimation"][unit]["rms"]
        shown = RESIDUAL_UNITS[unit]
        text = f"{shown.to_shown * rms:.{shown.digits}f}"
        assert re.search(rf"estimation rows +60 .* {re.escape(text)}", evaluated), text

    planned = words(f"plan ur3 {cell} --count 12 --candidates 200 -o {kind}_plan.csv")
    assert ("px" in planned) == ("px" in units)
    expected = [f"expected {header}" for header in headers]
    assert set(expected) <= set(
        (folder / f"{kind}_plan.csv").read_text().splitlines()[0].split(",")
    )


def _noise(unit: str) -> float:
    """The noise that was simulated, of one scalar: instrument and robot of lengths, a probe's, a camera's."""
    return {"m": 3.8e-5, "rad": np.radians(0.01), "px": 0.3}[unit]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_what_was_written_is_read_back(words, folder, kind):
    """The table by its own reader; each residual is measured minus predicted by the kind's own function."""
    words(
        f"simulate ur3 --cell cell.toml --kind {kind} --count 30 --seed 5 -o {kind}_b.csv --force"
    )
    words(f"calibrate ur3 {kind}_b.csv --cell cell.toml --kind {kind} --json {kind}_b.json --force")
    with registries_kept():
        calib.plugins.load(folder / "many_units.py")
        result = calib.Calibration.read_json(folder / f"{kind}_b.json")
        measure = calib.kinds.get(kind).measure
        rows = np.genfromtxt(folder / f"{kind}_b.csv", delimiter=",", names=True, dtype=None)
        joints = [name for name in rows.dtype.names if name.endswith("_joint_deg")]
        q = np.radians(np.column_stack([rows[name] for name in joints]))
        predicted = measure(result.predict_poses(q))
        names = rows.dtype.names[-predicted.shape[1] :]
        to_si = [UNITS[name.rsplit("_", 1)[1]].to_si for name in names]
        measured = np.column_stack([rows[name] for name in names]) * to_si
    np.testing.assert_allclose(result.rows.residual_calibrated, measured - predicted, atol=1e-9)
    assert result.rows.channels.present == tuple(KINDS[kind][0])


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_report_and_a_page_show_every_unit(words, folder, kind):
    words(
        f"simulate ur3 --cell cell.toml --kind {kind} --count 40 --seed 6 -o {kind}_c.csv --force"
    )
    words(
        f"calibrate ur3 {kind}_c.csv --cell cell.toml --kind {kind} --json {kind}_c.json --report {kind}.html "
        f"-o {kind}_c.urdf --bootstrap 40 --force"
    )
    page = (folder / f"{kind}.html").read_text()
    for unit in KINDS[kind][0]:
        assert re.search(rf"<b>Table \d+\.</b> [^<]*error \[{RESIDUAL_UNITS[unit].shown}\]", page)
    assert ("Image error by row" in page) == ("px" in KINDS[kind][0])
    words(
        f"view ur3 --data {kind}_c.csv --cell cell.toml --kind {kind} --calibration {kind}_c.json -o {kind}_view.html"
    )
    assert (folder / f"{kind}_view.html").stat().st_size > 100_000
