"""Spoilt tables of DH rows of an arm that nobody sells: three poses of its controller name the cell that is wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.dh_changes import Change
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.usual_mistakes import find_usual_mistake
from calib.robot.robot import Robot

Numbers = tuple[float, ...]

#: theta, d, a, alpha [deg and mm], direction, offset [deg] of the arm that stands there.
STANDARD: dict[str, Numbers] = {
    "J1": (0, 431, 62, -90, -1, 0),
    "J2": (0, 0, 517, 0, 1, -90),
    "J3": (0, 0, 48, -90, 1, 0),
    "J4": (0, 463, 0, 90, -1, 0),
    "J5": (0, 0, 0, -90, 1, 0),
    "J6": (180, 92, 0, 0, -1, 0),
}

#: Its rows in Craig's convention: alpha and a are those of the row before.
MODIFIED: dict[str, Numbers] = {
    "J1": (0, 431, 0, 0, -1, 0),
    "J2": (0, 0, 62, -90, 1, -90),
    "J3": (0, 0, 517, 0, 1, 0),
    "J4": (0, 463, 48, -90, -1, 0),
    "J5": (0, 0, 0, 90, 1, 0),
    "J6": (180, 92, 0, -90, -1, 0),
}

#: Two joints are counted together, as palletisers do: the reading of J3 counts that of J2.
COUPLING = {"J3": "1 * J2"}

#: An arm of three parallel axes: its d2 and d3 have the effect of d4.
PARALLEL: dict[str, Numbers] = {
    "J1": (0, 181, 0, 90, 1, 0),
    "J2": (0, 0, -613, 0, 1, 0),
    "J3": (0, 0, -572, 0, 1, 0),
    "J4": (0, 174, 0, 90, 1, 0),
    "J5": (0, 120, 0, -90, 1, 0),
    "J6": (0, 117, 0, 0, 1, 0),
}

#: A palletiser: four joints.
PALLETISER: dict[str, Numbers] = {
    "J1": (0, 431, 62, -90, 1, 0),
    "J2": (0, 0, 517, 0, 1, 0),
    "J3": (0, 0, 480, 0, 1, 0),
    "J4": (0, 0, 85, 90, 1, 0),
}

COLUMNS = ("theta", "d", "a", "alpha", "direction", "offset")

#: Readings off a pendant [deg].
POSES = (
    (0, -20, 15, 0, 30, 0),
    (35, -48, 62, 24, 47, -55),
    (-72, 31, -28, -63, -81, 108),
)


def table_text(rows: dict[str, Numbers], *, modified: bool = False, coupling: bool = False) -> str:
    index = "(i-1)" if modified else ""
    lines = [
        f"joint,theta [deg],d [mm],a{index} [mm],alpha{index} [deg],direction,offset [deg],coupling"
    ]
    for joint, numbers in rows.items():
        shown = [f"{number:g}" for number in numbers]
        lines.append(",".join([joint, *shown, COUPLING.get(joint, "") if coupling else ""]))
    return "\n".join([*lines, ""])


def turn(axis: str, angle: float, along: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    if axis == "z":
        return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, along], [0, 0, 0, 1]])
    return np.array([[1, 0, 0, along], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def true_poses(rows: dict[str, Numbers], q: np.ndarray, *, modified: bool = False) -> np.ndarray:
    """T_base_tip of the product written down anew, (N, 4, 4) [m]; q are the joints' values [rad]."""
    poses = []
    for values in q:
        T = np.eye(4)
        for value, numbers in zip(values, rows.values(), strict=True):
            theta, d, a, alpha, direction, offset = numbers
            z = turn("z", np.radians(theta + offset) + direction * value, 1e-3 * d)
            x = turn("x", np.radians(alpha), 1e-3 * a)
            T = T @ (x @ z if modified else z @ x)
        poses.append(T)
    return np.array(poses)


def with_cell(rows: dict[str, Numbers], joint: str, **cells: float) -> dict[str, Numbers]:
    numbers = dict(zip(COLUMNS, rows[joint], strict=True)) | cells
    return rows | {joint: tuple(numbers.values())}


def exchanged(rows: dict[str, Numbers], first: str, second: str) -> dict[str, Numbers]:
    """The two lines in each other's place, with their joints."""
    names = [{first: second, second: first}.get(name, name) for name in rows]
    return {name: rows[name] for name in names}


