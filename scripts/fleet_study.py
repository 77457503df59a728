"""A fleet over time, with planted faults: the figures of docs/fleet.md.

    python scripts/fleet_study.py --robots 100 --dates 5
    python scripts/fleet_study.py --scatter 200

UR3s whose joint zeros err by 1.5 mrad and whose link lengths err by 0.2 mm are measured once a month by a tracker of
0.05 mm noise a coordinate, 24 poses each time, and calibrated by `calib.fleet`. Some drift in one joint, one has a
step, one is 12 mrad off in one joint, and files are damaged, copied, changed and without a serial number. Then
`calib.history`, `calib.trend` and the fleet's outliers have to find these and nothing else. The true robot is
Pinocchio's model with other placements of its joints: no error model of calib makes it. With `--scatter`, fleets of
figures alone say how often a joint that is 12 mrad off is found, by how much the zeros scatter.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from studies import print_table, study_parser

import calib
from calib.basics.arrays import Array
from calib.basics.dates import MONTH
from calib.basics.jobs import core_count
from calib.data.record import Record
from calib.example import PAPER_TARGET, paper_urdf
from calib.verbs.compare.joint_trend import Trend
from calib.verbs.fleet.fleet_row import DONE, FleetParameter, FleetRow
from calib.verbs.fleet.outliers import fleet_outliers
from calib.verbs.history.found_files import What

#: Standard deviations of the robots' errors: of joint zeros [rad], of link lengths along each axis [m].
ZERO, LENGTH = 1.5e-3, 0.2e-3

#: The joints whose zeros are changed, by their numbers from 0.
JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint")

#: Position of the target in the tip [m].
TARGET = np.array(PAPER_TARGET)

#: Noise of a coordinate [m].
NOISE = 5e-5

#: Poses of each measurement.
POSES = 24

#: Largest joint value of a pose [rad].
SPAN = 2.0


@dataclass(frozen=True)
class Planted:
    """What is wrong with one robot: a change of the zero of a joint, from 0."""

    joint: int
    #: [rad], from the first date on
    off: float = 0.0
    #: [rad] a month
    rate: float = 0.0
    #: [rad], from the date `at` on, counted from 0
    step: float = 0.0
    at: int = 0

    def zero(self, date: int) -> float:
        """Return the change of the zero at a date, one a month [rad]."""
        return self.off + self.rate * date + (self.step if date >= self.at else 0.0)


def planted(robots: int) -> dict[int, Planted]:
    """Return what is wrong with which robot, by its number from 0."""
    places = [int(share * robots) for share in (0.1, 0.3, 0.5, 0.7, 0.9)]
    faults = (
        Planted(1, rate=0.3e-3),
        Planted(2, rate=-0.2e-3),
        Planted(3, rate=0.4e-3),
        Planted(1, step=1.0e-3, at=3),
        Planted(2, off=12e-3),
    )
    return dict(zip(places, faults, strict=True))


def serial_of(robot: int) -> str:
    """Return the serial number of a robot, which is the name of its folder."""
    return f"SN-{robot + 1:03}"


def date_of(date: int) -> str:
    """Return a date, the tenth of each month of 2026."""
    return f"2026-{date + 1:02}-10"


def measured(robot: int, date: int, fault: Planted | None) -> calib.Measurements:
    """Measure a robot at a date, by Pinocchio."""
    model = pin.buildModelFromUrdf(str(paper_urdf()))
    of_robot = np.random.default_rng([2026, robot])
    zeros = ZERO * of_robot.normal(size=6)
    for k in range(
        2, model.njoints
    ):  # where the first joint stands in the base is for no DH row to say
        model.jointPlacements[k].translation += LENGTH * of_robot.normal(size=3)
    if fault is not None:
        zeros[fault.joint] += fault.zero(date)
    rng = np.random.default_rng([47, robot, date])
    q = rng.uniform(-SPAN, SPAN, (POSES, 6))
    data = model.createData()
    base, tip = model.getFrameId("base"), model.getFrameId("tool0")
    points = []
    for values in q:
        pin.framesForwardKinematics(model, data, values + zeros)
        T_base_tip = data.oMf[base].inverse() * data.oMf[tip]
        points.append(T_base_tip.act(TARGET))
    names = tuple(name for name in model.names if name != "universe")
    noisy: Array = np.array(points) + NOISE * rng.normal(size=(POSES, 3))
    return calib.Measurements(names, q, noisy)


def make_fleet(folder: Path, robots: int, dates: int, executor: Executor | None) -> list[Any]:
    """Calibrate the fleet at each date into a folder of the date, and return what `calib.fleet` found each time."""
    faults = planted(robots)
    fleets = []
    for date in range(dates):
        tables, cells = {}, {}
        for robot in range(robots):
            serial = serial_of(robot)
            tables[serial] = measured(robot, date, faults.get(robot))
            record = Record(robot_serial=serial, date=date_of(date))
            cells[serial] = calib.Cell(
                base="base", tip="tool0", target=TARGET, model="dh", record=record
            )
        fleets.append(
            calib.fleet(
                paper_urdf(),
                tables,
                folder / date_of(date),
                cell=cells,
                executor=executor,
                reports=False,
            )
        )
    return fleets


def spoil(folder: Path, robots: int, dates: int) -> dict[What, set[str]]:
    """Damage, copy and change files of some robots, and return which files have to be noted."""
    first, last = date_of(0), date_of(dates - 1)
    damaged = f"{date_of(1)}/{serial_of(0)}/result.json"
    content = (folder / damaged).read_bytes()
    (folder / damaged).write_bytes(content[: len(content) // 2])
    copy = f"{last}/copy-of-{serial_of(1)}.json"
    shutil.copy(folder / last / serial_of(1) / "result.json", folder / copy)
    changed = f"{last}/{serial_of(2)}/corrected.urdf"
    text = (folder / changed).read_text(encoding="utf-8")
    (folder / changed).write_text(text.replace("<origin ", "<origin  ", 1), encoding="utf-8")
    nameless = f"{first}/nameless.json"
    source = folder / first / serial_of(min(3, robots - 1)) / "result.json"
    result = calib.Calibration.read_json(source)
    replace(result, record=Record(date=first)).write_json(folder / nameless)
    edited = f"{first}/edited.json"
    table = json.loads(source.read_bytes())
    table["record"]["robot_serial"] = serial_of(0)
    (folder / edited).write_text(json.dumps(table), encoding="utf-8")
    return {
        What.DAMAGED: {damaged, edited},
        What.COPY: {copy},
        What.CHANGED_URDF: {changed},
        What.NO_SERIAL: {nameless},
    }


def check_history(folder: Path, robots: int, dates: int, noted: Mapping[What, set[str]]) -> float:
    """Check the history of the folder, restore each URDF of a robot, and return how long the history took [s]."""
    begun = time.perf_counter()
    history = calib.history(folder)
    seconds = time.perf_counter() - begun
    assert list(history.robots) == [serial_of(robot) for robot in range(robots)]
    for serial, entries in history.robots.items():
        expected = [date_of(date) for date in range(dates)]
        if serial == serial_of(0):
            expected.remove(date_of(1))
        found = [f"{entry.result.date:%Y-%m-%d}" for entry in entries]
        assert found == expected, (serial, found)
        for entry, later in pairwise(entries):
            assert entry.end == "replaced"
            assert entry.until == later.result.date
        assert entries[-1].is_valid, serial
    for what, files in noted.items():
        found_files = {note.paths[0] for note in history.notes if note.what is what}
        assert found_files == files, (what, found_files)
    shared = {What.SHARED_RUN}  # the nameless copy of a result
    assert {note.what for note in history.notes} == {*noted, *shared}
    for date in range(dates):
        serial = serial_of(robots - 1)
        again = folder / "again.urdf"
        history.restore(serial, date_of(date), again, overwrite=True)
        assert (
            again.read_bytes() == (folder / date_of(date) / serial / "corrected.urdf").read_bytes()
        )
        again.unlink()
    return seconds


def check_outliers(fleets: Sequence[Any], robots: int) -> list[str]:
    """Check that the robot that is off is flagged at each date, and return which others are."""
    off = next(serial_of(robot) for robot, fault in planted(robots).items() if fault.off)
    others = []
    for fleet in fleets:
        figures = [(outlier.name, outlier.figure) for outlier in fleet.outliers]
        assert (off, "zero of elbow_joint") in figures, figures
        others += [f"{name}: {figure}" for name, figure in figures if name != off]
    return others


def found_trends(paths: Sequence[Path]) -> dict[str, Trend]:
    """Return by joint what its zero does in the results of a robot, if it is not steady."""
    trend = calib.trend(paths)
    return {joint.joint: joint.trend for joint in trend.changed if joint.trend is not None}


def check_trends(
    history: calib.History, robots: int, dates: int, executor: Executor | None
) -> tuple[list[list[str]], list[str]]:
    """Check that planted drifts and steps are found, at the planted rate and height, on the planted joint.

    Returns:
        A row of each planted fault: robot, joint, planted and found; and the other robots that are not steady.
    """
    numbers = range(robots)
    paths = [
        [history.folder / entry.result.path for entry in history.of(serial_of(robot))]
        for robot in numbers
    ]
    run = map if executor is None else executor.map
    found = list(run(found_trends, paths))
    faults = planted(robots)
    rows, others = [], []
    for robot, trends in zip(numbers, found, strict=True):
        fault = faults.get(robot)
        joint = JOINTS[fault.joint] if fault is not None and not fault.off else ""
        others += [
            f"{serial_of(robot)}: {name} {t.shape}" for name, t in trends.items() if name != joint
        ]
        if fault is None or not joint:
            continue
        trend = trends[joint]
        if fault.rate:
            days = np.array([date.toordinal() for date in map(_day, range(dates))])
            slope = np.polyfit(days, np.arange(dates), 1)[0] * MONTH / 86_400.0
            truth, value, std = fault.rate * slope, trend.rate, trend.rate_std
            assert trend.shape == "drift", (robot, trend)
            unit = "mrad a month"
        else:
            truth, value, std = fault.step, trend.step, trend.step_std
            assert (trend.shape, trend.step_at) == ("step", fault.at), (robot, trend)
            unit = "mrad"
        assert abs(value - truth) < 4.0 * std, (robot, truth, trend)
        words = f"{1e3 * value:+.3f} ± {1e3 * std:.3f} {unit}"
        rows.append(
            [serial_of(robot), f"{trend.shape} of {joint}", f"{1e3 * truth:+.3f} {unit}", words]
        )
    return rows, others


def _day(date: int) -> datetime:
    """Return a date as a day."""
    return datetime.fromisoformat(date_of(date))


def found_share(robots: int, scatter: float, trials: int) -> float:
    """Return the share of fleets in which a joint that is 12 mrad off is found, by the scatter of the zeros [rad]."""
    found = 0
    for trial in range(trials):
        zeros = np.random.default_rng([robots, trial]).normal(
            0.0, scatter, (robots, len(JOINTS) + 2)
        )
        zeros[0, 2] += 12e-3
        rows = [
            FleetRow(
                serial_of(robot),
                DONE,
                measured=str(robot),
                zeros=tuple(
                    FleetParameter(f"zero of joint {j}", "rad", float(x), 0.5e-3)
                    for j, x in enumerate(of_robot)
                ),
            )
            for robot, of_robot in enumerate(zeros)
        ]
        outliers, _ = fleet_outliers(rows)
        found += any((o.name, o.figure) == (serial_of(0), "zero of joint 2") for o in outliers)
    return found / trials


def main() -> None:
    """Make the fleet, check what is found in it, and print the figures."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--dates", type=int, default=5)
    parser.add_argument("--scatter", type=int, metavar="TRIALS", default=0)
    arguments = parser.parse_args()
    if arguments.scatter:
        scatters = (1e-3, 1.5e-3, 2e-3, 2.5e-3, 3e-3, 4e-3)
        shares = (
            [f"{robots} robots"]
            + [f"{found_share(robots, std, arguments.scatter):.0%}" for std in scatters]
            for robots in (10, 20, 50)
        )
        print_table(("scatter of the zeros", *(f"{1e3 * std:g} mrad" for std in scatters)), shares)
        return
    workers = arguments.workers or core_count()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        begun = time.perf_counter()
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as executor:
            fleets = make_fleet(folder, arguments.robots, arguments.dates, executor)
            made = time.perf_counter() - begun
            noted = spoil(folder, arguments.robots, arguments.dates)
            seconds = check_history(folder, arguments.robots, arguments.dates, noted)
            begun = time.perf_counter()
            history = calib.history(folder)
            rows, unsteady = check_trends(history, arguments.robots, arguments.dates, executor)
            followed = time.perf_counter() - begun
        others = check_outliers(fleets, arguments.robots)
    results = arguments.robots * arguments.dates
    print_table(
        ("figure", "value"),
        [
            [f"{results} calibrations", f"{made:.0f} s"],
            [f"history of {results} results", f"{seconds:.1f} s"],
            [f"trends of {arguments.robots} robots", f"{followed:.0f} s"],
            ["others that are not steady", ", ".join(unsteady) or "none"],
            ["robots flagged besides the one that is off", ", ".join(others) or "none"],
        ],
    )
    print()
    print_table(("robot", "planted and found", "planted", "found"), rows)


if __name__ == "__main__":
    main()
