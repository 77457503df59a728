"""``calib certificate``: its files, its exit status, and what it refuses before the work."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from xml.etree import ElementTree

import pytest

from calib.data.measurements import Measurements
from calib.result.calibration import Calibration
from tests.cli_fixtures import Run
from tests.places import ROOT
from tests.show.pages import Page

RECORD = """
base = "base"
tip = "tool0"
[record]
certificate_number = "K-1"
laboratory = "Lab"
country = "DE"
responsible = "B."
customer = "Kunde"
robot_serial = "4711"
date = 2026-11-26
"""

CERTIFICATE = ("certificate", "robot.urdf", "data.csv", "--calibration", "result.json")
WITH_CELL = (*CERTIFICATE, "--cell", "lab.toml")


@pytest.fixture
def folder(shop: Path, default_result: Calibration) -> Path:
    default_result.write_json(shop / "result.json")
    (shop / "lab.toml").write_text(RECORD, encoding="utf-8")
    return shop


def test_all_files_are_of_one_certificate(call: Run, folder: Path):
    words = ("--tolerance", "0.5 mm", "--uncertainty", "0.05 mm")
    risks = ("--prior-mean", "0.3 mm", "--prior-std", "0.1 mm")
    files = ("-o", "c.html", "--dcc", "c.xml", "--json", "c.json")
    done = call(folder, *WITH_CELL, *words, *risks, *files)
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "Verdict: pass"
    assert done.lines[-3:] == ["Written: c.html", "Written: c.xml", "Written: c.json"]
    written = json.loads((folder / "c.json").read_text("utf-8"))
    assert written["decisions"]["m"]["guard_band"] == 5e-5
    assert written["decisions"]["m"]["prior_mean"] == pytest.approx(3e-4)
    assert written["inputs"]["result"]["name"] == "result.json"
    assert written["command"].startswith("calib certificate robot.urdf data.csv")
    assert written["id"] in Page((folder / "c.html").read_text("utf-8")).text
    root = ElementTree.parse(folder / "c.xml").getroot()
    values = [node.text for node in root.iter("{https://ptb.de/dcc}value")]
    assert written["id"] in values


@pytest.mark.parametrize(("tolerance", "code"), [("0.5 mm", 0), ("0.3 mm", 3), ("0.1 mm", 3)])
def test_the_exit_status_is_the_outcome(call: Run, folder: Path, tolerance: str, code: int):
    words = ("--tolerance", tolerance, "--uncertainty", "0.05 mm", "--quiet")
    done = call(folder, *CERTIFICATE, *words)
    assert (done.code, done.out, done.err) == (code, "", "")


def test_without_a_tolerance_it_is_done(call: Run, folder: Path):
    done = call(folder, *CERTIFICATE)
    assert done.code == 0
    assert done.lines[0] == "Verdict: none"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("-o", "c.txt"), "let the name end in .html or .pdf"),
        (("-o", "robot.urdf", "--force"), ""),
        (("--dcc", "c.xml"), "A DCC must state"),
        (("--prior-mean", "0.3 mm", "--tolerance", "1 mm"), "--prior-std"),
        (("--prior-mean", "0.3 mm", "--prior-std", "0.1 mm"), "needs a tolerance"),
        (("--tolerance", "0.5 px"), "'px'"),
        (("--judge", "non_geometric"), "no non-geometric model"),
        (("--json", "nowhere/c.json"), "nowhere"),
    ],
)
def test_what_is_refused_leaves_no_file(call: Run, folder: Path, words: tuple[str, ...], said: str):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    done = call(folder, *CERTIFICATE, *words)
    assert (done.code, done.out) == (1, "")
    assert said in done.err
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.slow
def test_the_example_of_the_page_is_what_is_printed(call: Run, shop: Path):
    page = (ROOT / "docs" / "certificate.md").read_text("utf-8")
    (shown,) = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
    (example,) = re.findall(r"^calib (certificate .* --prior-mean .*)$", page, re.MULTILINE)
    text = f"sigma_mm = 0.03\nscale_certified = true\n{RECORD}"
    (shop / "cell.toml").write_text(text, encoding="utf-8")
    fit = ("calibrate", "robot.urdf", "data.csv", "--cell", "cell.toml", "--quiet")
    assert call(shop, *fit, "-o", "corrected.urdf", "--json", "result.json").code == 0
    done = call(shop, *shlex.split(example))
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith(shown)


def test_a_table_of_fresh_rows(call: Run, folder: Path, table: Measurements):
    """Rows of the calibration by themselves are recognised, in another file and under other numbers."""
    table.select(table.estimation).write(folder / "fitted.csv")
    done = call(folder, "certificate", "robot.urdf", "fitted.csv", "--calibration", "result.json")
    assert done.code == 1
    assert "fitted to all rows" in done.err