@dataclass(frozen=True)
class Spoilt:
    """A table with a mistake, and how it is told."""

    text: str
    why: Why
    #: Joint, column, and the right number [deg or mm], of each wrong cell.
    cells: tuple[tuple[str, str, float], ...] = ()
    #: The right rows.
    true: dict[str, Numbers] | None = None
    modified: bool = False
    coupling: bool = False


def one(joint: str, column: str, wrong: float, rows: dict[str, Numbers] = STANDARD) -> Spoilt:
    """One cell is wrong."""
    right = rows[joint][COLUMNS.index(column)]
    modified = rows is MODIFIED
    text = table_text(with_cell(rows, joint, **{column: wrong}), modified=modified)
    return Spoilt(text, Why.DH_CELLS, ((joint, column, right),), rows, modified)


TABLES = {
    "sign of alpha1": one("J1", "alpha", 90),
    "sign of alpha3": one("J3", "alpha", 90),
    "sign of alpha5": one("J5", "alpha", 90),
    "alpha4 missing": one("J4", "alpha", 0),
    "sign of a2": one("J2", "a", -517),
    "a3 missing": one("J3", "a", 0),
    "a2 of a longer arm": one("J2", "a", 627),
    "a1 and d1 exchanged": Spoilt(
        table_text(with_cell(STANDARD, "J1", d=62, a=431)),
        Why.DH_CELLS,
        (("J1", "d", 431), ("J1", "a", 62)),
    ),
    "sign of d4": one("J4", "d", -463),
    "d4 9 mm too short": one("J4", "d", 454),
    "d4 of parallel axes 9 mm too short": one("J4", "d", 165, PARALLEL),
    "wrong d1": one("J1", "d", 341),
    "d6 missing": one("J6", "d", 0),
    # Without another offset in the table theta is the column of zeros.
    "offset of J2 missing": Spoilt(
        one("J2", "offset", 0).text, Why.DH_CELLS, (("J2", "theta", -90),)
    ),
    "offset of J2 missing beside another": one(
        "J2", "offset", 0, with_cell(STANDARD, "J3", offset=30)
    ),
    "theta of J3 off by 90 deg": one("J3", "theta", 90),
    "wrong a6": one("J6", "a", 40),
    "wrong a0 of modified rows": one("J1", "a", 40, MODIFIED),
    "wrong a5 of modified rows": one("J6", "a", 40, MODIFIED),
    "a2 of a palletiser": one("J2", "a", 571, PALLETISER),
    "sense of J4": one("J4", "direction", 1),
    "lines J5 and J6 exchanged": Spoilt(
        table_text(exchanged(STANDARD, "J5", "J6"), coupling=True),
        Why.DH_ROWS_EXCHANGED,
        coupling=True,
    ),
    "numbers of J2 and J3 exchanged": Spoilt(
        table_text(STANDARD | {"J2": STANDARD["J3"], "J3": STANDARD["J2"]}),
        Why.DH_NUMBERS_EXCHANGED,
    ),
    "modified rows read as standard": Spoilt(
        table_text(MODIFIED), Why.DH_CONVENTION, modified=True, true=MODIFIED
    ),
    "standard rows read as modified": Spoilt(
        table_text(STANDARD, modified=True), Why.DH_CONVENTION
    ),
    "the variant with longer arms": Spoilt(
        table_text(with_cell(with_cell(STANDARD, "J2", a=437), "J4", d=383)),
        Why.DH_CELLS,
        (("J2", "a", 517), ("J4", "d", 463)),
    ),
}


#: What has the effect of the wrong cell; of the other tables nothing has.
ELSEWHERE = {
    "wrong d1": "base",
    "d6 missing": "tool",
    "offset of J2 missing": "joint",
    "offset of J2 missing beside another": "joint",
    "theta of J3 off by 90 deg": "joint",
    "wrong a6": "tool",
    "wrong a0 of modified rows": "base",
    "sense of J4": "joint",
}


