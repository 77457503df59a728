"""Targets and frames in words: what stands in the summary is what was found."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.calibration import calibrate
from calib.identify.words import frame_text, target_text, three, wrap


def one_line(text: str) -> str:
    return " ".join(text.split())


def numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", text)]


def test_targets_by_name_where_there_are_several(calibrated):
    _, c = calibrated("targets")
    lines = target_text(c).splitlines()
    assert lines[0].startswith("Target 't0': found at (")
    for name, T in zip(c.setup.targets, c.setup.T_tip_target, strict=True):
        (line,) = [line for line in lines if f"'{name}'" in line]
        np.testing.assert_allclose(numbers(line)[:3], 1e3 * T[:3, 3], atol=5.1e-4)
    assert target_text(calibrated("points")[1]).startswith("Target: found at (")


def test_orientations_and_how_sure_they_are(calibrated):
    _, c = calibrated("poses")
    said = one_line(target_text(c))
    assert re.search(
        r"mm, rpy \(.*\) deg in tool0, 95 % ± \(.*\) mm and \(.*\) deg about its axes", said
    )
    sure = numbers(said.split("mm and (")[1])
    wanted = [c.parameter(f"target_r{a}") for a in "xyz"]
    np.testing.assert_allclose(sure, [np.degrees(p.high - p.low) / 2 for p in wanted], rtol=6e-3)
    assert "target_rx" not in c.summary().split("Parameter ")[1]


def test_every_set_up_by_name(calibrated):
    _, c = calibrated("set-ups")
    said = one_line(frame_text(c))
    for group, T in zip(c.setup.groups, c.setup.T_frame_base, strict=True):
        x, y, z = (three(1e3 * v) for v in T[:3, 3])
        assert f"Measurement frame '{group}': base found at ({x}, {y}, {z}) mm, rpy (" in said
    assert frame_text(calibrated("known set-ups")[1]) == ""
    assert frame_text(calibrated("pairs")[1]) == ""


@pytest.mark.parametrize(("name", "word"), [("sockets", "Socket"), ("distances", "Anchor")])
def test_sockets_and_anchors_are_points_of_the_base(calibrated, name, word):
    _, c = calibrated(name)
    for line, group, T in zip(
        frame_text(c).splitlines(), c.setup.groups, c.setup.T_frame_base, strict=True
    ):
        assert line.startswith(f"{word} '{group}': found at (")
        np.testing.assert_allclose(numbers(line), -1e3 * T[:3, :3].T @ T[:3, 3], atol=5.1e-4)


def test_planes_by_normal_and_distance(calibrated):
    scene, c = calibrated("planes")
    for line, T in zip(frame_text(c).splitlines(), scene.kinematics.T_frame_base, strict=True):
        normal, along = np.array(numbers(line)[:3]), numbers(line)[3]
        side = np.sign(normal @ T[2, :3])  # a plane has two
        np.testing.assert_allclose(side * normal, T[2, :3], atol=5e-3)
        assert side * along == pytest.approx(-1e3 * T[2, 3], abs=3.0)


def test_each_kind_has_its_own_words_in_a_table_of_all(calibrated):
    _, c = calibrated("mixed")
    starts = [line.split(":")[0] for line in frame_text(c).splitlines() if line[0] != " "]
    assert starts == ["Measurement frame '0'", "Socket '1'", "Plane '2'", "Anchor '3'"]


def test_a_partly_known_frame_says_which_directions(calibrated):
    _, c = calibrated("gain")
    cell = replace(
        c.cell, T_frame_base=c.T_frame_base, frame_directions=("x", "rz"), model="frames"
    )
    found = calibrate(c.nominal, c.measurements, cell=cell, validate=False)
    said = one_line(frame_text(found))
    assert said.endswith("for x, rz along and about the axes of base.")
    assert len(numbers(said.split("95 % ± ")[1])) == 2


def test_many_are_counted_not_listed(calibrated):
    scene, c = calibrated("sockets")
    m = c.measurements
    groups = tuple(f"{g}{k % 4}" for k, g in enumerate(m.groups))
    many = calibrate(
        scene.robot, replace(m, groups=groups), cell=replace(c.cell, distances=()), validate=False
    )
    assert frame_text(many).count("Socket") == 6
    assert frame_text(many).endswith("... and 6 more set-ups")
    table = calibrated("points")[1].measurements
    names = tuple(f"ball{k % 8}" for k in range(len(table)))
    several = calibrate(scene.robot, replace(table, targets=names), model="frames", validate=False)
    assert target_text(several).endswith("... and 2 more targets")


def test_numbers_and_lines():
    assert (three(-0.0001), three(0.00049, "+"), three(-1.2345)) == ("0.000", "+0.000", "-1.234")
    text = wrap("word-with-hyphens " * 20, "  ")
    assert max(map(len, text.splitlines())) <= 100
    assert all(line.startswith("  ") for line in text.splitlines())
    assert "hyphens" in text.splitlines()[0].split()[-1]
