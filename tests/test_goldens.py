"""The goldens of scripts/: what of a file is kept, and which differences count."""

from __future__ import annotations

import sys
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

from goldens import all_cases, comparison_of, renamed, with_needed
from goldens_compare import LOOSE, STRICT, rename
from goldens_numbers import csv_columns, json_content, text_numbers, urdf_poses

from calib.example import paper_urdf
from calib.robot.robot import Robot


def test_a_list_of_tables_is_kept_as_a_table_of_lists_without_what_differs_each_time():
    kept = json_content({"rows": [{"x": 1.0, "seconds": 2.0}, {"x": 2.0}], "sha256": "a"})
    assert kept == {"rows": {"x": [1.0, 2.0]}}


def test_long_lists_are_kept_as_a_digest():
    kept = json_content([float(k) for k in range(100)])
    assert (kept["n"], kept["max"]) == (100, 99.0)


def test_sentences_and_printed_lines_are_kept_as_their_numbers():
    assert json_content("moved by 3 mm in 2 rows") == {"#text": ["3", "2"]}
    assert text_numbers("rms 0.25 mm\nWritten: a 3\nno number") == {"rms # mm": ["0.25"]}
    assert csv_columns("# a\nx [mm],name\n1.5,a\n,b\n") == {
        "x [mm]": [1.5, None],
        "name": ["a", "b"],
    }


def test_the_poses_of_a_urdf_are_those_of_the_robot():
    robot = Robot.load(paper_urdf(), base="base_link", tip="tool0")
    names = sorted(
        joint.attrib["name"] for joint in ElementTree.parse(paper_urdf()).findall("joint")
    )
    q = [0.7 * np.sin(1.0 + names.index(name)) for name in robot.joint_names]
    expected = robot.poses([q])[0, :3, [3, 0, 1]].ravel()
    assert urdf_poses(paper_urdf())["tool0"][:9] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("a", "b", "count"),
    [
        (1.0, 1.0 + 1e-10, 0),
        (1.0, 1.0 + 1e-8, 1),
        ("0.25", "0.26", 0),  # one in the last place
        ("0.25", "0.27", 1),
        ("dh", "zeros", 1),
        (3.14159265, -3.14159265, 0),
        ([1.0, 1e-12], [1.0, 2e-12], 0),  # beside the largest of the list
        ({"x": 1.0}, {"y": 1.0}, 2),
        ({"value": [0.0], "std": [1.0]}, {"value": [1e-10], "std": [1.0]}, 0),
        ({"text": {"rms": ["1"]}}, {"text": {"rms": ["2"]}}, 1),
        (True, 1.5, 1),
    ],
)
def test_differences_are_more_than_rounding(a, b, count):
    assert len(list(STRICT.differences("case", a, b))) == count


def test_words_of_keys_and_short_texts_are_renamed_and_files_are_not():
    names = [("larger", "non_geometric"), ("sizes", "prior_std")]
    assert rename({"larger": ["larger", "larger_model", 1]}, names) == {
        "non_geometric": ["non_geometric", "larger_model", 1]
    }
    kept = {"kinds/larger": {"exit": 0, "files": {"larger.json": {"sizes": [1.0]}}}}
    assert renamed(kept, names) == {
        "kinds/larger": {"exit": 0, "files": {"larger.json": {"prior_std": [1.0]}}}
    }


def test_a_case_needs_those_whose_files_it_reads():
    cases = all_cases()
    assert len(cases) > 100
    assert with_needed(["convert/dh"], cases) == {"convert/dh", "paper/auto"}
    assert comparison_of("convert/dh", cases) == LOOSE
    assert comparison_of("convert/panda", cases) == STRICT
