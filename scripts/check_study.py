"""What three fresh poses say about a robot that something has happened to, or nothing.

    python scripts/check_study.py [CALIBRATIONS] [CHECKS] [SEED] [--only WORD] [--workers N]

A true robot is drawn, measured at 40 poses and calibrated, and three poses to check at are chosen by
`calib.check_poses`. There it is measured again, with nothing moved; with the frame moved (tracker or camera); the
target (reflector or board); and the zero of a joint at random: by 3 to 30 times the noise of a coordinate at the
target, rms over random poses, at random in the logarithm. Of pictures that noise is the uncertainty of the position of
the board in one of them, an axis.

Printed are, of each kind of change, how often something was said to have moved, how often the true cause is the most
probable one and nothing is said but that, how often it is that one or among those named as undecided, and of the
undecided, how often the further poses that the check asks for decide, and rightly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from studies import TYPICAL_ERRORS, print_table, run_cases, study_parser

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.surroundings import TrackerNoise
from calib.result.calibrate import calibrate
from calib.robot.robot import Robot
from calib.verbs.check.check import CheckResult, fresh_stops, judged
from calib.verbs.check.innovations import LEVER, StoredResult
from calib.verbs.check.poses import candidates_of, check_poses, further_poses
from calib.verbs.simulate.scenario import Scenario, VirtualCell

#: Base and tip of each arm.
LINKS = {
    "ur3": ("base", "tool0"),
    "ur10e": ("base", "tool0"),
    "panda": ("panda_link0", "panda_link8"),
}

CHANGES = ("nothing", "frame", "target", "joint")

#: Poses that are calibrated with.
POSES = 40

#: Noise of a coordinate by the instrument and by the robot [m], and of a corner [px].
NOISE, REPEATABILITY, CORNER = 3e-5, 2e-5, 0.15

#: Change over the noise.
SMALLEST, LARGEST = 3.0, 30.0


@dataclass(frozen=True)
class Case:
    """An arm and what measures it."""

    name: str  # Of the arm
    instrument: str  # "points", "camera in the hand" or "camera fixed"
    checks: int  # Of each change, of each calibration


@dataclass(frozen=True)
class Outcome:
    """One check."""

    change: str
    size: float  # Over the noise
    alarm: bool
    strict: bool  # The true cause is sure, or with nothing moved nothing is said
    honest: bool  # It is the most probable one, or among those named as undecided
    first: bool  # It is the most probable one
    asked: bool  # Further poses were asked for
    decided: bool  # They made one cause sure
    rightly: bool  # The true one
    poses: int  # How many they were


def drawn_cell(case: Case, seed: int) -> tuple[VirtualCell, Cell]:
    """Draw a virtual cell, and return it with what a user knows of it."""
    noise = TrackerNoise(constant=NOISE, per_length=0.0, repeatability=REPEATABILITY)
    arm = Robot.load(case.name, *LINKS[case.name])
    if case.instrument == "points":
        cell = Cell(estimate_frame=True)
        scenario = Scenario(arm, cell, "dh", dict(TYPICAL_ERRORS), noise=noise)
        return scenario.draw(seed), cell
    if case.instrument == "camera in the hand":
        arm = Robot.load(case.name, base=arm.tip, tip=arm.base)
    cell = Cell(kind="pixel", estimate_frame=True, sigma={"px": CORNER})
    virtual = Scenario(arm, cell, "dh", dict(TYPICAL_ERRORS), noise=noise).draw(seed)
    equipment = virtual.equipment
    assert equipment is not None
    known = replace(
        cell,
        cameras={"": equipment.stated_cameras[0]},
        boards={"": equipment.prints[0].board},
        sigma={},
    )
    return virtual, known


def changed(
    virtual: VirtualCell, change: str, size: float, q: Array, rng: np.random.Generator
) -> tuple[VirtualCell, Array, str]:
    """Return the cell after a change that moves the target by a size [m], rms over poses q; joint errors; the joint."""
    truth = virtual.truth
    error, joint = np.zeros(q.shape[1]), ""
    if change == "nothing":
        return virtual, error, joint
    before = truth.T_frame_base[0] @ truth.robot.poses(q) @ truth.T_tip_target[0]
    if change == "joint":
        k = int(rng.integers(q.shape[1]))
        joint = truth.nominal.joint_names[k]
        error[k] = 1e-4
        after = truth.T_frame_base[0] @ truth.robot.poses(q + error) @ truth.T_tip_target[0]
        moved = np.sqrt(np.mean(np.sum((after - before)[:, :3, 3] ** 2, axis=1)))
        return virtual, error * size / moved * rng.choice([-1.0, 1.0]), joint
    twist = rng.standard_normal(6)
    twist[3:] /= LEVER
    if change == "target":
        twist *= size / np.linalg.norm(twist[:3])
        T = truth.T_tip_target @ pin.exp6(twist).homogeneous
        return replace(virtual, truth=replace(truth, T_tip_target=T)), error, joint
    D = pin.exp6(1e-5 * twist).homogeneous
    after = truth.T_frame_base[0] @ D @ truth.robot.poses(q) @ truth.T_tip_target[0]
    moved = np.sqrt(np.mean(np.sum((after - before)[:, :3, 3] ** 2, axis=1)))
    T = truth.T_frame_base @ pin.exp6(1e-5 * twist * size / moved).homogeneous
    return replace(virtual, truth=replace(truth, T_frame_base=T)), error, joint


def measured(virtual: VirtualCell, q: Array, error: Array, seed: int) -> Measurements:
    """Measure at joint values q that are off by an error, and are read without it."""
    table = virtual.measure(q + error, seed).measurements
    return replace(table, joints=table.joints - error)


def run_once(case: Case, seed: int) -> list[Outcome]:
    """Calibrate a robot that is drawn, and check it many times."""
    virtual, known = drawn_cell(case, seed)
    table = virtual.measure(virtual.poses(POSES, seed), seed).measurements
    result = calibrate(virtual.truth.nominal, table, cell=known, model="dh")
    stored = StoredResult.of(result)
    poses = check_poses(result, 3, seed=seed).joints
    candidates = candidates_of(stored, Cell(), seed)
    everywhere = virtual.poses(30, seed + 1)
    noise = float(np.hypot(NOISE, REPEATABILITY))
    board = stored.part.board
    if board is not None:
        noise = float(np.hypot(board.across_alone, board.depth_alone) / np.sqrt(3.0))
    outcomes = []
    test = None
    for n, change in enumerate(CHANGES):
        for k in range(case.checks):
            rng = np.random.default_rng([seed, n, k])
            size = float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))
            after, error, joint = changed(virtual, change, size * noise, everywhere, rng)
            rows = measured(after, poses, error, 1000 * n + k + 1)
            checked = judged(stored, fresh_stops(stored, rows, Cell()), test=test)
            test = checked.test
            outcome = _outcome(checked, change, joint, size)
            if checked.outcome == "undecided":
                further = further_poses(checked, seed=k, candidates=candidates)
                driven = np.concatenate([poses, further.joints])
                again = fresh_stops(
                    stored, measured(after, driven, error, 1000 * n + k + 1), Cell()
                )
                second = judged(stored, again, test=test)  # the alarm was raised already
                decided = second.outcome != "undecided"
                right = _outcome(second, change, joint, size).strict
                outcome = replace(
                    outcome, asked=True, decided=decided, rightly=right, poses=len(further.joints)
                )
            outcomes.append(outcome)
    return outcomes


def _outcome(c: CheckResult, change: str, joint: str, size: float) -> Outcome:
    """Compare what a check says with what happened."""
    alarm = c.outcome != "nothing"
    true = [(f.code, f.name) == (change, joint) for f in c.named]
    first = bool(true) and true[0]
    return Outcome(
        change=change,
        size=size,
        alarm=alarm,
        strict=not alarm if change == "nothing" else c.outcome == "moved" and first,
        honest=not alarm if change == "nothing" else any(true),
        first=not alarm if change == "nothing" else first,
        asked=False,
        decided=False,
        rightly=False,
        poses=0,
    )


def case_rows(case: Case, runs: Sequence[list[Outcome]]) -> list[list[str]]:
    """Return the rows of a case, one for each change and one for those that moved."""
    outcomes = [outcome for run in runs for outcome in run]
    rows = []
    for change in (*CHANGES, "any change"):
        chosen = [
            o
            for o in outcomes
            if change in (o.change, "any change")
            and (change != "any change" or o.change != "nothing")
        ]
        asked = [o for o in chosen if o.asked]
        shares = [
            np.mean([getattr(o, name) for o in chosen])
            for name in ("alarm", "strict", "first", "honest")
        ]
        told = np.mean([o.strict or o.rightly for o in chosen])
        row = [f"{case.name}, {case.instrument}", change, str(len(chosen))]
        row += [f"{100 * share:.1f} %" for share in shares]
        row += [
            str(len(asked)),
            f"{np.mean([o.poses for o in asked]):.1f}" if asked else "-",
            f"{100 * told:.1f} %",
        ]
        rows.append(row)
    return rows


def main() -> None:
    """Print a row for each change of each case."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("calibrations", type=int, nargs="?", default=10, metavar="CALIBRATIONS")
    parser.add_argument("checks", type=int, nargs="?", default=20, metavar="CHECKS")
    parser.add_argument("seed", type=int, nargs="?", default=0, metavar="SEED")
    parser.add_argument("--only", default="", help="cases whose name contains this")
    arguments = parser.parse_args()
    kinds = [("ur3", "points"), ("ur10e", "points"), ("panda", "points")]
    kinds += [("ur3", "camera in the hand"), ("ur3", "camera fixed")]
    cases = [Case(*kind, arguments.checks) for kind in kinds if arguments.only in ", ".join(kind)]
    seeds = range(arguments.seed, arguments.seed + arguments.calibrations)
    titles = ["cell", "changed", "checks", "alarm", "sure and right", "most probable", "named"]
    titles += ["asked for more", "poses", "right after these"]
    rows = []
    for case, runs in run_cases(run_once, cases, seeds, workers=arguments.workers, label="cells"):
        rows += case_rows(case, runs)
        print_table(titles, case_rows(case, runs), [24, 10])
    if len(cases) > 1:
        print_table(titles, rows, [24, 10])


if __name__ == "__main__":
    main()
