"""A fleet in words: rows, counts and names are those of its file."""

from __future__ import annotations

from typing import Any

import pytest

from calib.verbs.fleet.text import LISTED, data_text, few_text, figure_text, fleet_cells, fleet_text


def robot(name: str, **values: Any) -> dict[str, Any]:
    """A calibrated robot of a fleet's file."""
    return {
        "name": name,
        "verdict": "use",
        "urdf": "corrected.urdf",
        "model": "dh",
        "non_geometric": "",
        "nominal_rms": {"m": 2.5e-3},
        "calibrated_rms": {"m": 2e-4},
        "unseen_rms": {"m": 2.5e-4},
        "sigma": {"m": 1e-4},
        "rows": 35,
        "outliers": 2,
        "message": "",
        **values,
    }


def fleet(*robots: dict[str, Any], **values: Any) -> dict[str, Any]:
    return {"robots": list(robots), "outliers": [], "notes": [], **values}


def outlier(name: str, figure: str = "noise", text: str = "noise 9 mm") -> dict[str, str]:
    return {"name": name, "figure": figure, "text": text}


def test_a_row_has_the_figures_in_mm():
    heads, rows = fleet_cells(fleet(robot("SN-1", non_geometric="dh+gain", sigma={})))
    cells = dict(zip(heads, rows[0], strict=True))
    assert cells["robot"] == "SN-1"
    assert cells["model"] == "dh (dh+gain)"
    assert [cells[head] for head in heads[4:8]] == ["2.500", "0.200", "0.250", ""]
    assert [cells[head] for head in heads[8:]] == ["35", "2"]


def test_failed_robots_have_no_row():
    _, rows = fleet_cells(fleet(robot("SN-1"), robot("SN-2", message="no such file")))
    assert [row[0] for row in rows] == ["SN-1"]


def test_of_a_large_fleet_those_to_look_at_are_listed():
    robots = [robot(f"SN-{k}") for k in range(LISTED + 1)]
    robots[3]["verdict"] = "use with care"
    _, rows = fleet_cells(fleet(*robots, outliers=[outlier("SN-7")]))
    assert [row[0] for row in rows] == ["SN-3", "SN-7"]


def test_counts_are_those_of_the_fleet():
    robots = [
        robot("SN-1"),
        robot("SN-2", verdict="do not use", urdf="withheld"),
        robot("SN-3", message="data.csv: no rows"),
        robot("SN-4"),
    ]
    outliers = [outlier("SN-1"), outlier("SN-2", "data", data_text(["SN-4"], "data.csv"))]
    *paragraphs, counts = fleet_text(fleet(*robots, outliers=outliers, notes=["A note."]), kept=2)
    assert " ".join(counts.split()) == (
        "3 of 4 robots calibrated (2 use, 1 do not use), 2 of them by an earlier run; 1 fleet outlier, 1 with the data "
        "of another, 1 without a corrected URDF, 1 failed."
    )
    text = "\n".join(paragraphs)
    for line in (
        "  SN-1: noise 9 mm",
        "  SN-2: the same measurements as SN-4 (data.csv)",
        "  SN-2",
    ):
        assert line in text.splitlines()
    assert "  SN-3: data.csv: no rows" in text.splitlines()
    assert paragraphs[-1] == "A note."


def test_lines_are_of_100_columns():
    names = [f"robot {k}" for k in range(60)]
    failed = [robot(name, message="no rows") for name in names]
    lines = "\n".join(fleet_text(fleet(*failed), kept=0)).splitlines()
    assert max(map(len, lines)) <= 100


@pytest.mark.parametrize(
    ("unit", "shown"),
    [
        ("m", "3 mm, usually 2 mm"),
        ("rad", "3 mrad, usually 2 mrad"),
        ("px", "0.003 px, usually 0.002 px"),
    ],
)
def test_a_figure_in_its_unit(unit: str, shown: str):
    text = figure_text("noise", unit, 3e-3, 2e-3, -5.25, 4.0)
    assert text == f"noise {shown} (|z| 5.2, limit 4.0)"


def test_copies_of_data_name_three_robots():
    assert data_text(["a", "b", "c", "d", "e"], "x.csv") == (
        "the same measurements as a, b, c and 2 more (x.csv)"
    )


def test_too_few_robots():
    assert few_text(4, 4, 5, "").startswith("Outlier detection needs 5 robots; there are 4 robots.")
    assert "1 robot of the kind 'panda'" in few_text(1, 1, 5, "panda")
    assert "5 robots with the data of 4." in few_text(5, 4, 5, "")


def test_outliers_and_copies_stand_below_their_own_headings():
    outliers = [outlier("SN-1"), outlier("SN-2", "data", "the same measurements")]
    robots = [robot("SN-1"), robot("SN-2")]
    unusual, copied, _ = fleet_text(fleet(*robots, outliers=outliers), kept=0)
    assert unusual.splitlines() == ["Fleet outliers:", "  SN-1: noise 9 mm"]
    assert copied.splitlines()[1:] == ["  SN-2: the same measurements"]
