"""Fleet outliers: those that are, no others, and none where there are too few robots."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from calib.verbs.fleet.fleet_row import DONE, FAILED, FleetParameter, FleetRow
from calib.verbs.fleet.outliers import FEWEST, fleet_outliers, limit, scores, usual_robots
from calib.verbs.fleet.text import few_text


def row(k: int, rng: np.random.Generator, parameters: int = 10) -> FleetRow:
    """One of many alike."""
    spread = np.exp(rng.normal(size=3) * (0.3, 0.15, 0.15))
    nominal, held_out, sigma = (spread * (3e-3, 8e-5, 4e-5)).tolist()
    changes = [float(rng.normal(0.0, 3e-4)) for _ in range(parameters)]
    return FleetRow(
        f"r{k}",
        DONE,
        verdict="use",
        model="dh",
        rows=30,
        nominal_rms={"m": nominal},
        held_out_rms={"m": held_out},
        sigma={"m": sigma},
        kind="ur3 base tool0 j1",
        data=f"{k}.csv",
        measured=str(rng.random()),
        parameters=tuple(
            FleetParameter(f"p{i}", "m", change, 1e-5) for i, change in enumerate(changes)
        ),
    )


def fleet_of(count: int, seed: int = 0, **more: int) -> list[FleetRow]:
    """Robots that are alike."""
    rng = np.random.default_rng(seed)
    return [row(k, rng, **more) for k in range(count)]


@pytest.mark.parametrize("count", [5, 12, pytest.param(60, marks=pytest.mark.slow)])
def test_few_fleets_without_outliers_have_one(count):
    fleets = 120
    flagged = sum(bool(fleet_outliers(fleet_of(count, seed))[0]) for seed in range(fleets))
    # 5 % of them, and three standard deviations.
    assert flagged <= 0.05 * fleets + 3.0 * math.sqrt(0.05 * 0.95 * fleets)


def test_outliers_are_flagged_with_their_figures():
    rows = fleet_of(40, 1)
    rows[3] = replace(
        rows[3],
        sigma={"m": 5.0 * rows[3].sigma["m"]},
        held_out_rms={"m": 5.0 * rows[3].held_out_rms["m"]},
    )
    large = FleetParameter("p0", "m", 0.02, 1e-5)
    rows[7] = replace(rows[7], parameters=(large, *rows[7].parameters[1:]))
    rows[9] = replace(rows[9], nominal_rms={"m": rows[9].nominal_rms["m"] / 40.0})
    rows[11] = replace(rows[11], measured=rows[12].measured)
    rows[30] = FleetRow("r30", FAILED, "why")
    outliers, notes = fleet_outliers(rows)
    assert notes == ()
    figures = [(outlier.name, outlier.figure) for outlier in outliers]
    assert set(figures[:2]) == {("r3", "noise"), ("r3", "cross-validated error")}
    assert figures[2:] == [
        ("r7", "p0"),
        ("r9", "nominal error"),
        ("r11", "data"),
        ("r12", "data"),
    ]
    texts = [outlier.text for outlier in outliers]
    assert texts[2].startswith("p0 20 mm, usually ")
    assert texts[4] == "the same measurements as r12 (11.csv)"
    # r11 and r12 count once.
    assert abs(outliers[0].z) > outliers[0].limit == limit(37, 3, 0.05 / 3.0)
    assert abs(outliers[0].z) >= abs(outliers[1].z)
    assert outliers[3].z < 0.0
    assert outliers[3].value == pytest.approx(rows[9].nominal_rms["m"])
    assert outliers[2].value == 0.02


def test_data_given_many_times_count_once():
    rows = fleet_of(12)
    rows[0] = replace(rows[0], nominal_rms={"m": 50.0 * rows[0].nominal_rms["m"]})
    alone, _ = fleet_outliers(rows)
    assert [(one.name, one.figure) for one in alone] == [("r0", "nominal error")]
    copies = [replace(rows[0], name=f"c{k}", data=f"c{k}.csv") for k in range(20)]
    outliers, _ = fleet_outliers([*rows, *copies])
    figures = [outlier for outlier in outliers if outlier.figure != "data"]
    assert [outlier.name for outlier in figures] == ["r0", *(copy.name for copy in copies)]
    numbers = {(outlier.z, outlier.usual, outlier.limit) for outlier in figures}
    assert numbers == {(alone[0].z, alone[0].usual, alone[0].limit)}
    few = fleet_of(FEWEST - 1)
    _, notes = fleet_outliers([*few, replace(few[0], name="copy")])
    assert notes[0] == few_text(robots=5, counted=4, needed=FEWEST, kind="")


def test_robots_are_compared_with_their_own_kind():
    rows = fleet_of(20)
    others = [
        replace(
            r,
            name=f"o{r.name}",
            kind="ur5 base tool0",
            nominal_rms={"m": 30 * r.nominal_rms["m"]},
            measured=r.name,
        )
        for r in rows[:6]
    ]
    single = replace(rows[0], name="x", kind="panda a b", measured="x")
    outliers, notes = fleet_outliers([*rows, *others, single])
    assert outliers == ()
    assert notes[0] == few_text(robots=1, counted=1, needed=FEWEST, kind="panda")


def test_a_figure_is_compared_if_enough_robots_have_it():
    for count in (FEWEST - 1, FEWEST):
        rows = fleet_of(FEWEST + 3)
        for k in range(count):
            change = 1.0 if k == 0 else 1e-6 * k
            own = FleetParameter("rare", "m", change, 1e-5)
            rows[k] = replace(rows[k], parameters=(*rows[k].parameters, own))
        outliers, _ = fleet_outliers(rows)
        expected = [("r0", "rare")] if count == FEWEST else []
        assert [(one.name, one.figure) for one in outliers] == expected


def test_parameters_that_are_not_determined_are_not_compared():
    rows = fleet_of(20)
    undetermined = FleetParameter("p0", "m", 0.02, math.nan)
    rows[7] = replace(rows[7], parameters=(undetermined, *rows[7].parameters[1:]))
    assert fleet_outliers(rows) == ((), ())


def test_a_score_compares_with_the_others_alone():
    x = np.array([0.0, 1.0, 2.0, 3.0, 104.0, np.nan])
    usual = np.array([True, True, True, True, False, False])
    z = scores(x, np.zeros(6), 0.0, usual)
    # Of those that are usual, each beside the other three; the fifth beside all four.
    for i in range(4):
        others = np.delete(x[:4], i)
        expected = (x[i] - others.mean()) / (others.std(ddof=1) * math.sqrt(1.0 + 1.0 / 3.0))
        assert z[i] == pytest.approx(expected)
    assert z[4] == pytest.approx((104.0 - 1.5) / (x[:4].std(ddof=1) * math.sqrt(1.25)))
    assert np.isnan(z[5])
    every = np.ones(4, dtype=bool)
    assert scores(np.ones(4), np.zeros(4), 0.0, every).tolist() == [0.0] * 4
    assert scores(np.array([1.0, 1.0, 1.0, 2.0]), np.zeros(4), 0.0, every)[3] == math.inf


def test_the_scale_of_a_score_is_the_largest_of_spread_floor_and_std():
    x = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    every = np.ones(5, dtype=bool)
    alone = scores(x, np.zeros(5), 0.0, every)
    deviations = np.array([x[i] - np.delete(x, i).mean() for i in range(5)])
    assert scores(x, np.zeros(5), 4.0, every) == pytest.approx(deviations / (4.0 * 1.25**0.5))
    stds = np.array([8.0, 0.0, 0.0, np.nan, 8.0])
    expected = deviations / (8.0 * 1.25**0.5)
    assert scores(x, stds, 0.0, every)[[0, 4]] == pytest.approx(expected[[0, 4]])
    assert scores(x, stds, 0.0, every)[1:4] == pytest.approx(alone[1:4])


def test_a_score_of_one_robot_among_equals_is_students_t():
    # An independent program's statistic: the t-test of one value beside the others.
    x = np.random.default_rng(5).normal(size=9)
    z = scores(x, np.zeros(9), 0.0, np.ones(9, dtype=bool))
    for i in range(9):
        found = scipy.stats.ttest_ind(x[i : i + 1], np.delete(x, i)).statistic
        assert z[i] == pytest.approx(found)


def test_the_usual_robots_are_those_of_rosners_example():
    # B. Rosner, Technometrics 25, 1983, table 1 (also NIST's handbook, 1.3.5.17.3): 54 values, of which the three
    # largest are outliers at 5 %, though neither the first nor the second of them alone would be.
    text = """-0.25 0.68 0.94 1.15 1.20 1.26 1.26 1.34 1.38 1.43 1.49 1.49 1.55 1.56 1.58 1.65 1.69 1.70 1.76
        1.77 1.81 1.91 1.94 1.96 1.99 2.06 2.09 2.10 2.14 2.15 2.23 2.24 2.26 2.35 2.37 2.40 2.47 2.54 2.62 2.64
        2.90 2.92 2.92 2.93 3.21 3.26 3.30 3.59 3.68 4.30 4.64 5.34 5.42 6.01"""
    x = np.array([float(word) for word in text.split()])
    every = np.ones(54, dtype=bool)
    usual = usual_robots(x, np.zeros(54), 0.0, every, 1, 0.05)
    assert x[~usual].tolist() == [5.34, 5.42, 6.01]
    first = float(np.abs(scores(x, np.zeros(54), 0.0, every)).max())
    assert first < limit(53, 1, 0.05)


def with_zeros(rows: list[FleetRow], std: float, seed: int) -> list[FleetRow]:
    """The same robots with the zeros of six joints [rad]."""
    zeros = np.random.default_rng(seed).normal(0.0, std, size=(len(rows), 6))
    return [
        replace(
            one,
            zeros=tuple(
                FleetParameter(f"zero of j{j}", "rad", float(x), 3e-4) for j, x in enumerate(of)
            ),
        )
        for one, of in zip(rows, zeros, strict=True)
    ]


@pytest.mark.parametrize("seed", range(10))
def test_a_joint_12_mrad_off_among_twenty_robots_is_found(seed):
    rows = with_zeros(fleet_of(20, 100 + seed), 1.5e-3, seed)
    others, _ = fleet_outliers(rows)
    zeros = list(rows[6].zeros)
    zeros[2] = replace(zeros[2], change=zeros[2].change + 0.012)
    rows[6] = replace(rows[6], zeros=tuple(zeros))
    outliers, _ = fleet_outliers(rows)
    found = [one for one in outliers if (one.name, one.figure) == ("r6", "zero of j2")]
    assert len(found) == 1
    assert found[0].unit == "rad"
    assert found[0].z > found[0].limit
    assert others == ()
    assert len(outliers) == 1