def shown(
    spoilt: Spoilt, rng: np.random.Generator | None = None, sigma: float = 0.0
) -> Measurements:
    """What the pendant shows: rounded to 0.01 deg and 0.01 mm; with a generator, with noise of sigma of these."""
    rows = spoilt.true or STANDARD
    shown_readings = np.radians(np.array(POSES, dtype=float))[:, : len(rows)]
    readings = shown_readings
    if rng is not None:
        readings = readings + np.radians(0.01) * sigma * rng.standard_normal(readings.shape)
    values = readings.copy()
    if spoilt.coupling:
        values[:, 2] += values[:, 1]
    T = true_poses(rows, values, modified=spoilt.modified)
    points, rotations = T[:, :3, 3], T[:, :3, :3]
    if rng is not None:
        points = points + 1e-5 * sigma * rng.standard_normal(points.shape)
        for i in range(3):
            around = np.radians(0.01) * sigma * rng.standard_normal(len(T))
            axis = np.eye(3)[i]
            rotations = rotations @ np.array(
                [np.eye(3) + angle * np.cross(np.eye(3), axis) for angle in around]
            )
        left, _, right = np.linalg.svd(rotations)
        rotations = left @ right
    return Measurements(
        tuple(f"J{i + 1}" for i in range(len(rows))),
        shown_readings,
        np.round(points, 5),
        kinds=("pose",) * len(POSES),
        rotations=rotations,
    )


GIVEN = Cell(target=read_only(np.zeros(3)), estimate_target=False)


def told(spoilt: Spoilt, table: Measurements, folder: Path, cell: Cell = GIVEN) -> Reason | None:
    path = folder / "rows.csv"
    path.write_text(spoilt.text)
    return find_usual_mistake(Robot.load(path), cell, table)


def is_named(reason: Reason | None, spoilt: Spoilt, within: float = 0.5) -> bool:
    """Whether the cells are the right ones, with the right numbers, within so many mm or deg."""
    if reason is None or reason.why is not spoilt.why:
        return False
    cells = reason.values.get("cells", [])
    if len(cells) != len(spoilt.cells):
        return False
    for cell, (joint, column, right) in zip(cells, spoilt.cells, strict=True):
        factor = {"m": 1e3, "rad": np.degrees(1.0), "": 1.0}[cell["unit"]]
        # One line a joint, after the header.
        line = int(joint.removeprefix("J")) + 1
        place = (cell["joint"], cell["column"], cell["line"]) == (joint, column, line)
        if not place or abs(factor * cell["wanted"] - right) > within:
            return False
    return True


@pytest.mark.parametrize("name", TABLES)
def test_three_poses_name_the_wrong_cell(name, tmp_path):
    spoilt = TABLES[name]
    reason = told(spoilt, shown(spoilt), tmp_path)
    assert reason is not None
    assert is_named(reason, spoilt, within=0.05)
    assert reason.values["error_m"] < 5e-5
    assert reason.values["error_rad"] < 1e-3
    assert "others" not in reason.values
    if spoilt.why is Why.DH_CELLS:
        assert reason.values["elsewhere"] == ELSEWHERE.get(name, "")


@pytest.mark.parametrize(
    ("name", "joints"),
    [("lines J5 and J6 exchanged", ["J6", "J5"]), ("numbers of J2 and J3 exchanged", ["J2", "J3"])],
)
def test_exchanged_rows_are_named_by_their_lines(name, joints, tmp_path):
    values = told(TABLES[name], shown(TABLES[name]), tmp_path).values
    assert [values["first"], values["second"]] == joints
    assert values["lines"] == [1 + int(min(joints)[1]), 1 + int(max(joints)[1])]


@pytest.mark.parametrize(
    "name", ["sign of alpha3", "d4 9 mm too short", "the variant with longer arms"]
)
def test_with_the_noise_of_a_pendant_too(name, tmp_path):
    table = shown(TABLES[name], np.random.default_rng(2), 1.0)
    assert is_named(told(TABLES[name], table, tmp_path), TABLES[name])


@pytest.mark.parametrize("rows", [STANDARD, MODIFIED, PARALLEL])
def test_nothing_is_said_of_right_rows(rows, tmp_path):
    right = Spoilt(
        table_text(rows, modified=rows is MODIFIED), Why.DH_CELLS, (), rows, rows is MODIFIED
    )
    assert told(right, shown(right), tmp_path) is None
    assert told(right, shown(right, np.random.default_rng(1), 1.0), tmp_path) is None


