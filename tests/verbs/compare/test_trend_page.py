"""A trend in words and on a page."""

from __future__ import annotations

import pytest

from calib.errors import FileError
from calib.verbs.compare.trend import trend
from calib.verbs.compare.trend_page import sentence
from tests.verbs.compare.visits import Planted, visits

DRIFT = Planted(1, rate=0.3e-3)


def test_the_text_has_joints_results_and_outcome():
    found = trend(visits(DRIFT, 4), tolerance=1e-4)
    text = found.summary()
    lines = text.splitlines()
    assert lines[0] == "4 calibrations of 'ur3', base to tool0, serial no. SN-004"
    assert "Verdict: fail" in lines
    rows = {line.split()[0]: line.split() for line in lines if "_joint " in line}
    assert rows["shoulder_lift_joint"][1] == "drift"
    assert float(rows["shoulder_lift_joint"][2]) == pytest.approx(0.3, abs=0.06)
    assert rows["elbow_joint"][1] == "steady"
    assert "cannot be seen" in text
    of_joint = found.joints[1]
    assert sentence(of_joint, found).startswith("shoulder_lift_joint: its zero drifts by +0.3")
    assert all(len(line) <= 100 for line in lines)


@pytest.mark.slow
def test_the_page_has_the_figures(tmp_path):
    found = trend(visits(DRIFT, 4))
    page = found.write_report(tmp_path / "t.html").read_text(encoding="utf-8")
    assert page.count("data:image/svg+xml") == 2
    assert "Joint zeros over time" in page
    with pytest.raises(FileError, match="html"):
        found.write_report(tmp_path / "t.txt")
