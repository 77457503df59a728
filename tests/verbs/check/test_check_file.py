"""Keys of the file as docs/check.md lists them."""

from __future__ import annotations

import json
import re
from pathlib import Path

from calib.verbs.check.check import check
from calib.verbs.check.check_file import check_table
from tests.places import ROOT
from tests.verbs.check.shop import paper_result, points


def test_every_key_is_documented(tmp_path: Path):
    c = check(paper_result(), points(zeros=(0.0, 0.01, 0.0, 0.0, 0.0, 0.0)))
    table = check_table(c)
    text = (ROOT / "docs" / "check.md").read_text(encoding="utf-8").split("## As JSON")[1]
    documented = set(re.findall(r"`(\w+)`", text))
    keys = set(table) | set(table["causes"][0]) | set(table["noticed"][0])
    assert keys - {"schema", "versions", "time"} <= documented
    path = c.write_json(tmp_path / "c.json")
    written = json.loads(path.read_text(encoding="utf-8"))
    assert set(written) >= set(table)
    assert written["causes"][0]["code"] == "joint"
    assert written["noticed"][1]["turn_rad"] is None  # of a point
