"""What ``calib bag`` says of clocks, lags and stops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.verbs.bag.bag import BagTable
from calib.verbs.bag.lag import Lag, NoLag
from calib.verbs.bag.recording import Clock, Recording
from calib.verbs.bag.streams import JointStream, PointStream
from calib.verbs.bag.table import Skipped
from calib.verbs.bag.text import next_lines, skipped_lines, table_text

T = np.arange(0.0, 10.0, 0.1)
Z = np.zeros((100, 1))
TABLE = BagTable(
    Recording(
        JointStream(("a",), T, Z, Z),
        (PointStream("/p", "", "", T, np.zeros((100, 3)), np.full((100, 4), np.nan)),),
        (("/j", Clock("received", 0.0, "unset")), ("/p", Clock("header", -120.5))),
    ),
    {"/p": Lag(-0.25, 0.0004, 12, by_robot=False)},
    np.array([[1.0, 2.0]]),
    (),
    (),
    (),
)


def said(table: BagTable) -> str:
    return " ".join(" ".join(table_text(table)).split())


def test_clocks_and_lags_in_words():
    text = said(TABLE)
    assert "/j: 1 joint, 10.0 per s, by the times of receipt: its stamps are not set." in text
    assert "120.500 s ahead of the recorder's clock" in text
    assert "/p is 0.2500 s earlier than the joints, standard uncertainty 0.40 ms" in text
    assert "--robot" in text
    for lag, words in (
        (NoLag("no_motion"), "not found for /p"),
        (NoLag("unclear"), "--robot"),
        (0.5, "as stated"),
    ):
        assert words in said(replace(TABLE, lags={"/p": lag}))


def test_skipped_stops_are_listed_and_many_are_counted():
    skipped = [Skipped(float(k), 0.4, "short") for k in range(14)]
    lines = skipped_lines([Skipped(3.0, 1.0, "no_point", "/p"), *skipped])
    assert lines[1] == "- 3.00 s, 1.00 s long: no point of /p"
    assert lines[-1] == "- and 5 more"
    assert skipped_lines([]) == []


def test_the_next_command_has_the_files():
    lines = next_lines(TABLE, "my table.csv", None, "ur5")
    assert lines == [
        "Next: calib calibrate ur5 'my table.csv' --frame estimate -o corrected.urdf --json result.json"
    ]
    assert "--sliding" in next_lines(TABLE, "t.csv", "pics", None)[-1]