def test_a_column_in_another_unit_and_another_arm_are_named(tmp_path):
    tenth = {joint: (n[0], n[1], 0.1 * n[2], *n[3:]) for joint, n in STANDARD.items()}
    in_cm = Spoilt(table_text(tenth), Why.DH_UNIT)
    reason = told(in_cm, shown(in_cm), tmp_path)
    assert reason is not None
    assert (reason.why, reason.values["unit"]) == (Why.DH_UNIT, "cm")
    assert (reason.values["what"], reason.values["factor"]) == ("numbers of a", 10.0)

    # The lengths of a UR3, while a UR10e stands there.
    lengths = {"J1": (151.9, 0), "J2": (0, -243.65), "J3": (0, -213.25)}
    lengths |= {"J4": (112.35, 0), "J5": (85.35, 0), "J6": (81.9, 0)}
    ur3 = {joint: (0, *lengths[joint], *n[3:]) for joint, n in PARALLEL.items()}
    ur10e = {"J1": 180.7, "J4": 174.15, "J5": 119.85, "J6": 116.55}
    true = {joint: (0, ur10e.get(joint, 0), *n[2:]) for joint, n in PARALLEL.items()}
    true = with_cell(with_cell(true, "J2", a=-612.7), "J3", a=-571.55)
    other = Spoilt(table_text(ur3), Why.DH_VARIANT, true=true)
    reason = told(other, shown(other), tmp_path)
    assert reason is not None
    assert (reason.why, reason.values["arm"]) == (Why.DH_VARIANT, "UR10e")

    # One length of it is a slip, and no other arm.
    slip = Spoilt(table_text(with_cell(true, "J5", d=19.85)), Why.DH_CELLS, (("J5", "d", 119.85),))
    assert is_named(told(slip, shown(replace(slip, true=true)), tmp_path), slip, within=0.001)


def test_rows_that_agree_at_some_joint_values_alone_are_another_robot(tmp_path):
    """A joint that counts the other way from another zero; a whole turn more is the same robot."""
    path = tmp_path / "rows.csv"
    path.write_text(table_text(STANDARD))
    dh = Robot.load(path).urdf.dh

    def with_first(**numbers: float) -> Change:
        first = replace(dh.table.rows[0], **numbers)
        table = replace(dh.table, rows=(first, *dh.table.rows[1:]))
        return Change(replace(dh, table=table), Why.DH_CELLS)

    for at in (-1.0, 0.0, 1.0):
        turned = with_first(direction=1.0, offset=-2.0 * at)
        q = np.array([[at, 0.3, -0.2, 0.5, 0.1, 0.4]])
        assert turned.rows.poses(q) == pytest.approx(dh.poses(q))
        assert not with_first().makes_same_robot(turned)
    assert with_first().makes_same_robot(with_first(offset=2.0 * np.pi))


def test_of_two_mistakes_none_is_named(tmp_path):
    """Positions alone would have the signs of joints reversed, or two lengths; the orientations contradict."""
    wrong = with_cell(with_cell(STANDARD, "J5", alpha=90), "J1", d=531)
    both = Spoilt(table_text(wrong), Why.DH_CELLS)
    assert told(both, shown(both), tmp_path) is None


def measured(count: int, *, noise: float) -> Measurements:
    """Points of a reflector on an arm that is off by a millimetre or so."""
    rng = np.random.default_rng(5)
    q = rng.uniform(-1.5, 1.5, (count, 6))
    bent = {
        joint: tuple(np.add(n, [*rng.normal(0, 0.1, 4), 0, 0])) for joint, n in STANDARD.items()
    }
    T = true_poses(bent, q)
    points = T[:, :3, 3] + T[:, :3, :3] @ np.array([0.04, -0.03, 0.06])
    names = tuple(f"J{i + 1}" for i in range(6))
    return Measurements(names, q, points + noise * rng.standard_normal(points.shape))


@pytest.mark.slow
@pytest.mark.parametrize("frame", [False, True])
def test_a_cell_is_named_on_a_measured_arm_whose_target_is_sought(frame, tmp_path):
    table = measured(20, noise=5e-5)
    cell = Cell(estimate_frame=frame)
    for name in ("sign of alpha3", "sign of a2"):
        reason = told(TABLES[name], table, tmp_path, cell)
        assert is_named(reason, TABLES[name]), name
        assert reason is not None
        assert "others" not in reason.values
        assert reason.values["error_m"] < 0.02
    assert told(Spoilt(table_text(STANDARD), Why.DH_CELLS), table, tmp_path, cell) is None
