"""Whether a tolerance is kept: the decision rule, and what counts against it; its text and its table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError, MeasurementError
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.show.as_text import blocks_text
from calib.show.blocks import TERMINAL
from calib.verbs.evaluate.acceptance import Acceptance, Check, acceptance, assess
from calib.verbs.evaluate.accuracy import accuracy
from calib.verbs.evaluate.evaluation import Evaluation, evaluate
from calib.verbs.evaluate.evaluation_file import acceptance_table
from calib.verbs.evaluate.report import Origins, summary
from calib.verbs.evaluate.tables import accuracies, board_errors
from calib.verbs.evaluate.text import NAMES
from tests import images
from tests.verbs.calibrate.seen import by_images


def table_of(
    robot: Robot,
    lengths: list[float],
    repeats: int = 1,
    turns: list[float] | None = None,
    **columns: object,
) -> Measurements:
    """Rows that are off by these lengths [mm] along x, one for each pose, and by these angles [mrad] about z."""
    q = np.repeat(random_joint_values(robot, len(lengths), 3), repeats, axis=0)
    poses = robot.poses(q)
    e = np.outer(1e-3 * np.repeat(lengths, repeats), [1.0, 0.0, 0.0])
    if turns is not None:
        w = np.outer(1e-3 * np.repeat(turns, repeats), [0.0, 0.0, 1.0])
        columns["rotations"] = Rotation.from_rotvec(w).as_matrix() @ poses[:, :3, :3]
        columns["kinds"] = ("pose",) * len(q)
    return Measurements(robot.joint_names, q, poses[:, :3, 3] + e, **columns)


KNOWN = Cell(target=(0.0, 0.0, 0.0), estimate_target=False)


def evaluation(
    robot: Robot, lengths: list[float], *args: object, cell: Cell = KNOWN, **columns: object
) -> Evaluation:
    return evaluate(robot, table_of(robot, lengths, *args, **columns), cell)


@pytest.mark.parametrize(
    ("figure", "uncertainty", "factor", "outcome"),
    [
        (0.4, 0.0, 1.0, "pass"),
        (0.5, 0.0, 1.0, "pass"),
        (0.6, 0.0, 1.0, "fail"),
        (0.4, 0.1, 1.0, "pass"),
        (0.45, 0.1, 1.0, "undecided"),
        (0.55, 0.1, 1.0, "undecided"),
        (0.7, 0.1, 1.0, "fail"),
        (0.4, 0.0, 1.2, "pass"),
        (0.4, 0.0, 1.3, "undecided"),
        (0.4, 0.05, 1.2, "undecided"),
        (0.1, 0.0, np.inf, "undecided"),
        (0.6, 0.0, np.inf, "fail"),
    ],
)
def test_the_decision_rule(figure: float, uncertainty: float, factor: float, outcome: str):
    # In units that doubles hold exactly: 0.5 is the tolerance.
    check = Check(figure, 0.5, uncertainty, factor, seen=False)
    assert check.outcome == outcome
    seen = replace(check, seen=True).outcome
    assert seen == ("fail" if outcome == "fail" else "undecided")


def test_an_acceptance_in_one_line(ur3: Robot):
    found = acceptance(evaluation(ur3, [0.1, 0.2, 0.6], 3), {"m": 0.5e-3})
    assert repr(found) == "Acceptance(fail, max 0.600 of 0.5 mm, 2 of 3 poses within)"


def test_what_is_judged_depends_on_the_criterion(ur3: Robot):
    found = evaluation(ur3, [0.1, 0.2, 0.6], 3)
    shaken = replace(
        found, residual=found.residual + 1e-4 * np.tile([[1.0], [0.0], [-1.0]], (3, 3))
    )
    figures = [
        acceptance(shaken, {"m": 0.5e-3}, criterion=name).checks["m"].figure
        for name in ("max", "mean", "single")
    ]
    assert figures == pytest.approx([0.6e-3, 0.3e-3, 1e-3 * np.sqrt(0.7**2 + 2 * 0.1**2)])
    assert acceptance(found, {"m": 0.5e-3}).outcome == "fail"
    assert acceptance(found, {"m": 0.5e-3}, criterion="mean").outcome == "pass"
    single = acceptance(shaken, {"m": 0.65e-3}, criterion="single")
    assert (single.outcome, single.within) == ("fail", 2)


@pytest.mark.parametrize("count", [5, 30, 59])
def test_the_share_holds_with_the_confidence_that_is_stated(ur3: Robot, count: int):
    """Clopper and Pearson: whatever the true share is, the limit lies above it once in twenty at most."""
    figures = accuracy(evaluation(ur3, [0.1] * count))
    limits = np.array([Acceptance(figures, "max", {}, within).share for within in range(count + 1)])
    assert limits[0] == 0.0
    assert limits[-1] == pytest.approx(0.05 ** (1.0 / count))
    for true in np.linspace(0.02, 0.98, 49):
        covered = binom.pmf(np.arange(count + 1), count, true)[limits <= true].sum()
        assert covered >= 0.95 - 1e-12


def test_what_registering_takes_away_is_counted(ur3: Robot):
    found = evaluation(ur3, [0.1, -0.1] * 3, cell=Cell())
    a = acceptance(found, {"m": 1e-3}, uncertainty={"m": 0.04e-3})
    assert a.checks["m"].factor == pytest.approx(np.sqrt(18 / 15))
    assert a.checks["m"].held == pytest.approx(a.checks["m"].figure * np.sqrt(18 / 15) + 0.04e-3)
    assert acceptance_table(a)["m"]["held"] == a.checks["m"].held
    cell = Cell(estimate_frame=True)
    nothing_left = acceptance(evaluation(ur3, [0.1, -0.1, 0.1], cell=cell), {"m": 1.0})
    assert (nothing_left.accuracy.unknowns, nothing_left.accuracy.numbers) == (9, 9)
    assert nothing_left.outcome == "undecided"


def test_rows_that_the_fit_saw_prove_nothing(ur3: Robot):
    assert acceptance(evaluation(ur3, [0.1, 0.2]), {"m": 0.5e-3}, seen=True).outcome == "undecided"
    assert acceptance(evaluation(ur3, [0.1, 0.6]), {"m": 0.5e-3}, seen=True).outcome == "fail"
    sets = ("estimate", "estimate", "validate")
    apart = acceptance(evaluation(ur3, [0.9, 0.9, 0.1], sets=sets), {"m": 0.5e-3}, seen=True)
    assert (apart.outcome, apart.accuracy.others) == ("pass", ("calibration",))


def test_the_text_of_a_verdict(ur3: Robot):
    table = table_of(
        ur3, [0.1 * k for k in range(1, 13)], 3, turns=[1.0] * 12, targets=("a", "b") * 18
    )
    cell = Cell(targets={"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, 0.0)}, estimate_target=False)
    found = assess(
        ur3, table, cell, limits={"tolerance": {"m": 0.55e-3}, "uncertainty": {"m": 1e-4}}
    )
    text = summary(found, Origins("", target="as given"))
    assert text.splitlines()[0] == "Verdict: fail"
    said = " ".join(text.split())
    for part in (
        "The largest AP of 24 poses is 1.200 mm (rows",
        "above the tolerance of 0.550 mm.",
        "1.200 - guard band 0.100 (k = 2, ISO 14253-1) = 1.100 mm > 0.550 mm.",
        "ISO 9283 asks for 5 poses, each 30 times; measured: 24, each 1 to 2 times.",
        "10 of 24 poses are within: of poses chosen at random in the same way at least",
        "Orientations have no tolerance and are not evaluated.",
        "Orientation, ISO 9283 [deg]",
        "Poses, the worst first, of the URDF as it is:",
        "and 14 more",
    ):
        assert part in said
    assert max(map(len, text.splitlines())) <= 100


def test_robots_side_by_side(ur3: Robot):
    many = accuracy(evaluation(ur3, [0.1, 0.2], 3, turns=[1.0, 2.0]))
    few = accuracy(evaluation(ur3, [0.3, 0.4]))
    tables = accuracies({"nominal": few, "urdf": many}, "urdf", TERMINAL)
    lines = [line.split() for line in blocks_text(tables).splitlines()]
    assert lines[1] == ["nominal", "2", "0.400", "0.350", "-", "-", "0.400"]
    assert lines[2] == ["URDF", "as", "it", "is", "2", "0.200", "0.150", "0.000", "0.000", "0.200"]
    assert lines[5] == ["nominal", "0", "-", "-", "-", "-", "-"]
    assert lines[6] == [
        "URDF",
        "as",
        "it",
        "is",
        "2",
        "0.1146",
        "0.0859",
        "0.0000",
        "0.0000",
        "0.1146",
    ]


COMMANDS = ("correction position [mm]",)


@pytest.mark.parametrize(
    ("lengths", "ignored", "refused"),
    [
        ([0.0] * 8, COMMANDS, True),
        ([0.0] * 8, (), False),
        ([0.0] * 8, ("temperature [C]",), False),
        # Measured there, or too few rows for a frame and a target.
        ([0.01, -0.01] * 4, COMMANDS, False),
        ([0.0] * 3, COMMANDS, False),
        ([0.0], COMMANDS, False),
    ],
)
def test_commands_are_refused_where_the_nominal_robot_predicts_them(
    ur3: Robot, lengths: list[float], ignored: tuple[str, ...], refused: bool
):
    table = table_of(ur3, lengths, ignored=ignored)
    if refused:
        with pytest.raises(MeasurementError, match="'calib compensate' wrote"):
            assess(ur3, table, KNOWN)
    else:
        assert assess(ur3, table, KNOWN).judged == "urdf"


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"tolerance": {}}, CalibError, "State a tolerance"),
        ({"tolerance": {"m": 0.0}}, CalibError, r"The tolerance is 0.0 m"),
        (
            {"tolerance": {"m": 1e-3}, "uncertainty": {"m": -1e-4}},
            CalibError,
            r"uncertainty of -0.0001 m",
        ),
        ({"tolerance": {"mm": 0.5}}, CalibError, "'mm' is not a unit of residuals"),
        (
            {"tolerance": {"m": 1e-3}, "criterion": "best"},
            CalibError,
            "choose one of 'max', 'mean'",
        ),
        (
            {"tolerance": {"rad": np.radians(0.1)}},
            MeasurementError,
            r"0\.1 deg .* no orientation",
        ),
    ],
)
def test_what_nothing_can_be_judged_by_is_refused(
    ur3: Robot, options: dict, error: type, message: str
):
    with pytest.raises(error, match=message):
        acceptance(evaluation(ur3, [0.1]), **options)


def test_what_a_calibration_of_images_expects_of_a_board_is_told_of_the_robot_that_is_judged():
    c = by_images()
    m = images.table(images.poses(14)[10:], noise=0.3)
    found = assess(images.arm(), m, images.cell(), c)
    assert found.expected == c.new_point[0]
    board = found.evaluations["calibration"].images.board
    assert board.views == 4
    (shown,) = [row for row in board_errors(found).rows if row[0] == NAMES["calibration"]]
    assert shown[1:] == (
        *(board.across, board.across_alone, board.predicted_across),
        *(board.depth, board.depth_alone, board.predicted_depth),
        *(board.depth_bias, board.depth_bias_std),
    )
    assert assess(images.arm(), m, images.cell(), c, judge="nominal").expected is None
    assert assess(images.arm(), m, images.cell()).expected is None
