"""The odd ones of a fleet: those that are, no others, and nothing where there are too few."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.fleets.record import (
    FEWEST,
    ROWS,
    FleetParameter,
    FleetRow,
    fleet_outliers,
    limit,
    measured_hash,
    scores,
)
from calib.json_files import json_bytes
from calib.text.fleet import few_text


def row(k: int, rng: np.random.Generator, parameters: int = 10) -> FleetRow:
    """One of many like it."""
    sizes = np.exp(rng.normal(size=3) * (0.3, 0.15, 0.15)) * (3e-3, 8e-5, 4e-5)
    nominal, held_out, sigma = sizes.tolist()
    own = tuple(
        FleetParameter(f"p{i}", "m", float(rng.normal(0.0, 3e-4)), 1e-5) for i in range(parameters)
    )
    return FleetRow(
        f"r{k}", "done", verdict="use", model="dh", rows=30, nominal_rms=nominal, held_out_rms=held_out, sigma=sigma,
        kind="ur3 base tool0 j1", data=f"{k}.csv", measured=str(rng.random()), parameters=own,
    )  # fmt: skip


def fleet_of(count: int, seed: int = 0, **more: int) -> list[FleetRow]:
    rng = np.random.default_rng(seed)
    return [row(k, rng, **more) for k in range(count)]


@pytest.mark.parametrize("count", [5, 12, 60])
def test_few_fleets_without_odd_ones_have_one(count):
    fleets = 120
    flagged = sum(bool(fleet_outliers(fleet_of(count, seed))[0]) for seed in range(fleets))
    # 5 % of them, and three standard deviations.
    assert flagged <= 0.05 * fleets + 3.0 * math.sqrt(0.05 * 0.95 * fleets)


def test_the_odd_ones_are_found_with_their_reasons():
    rows = fleet_of(40)
    rows[3] = replace(rows[3], sigma=5.0 * rows[3].sigma, held_out_rms=5.0 * rows[3].held_out_rms)
    rows[7] = replace(
        rows[7], parameters=(FleetParameter("p0", "m", 0.02, 1e-5), *rows[7].parameters[1:])
    )
    rows[9] = replace(rows[9], nominal_rms=rows[9].nominal_rms / 40.0)
    rows[11] = replace(rows[11], measured=rows[12].measured)
    rows[30] = FleetRow("r30", "failed", "why")
    odd, notes = fleet_outliers(rows)
    assert notes == ()
    found = [(one.name, one.figure) for one in odd]
    assert set(found[:2]) == {("r3", "noise"), ("r3", "cross-validated error")}
    assert found[2:] == [
        ("r7", "p0"),
        ("r9", "nominal error"),
        ("r11", "data"),
        ("r12", "data"),
    ]
    texts = [one.text for one in odd]
    assert texts[2].startswith("p0 20 mm, usually ")
    assert texts[4] == "the same measurements as r12 (11.csv)"
    # r11 and r12 count once.
    assert abs(odd[0].z) > odd[0].limit == limit(38, 3, 0.025)
    assert odd[3].z < 0.0


def test_data_given_many_times_count_once():
    rows = fleet_of(12)
    rows[0] = replace(rows[0], nominal_rms=50.0 * rows[0].nominal_rms)
    alone = fleet_outliers(rows)[0]
    assert [(one.name, one.figure) for one in alone] == [("r0", "nominal error")]
    copies = [replace(rows[0], name=f"c{k}", data=f"c{k}.csv") for k in range(20)]
    odd, _ = fleet_outliers([*rows, *copies])
    figures = [one for one in odd if one.figure != "data"]
    assert [one.name for one in figures] == ["r0", *(copy.name for copy in copies)]
    assert {(one.z, one.usual, one.limit) for one in figures} == {
        (alone[0].z, alone[0].usual, alone[0].limit)
    }
    few = fleet_of(FEWEST - 1)
    notes = fleet_outliers([*few, replace(few[0], name="copy")])[1]
    assert notes[0] == few_text(robots=5, counted=4, needed=FEWEST, kind="")


def test_robots_are_compared_with_their_own_kind():
    rows = fleet_of(20)
    others = [replace(r, name=f"o{r.name}", kind="ur5 base tool0", nominal_rms=30 * r.nominal_rms, measured=r.name)
              for r in rows[:6]]  # fmt: skip
    odd, notes = fleet_outliers(
        [*rows, *others, replace(rows[0], name="x", kind="panda a b", measured="x")]
    )
    assert odd == ()
    assert notes[0] == few_text(robots=1, counted=1, needed=FEWEST, kind="panda")


def test_scores():
    x = np.array([0.0, 1.0, 2.0, 3.0, 104.0, np.nan])
    z = scores(x, np.zeros(6), 0.0, np.ones(6, dtype=bool))
    assert z[:5] == pytest.approx((x[:5] - 2.0) / 1.4826)
    assert np.isnan(z[5])
    every = np.ones(4, dtype=bool)
    assert scores(np.ones(4), np.zeros(4), 0.0, every).tolist() == [0.0] * 4
    assert scores(np.array([1.0, 1.0, 1.0, 2.0]), np.zeros(4), 0.0, every)[3] == math.inf


def test_the_same_measurements_in_another_order_or_unit_have_the_same_hash(paper_table):
    m = paper_table
    turned = Measurements(m.joint_names, m.joints[::-1] * (1.0 + 1e-13), m.points[::-1])
    assert measured_hash(turned) == measured_hash(m)
    moved = m.points.copy()
    moved[4, 1] += 1e-6
    assert measured_hash(Measurements(m.joint_names, m.joints, moved)) != measured_hash(m)


def test_a_row_survives_its_file():
    one = replace(fleet_of(1)[0], sigma_angle=math.nan)
    parameters = (*one.parameters, FleetParameter("q", "rad", 0.1, math.nan))
    one = replace(one, parameters=parameters)
    assert repr(ROWS.read(FleetRow, json.loads(json_bytes(ROWS.table(one))))) == repr(one)
