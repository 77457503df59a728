"""Sessions with a virtual operator: are they enough when they say so, and is a mistake named at its row?

    python scripts/session_study.py run --count 100 --out sessions.jsonl [--mistakes]
    python scripts/session_study.py table sessions.jsonl

A cell is drawn: a robot with errors, a tracker or a camera with its noise, where things stand. The best possible error
is that below which 95 % of calibrations by the best plan of 40 poses are, by forecast; the aim is 1.3 times that. The
session proposes poses, the operator measures them, and the session says when it is enough. Then the corrected robot is
compared with the true one, at poses all over the joint ranges.

Beside it stand the number of poses that the best plan takes for the same aim, by forecast, and the number that poses at
random take, by fits of measurements that are simulated. A session is early if the true error is above the aim, and late
by the poses after the one with which the aim was met, by the forecast of the session's own poses with the true noise.

With --mistakes the operator makes some, at one reading in six. One is named at its row if the session asks to measure
again, or finds the mistake that it is. Early ones cannot be told: what is expected is not known well enough yet. A
mistake of points or poses can be told if a test that knows the noise and the size of the robot's errors, and that all
readings before are right, would notice it with a probability of 95 %, with one false alarm in a thousand.

Files are resumed: sessions that are there are not run again.
"""

from __future__ import annotations

import json
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, ncx2
from studies import print_table, process_pool, show_progress, study_parser

from calib.basics.arrays import Array
from calib.basics.jobs import run
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError
from calib.model.kinematics import Samples
from calib.numerics.errors import rms
from calib.result.table_fits import fit_table
from calib.robot.robot import Robot
from calib.verbs.measure.aim import Aim
from calib.verbs.measure.session import Session
from calib.verbs.measure.stop import Finding
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.forecast import Forecast, Workspace
from calib.verbs.plan.plan import plan
from calib.verbs.plan.sensitivity import Sensitivity
from calib.verbs.simulate.equipment import usual_board
from calib.verbs.simulate.operator import (
    BASE_MOVED,
    GROSS,
    MISSED,
    MISTAKES,
    NO_MISTAKES,
    NOT_THERE,
    REPEATED,
    SWAPPED,
    TARGET_MOVED,
    USUAL_MISTAKES,
    Measurement,
    Operator,
)
from calib.verbs.simulate.scenario import Scenario, VirtualCell
from calib.verbs.simulate.virtual_session import (
    everywhere as poses_everywhere,
    known_cell,
    measure_with,
    true_error,
)

#: Base and tip of each arm.
LINKS = {
    "ur3": ("base", "tool0"),
    "ur10e": ("base", "tool0"),
    "panda": ("panda_link0", "panda_link8"),
}

#: Kind of measurement by its word.
KINDS = {"points": "point", "poses": "pose", "pixels": "pixel"}

#: Noise of a coordinate [m], as that of a usual tracker at 3 m with a robot's repeatability; of an orientation about
#: each axis [rad]; of an image coordinate [px].
LENGTH, ANGLE, PIXEL = 4e-5, float(np.radians(0.01)), 0.3

#: A board on a plate of aluminium: scale, a corner's place and sag [m]. A print on paper would be all that counts.
SCALE, CORNER, SAG = 2e-5, 2e-5, 1e-4

#: Poses of the best possible plan, and the aim in its errors.
BEST, AIM = 40, 1.3

#: Candidates of a plan: a fifth of the usual ones, for errors that are one hundredth larger.
CANDIDATES = 4000

#: Calibrations by poses at random of each number that is tried, with a camera and without one; the largest number.
TRIALS, MOST_RANDOM = {True: 8, False: 16}, 400

#: Share of a number of poses at random to which it is looked for.
GRAIN = 0.04

#: The most stops of a session.
MOST_STOPS = 80

#: A mistake can be told if it is noticed with this probability, with so many false alarms.
POWER, ALARM = 0.95, 1e-3

#: A session is late if it goes on for so many poses.
LATE = 3

#: What a session may say of each mistake.
NAMES = {
    GROSS: {GROSS, NOT_THERE},
    SWAPPED: {SWAPPED, NOT_THERE},
    REPEATED: {REPEATED, NOT_THERE},
    MISSED: {REPEATED, NOT_THERE, SWAPPED},
    TARGET_MOVED: {TARGET_MOVED, "something_moved"},
    BASE_MOVED: {BASE_MOVED, "something_moved"},
    NOT_THERE: {NOT_THERE, GROSS},
}


@dataclass(frozen=True)
class Case:
    """One session: what is drawn."""

    robot: str
    kind: str
    seed: int
    mistakes: bool
    model: str
    stated: bool  # The session is told the noise of a coordinate; else it assumes the usual one

    @property
    def key(self) -> str:
        """Name of the session in a file."""
        return json.dumps(asdict(self), sort_keys=True)


@dataclass(frozen=True, eq=False)
class Setting:
    """A virtual cell, what is known of it, and the yardsticks of its errors."""

    virtual: VirtualCell
    #: Draws other robots, cameras and prints, with all of it where it stands.
    scenario: Scenario
    known: Cell
    #: Shape (N, m), poses over which the true error counts.
    everywhere: Array
    sensitivity: Sensitivity
    workspace: Workspace

    @property
    def robot(self) -> Robot:
        """The nominal robot."""
        return self.virtual.truth.nominal

    @property
    def least(self) -> int:
        """Fewest poses that tell all parameters."""
        scalars = 3 if self.virtual.scenario.kind.name == "point" else 6
        return len(self.sensitivity.names) // scalars + 2

    def plan(self, count: int) -> Forecast:
        """Forecast the best plan of so many poses."""
        request = PlanRequest(count, 0, ladder=False, candidates=self._candidates)
        return plan(self.robot, self.known, request, collisions=None).forecast

    @property
    def _candidates(self) -> int | None:
        """Number of candidates of a plan; None: as many as usual, which are few with a camera."""
        return None if self.virtual.equipment is not None else CANDIDATES

    def limit(self, q: Array) -> float:
        """Forecast the error below which 95 % of calibrations by poses (N, m) are, with the true noise [m]."""
        return Forecast.of(self.sensitivity, self.workspace, q).rms_high

    def power(self, measurement: Measurement, known: Array) -> tuple[float | None, Array]:
        """Return the probability with which what is off in a reading can be noticed, and what is known after it.

        Args:
            measurement: The reading, of a position or a pose; of a picture the probability is None.
            known: Information of the right readings before it, and of the priors, shape (p, p).

        Returns:
            The probability, and the information, to which a reading adds that has no mistake of its own.
        """
        if self.virtual.equipment is not None:
            return None, known
        A = self.sensitivity.measured(measurement.joints[None])[0]
        (T,), rows = measurement.T_frame_target, measurement.readings
        off = (rows.points[0] - T[:3, 3]) / self.sensitivity.noise(measurement.joints[None])
        if rows.rotations is not None:
            turn = Rotation.from_matrix(rows.rotations[0] @ T[:3, :3].T).as_rotvec()
            off = np.concatenate([off, turn / ANGLE])
        S = np.eye(len(off)) + A @ np.linalg.solve(known, A.T)
        limit = chi2.isf(ALARM, len(off))
        power = float(ncx2.sf(limit, len(off), off @ np.linalg.solve(S, off)))
        mistakes = [one for one in measurement.mistakes if one.since == measurement.number]
        is_right = not mistakes and not any(one.code == MISSED for one in measurement.mistakes)
        return power, known + A.T @ A if is_right else known

    def random_forecast(self, count: int) -> float:
        """Forecast the error below which 95 % of calibrations by so many poses at random are [m]."""
        squares = [self.limit(self.virtual.poses(count, seed)) ** 2 for seed in range(5)]
        return float(np.sqrt(np.mean(squares)))

    def random_limit(self, count: int, seed: int) -> float:
        """Return the error below which 95 % of calibrations by so many poses at random are, by simulation [m].

        Each trial has a robot, noise and poses of its own. Simulated is the rms of the errors; by how much some are
        larger is that of the forecast, in which there is less chance.
        """
        errors, ratios = [], []
        for k in range(TRIALS[self.virtual.equipment is not None]):
            of_trial = 1_000_000 * (k + 1) + seed
            virtual = self.scenario.draw(of_trial)
            q = virtual.poses(count, of_trial)
            table = virtual.measure(q, of_trial).measurements
            fitted = fit_table(self.robot, table, self.known).geometry
            poses = fitted.kinematics.poses(fitted.estimate.x, Samples.at(self.everywhere))
            errors.append(true_error(virtual, self.everywhere, poses))
            forecast = Forecast.of(self.sensitivity, self.workspace, q)
            ratios.append(forecast.rms_high / forecast.rms)
        return rms(np.array(errors)) * float(np.mean(ratios))


def draw(case: Case) -> Setting:
    """Draw the cell of a session; of pictures every other camera is on the hand, the others beside the robot."""
    base, tip = LINKS[case.robot]
    kind = KINDS[case.kind]
    cell = Cell(kind=kind, estimate_frame=True, model=case.model)
    if case.stated and kind != "pixel":
        cell = replace(cell, sigma={"m": LENGTH})
    if kind == "pixel":
        if case.seed % 2:
            base, tip = tip, base
        board = replace(
            usual_board(Robot.load(case.robot, *LINKS[case.robot])),
            sigma_scale=SCALE,
            sigma_corner=CORNER,
            sigma_warp=SAG,
        )
        cell = replace(cell, boards={"": board}, sigma={"px": PIXEL})
    elif kind == "pose":
        cell = replace(cell, sigma={**cell.sigma, "rad": ANGLE})
    arm = Robot.load(case.robot, base, tip)
    errors = "placement" if case.model == "auto" else case.model
    virtual = Scenario(arm, cell, errors).draw(case.seed)
    known = known_cell(virtual, case.seed)
    sensitivity = Sensitivity.of(arm, known)
    everywhere = poses_everywhere(virtual)
    workspace = Workspace.of(sensitivity, everywhere)
    truth = virtual.truth
    placed = replace(known, estimate_frame=False, T_frame_base=truth.T_frame_base[0])
    if virtual.equipment is not None:
        T = truth.T_tip_target[0]
        placed = replace(placed, target=T[:3, 3], target_rotation=T[:3, :3])
    scenario = Scenario(arm, placed, errors)
    return Setting(virtual, scenario, known, everywhere, sensitivity, workspace)


def fewest(
    limit: Callable[[int], float],
    aim: float,
    least: int,
    most: int,
    guess: int,
    grain: float = 0.0,
) -> int:
    """Return the least number, from ``least`` to ``most``, whose limit is within an aim; ``most`` if none is.

    The search begins at a guess, in steps of a tenth of it, and ends when the number is known to a share ``grain``.
    """
    step = max(1, guess // 10)
    low, high = least - 1, most
    number = min(max(guess, least), most)
    while high - low > max(1.0, grain * high):
        if limit(number) <= aim:
            high, number = number, number - step
        else:
            low, number = number, number + step
        if not low < number < high:
            number = (low + high) // 2
    return high


def run_session(_: None, case: Case) -> dict[str, Any]:
    """Run a session, and return its figures in SI units; of one that fails the error, without a true error."""
    setting = draw(case)
    best = setting.plan(BEST).rms_high
    aim = AIM * best
    nominal = setting.virtual.truth.nominal_errors(setting.everywhere)
    figures = {**asdict(case), "best_m": best, "aim_m": aim, "nominal_m": rms(nominal)}
    if not case.mistakes:
        figures |= yardsticks(setting, aim, case.seed)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        try:
            figures |= measured(setting, case, aim, Path(folder) / "session", rows)
        except CalibError as error:
            figures |= {"failed": str(error), "true_m": None, "reached": False}
    return {**figures, "rows": rows}


def yardsticks(setting: Setting, aim: float, seed: int) -> dict[str, Any]:
    """Return how many poses the best plan, and poses at random, take for an aim [m]."""
    least = setting.least
    guess = round(BEST / AIM**2)
    planned = fewest(lambda n: setting.plan(n).rms_high, aim, least, 4 * BEST, guess)
    forecast = fewest(setting.random_forecast, aim, least, MOST_RANDOM, 3 * planned // 2, GRAIN)
    simulated = fewest(
        lambda n: setting.random_limit(n, seed), aim, least, MOST_RANDOM, forecast, GRAIN
    )
    return {"planned": planned, "random": simulated, "random_forecast": forecast}


def measured(
    setting: Setting, case: Case, aim: float, folder: Path, rows: list[dict[str, Any]]
) -> dict[str, Any]:
    """Measure a session with an aim [m] in a folder, calibrate, and return the figures; its readings go to ``rows``."""
    mistakes = USUAL_MISTAKES if case.mistakes else NO_MISTAKES
    operator = Operator.of(setting.virtual, case.seed, mistakes)
    began = time.perf_counter()
    session = Session.start(
        folder, setting.robot, setting.known, Aim(error=aim), collisions=False, seed=case.seed
    )
    with session:
        start = time.perf_counter() - began
        known = np.diag(setting.sensitivity.precision)
        for stop in measure_with(session, operator, MOST_STOPS):
            mistake = stop.measurement.mistake
            power, known = setting.power(stop.measurement, known)
            rows.append(
                {
                    "number": stop.measurement.number,
                    "stop": stop.answer.stop,
                    "outcome": stop.answer.outcome,
                    "found": found_table(stop.answer.findings),
                    "mistake": mistake and asdict(mistake),
                    "power": power,
                    "residual": dict(stop.answer.residual),
                    "usual": dict(stop.answer.usual),
                    "high_m": stop.high,
                    "next_seconds": stop.seconds[0],
                    "add_seconds": stop.seconds[1],
                }
            )
        state = session.state
        joints = joints_of_stops(session.measurements)
        began = time.perf_counter()
        result = session.calibrate()
        seconds = time.perf_counter() - began
    counts = range(setting.least, len(joints) + 1)
    needed = next((n for n in counts if setting.limit(joints[:n]) <= aim), len(joints))
    # What was knocked is displaced for the rows after it only, and the session says which of the two it calibrates.
    predicted = result.predict_poses(setting.everywhere, group=result.setup.groups[0])
    # Of what was knocked a calibration may have the place before or after it.
    first, last = setting.virtual, operator.now
    truths = [
        replace(first.truth, T_frame_base=of_base.T_frame_base, T_tip_target=of_target.T_tip_target)
        for of_base in (first.truth, last.truth)
        for of_target in (first.truth, last.truth)
    ]
    cells = [replace(first, truth=truth) for truth in truths]
    return {
        "true_m": min(true_error(cell, setting.everywhere, predicted) for cell in cells),
        "stated_m": state.error,
        "high_m": state.high,
        "reached": state.reached,
        "stops": state.stops,
        "needed": needed,
        "found": found_table(state.findings),
        "verdict": str(result.verdict.use) if result.verdict else "",
        "start_seconds": start,
        "calibrate_seconds": seconds,
    }


def found_table(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """Return findings as a file has them."""
    return [{"code": finding.code, "stops": list(finding.stops)} for finding in findings]


def joints_of_stops(table: Measurements) -> Array:
    """Return the joint values of each stop of a table, shape (N, m), [rad] or [m]."""
    is_other = np.any(np.diff(table.joints, axis=0) != 0.0, axis=1)
    return np.asarray(table.joints[np.append(True, is_other)])


def read_sessions(path: Path) -> list[dict[str, Any]]:
    """Return the sessions of a file; a last line that was cut off is left out."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    return [json.loads(line) for line in lines if line.endswith("\n")]


def run_all(options: Namespace) -> None:
    """Run the sessions that are not in the file yet, and add each as soon as it is there."""
    robots, kinds = options.robots.split(","), options.kinds.split(",")
    pairs = [(robot, kind) for kind in kinds for robot in robots]
    cases = []
    for k in range(options.count):
        robot, kind = pairs[k % len(pairs)]
        seed = options.first + k
        cases.append(Case(robot, kind, seed, options.mistakes, options.model, not options.assumed))
    done = read_sessions(options.out)
    write_lines(options.out, done)
    known = {of_session(session).key for session in done}
    left = [case for case in cases if case.key not in known]
    pool = process_pool(options.workers) if options.workers > 1 else None
    runs = run(run_session, None, left, pool)
    with options.out.open("a", encoding="utf-8") as file:
        for _, session in show_progress(runs, "sessions", len(left)):
            file.write(json.dumps(session) + "\n")
            file.flush()
    if pool is not None:
        pool.shutdown()


def of_session(session: Mapping[str, Any]) -> Case:
    """Return the case that a session of a file is of."""
    return Case(**{name: session[name] for name in Case.__dataclass_fields__})


def write_lines(path: Path, sessions: Sequence[Mapping[str, Any]]) -> None:
    """Write a file anew without a line that was cut off, for more to be added."""
    path.write_text("".join(json.dumps(session) + "\n" for session in sessions), encoding="utf-8")


# Tables


def accuracy_rows(sessions: Sequence[dict[str, Any]]) -> Iterator[list[object]]:
    """Yield whether sessions met their aim, and with how many poses, by arm and kind, and all together.

    One that failed did not meet it. Yardsticks that were not looked for, as with mistakes, are dashes.
    """
    for name, group in groups_of(sessions):

        def values(key: str, group: Sequence[Mapping[str, Any]] = group) -> Array:
            """Return a figure of each session, NaN where it has none."""
            return np.array([session.get(key) for session in group], dtype=np.float64)

        error = values("true_m") / values("aim_m")
        error[np.isnan(error)] = np.inf
        stops = values("stops")
        rows = [row for session in group for row in session["rows"]]
        yield [
            name,
            len(group),
            f"{1e3 * np.median(values('nominal_m')):.2f}",
            f"{1e3 * np.median(values('aim_m')):.3f}",
            share(error <= 1.0),
            f"{np.median(error):.2f}, {np.quantile(error, 0.95, method='higher'):.2f}",
            mean_of(stops, 1),
            mean_of(stops / values("random")),
            mean_of(stops / values("planned")),
            mean_of(stops / values("needed")),
            share(stops - values("needed") > LATE),
            share(not session["reached"] for session in group),
            worst_of([row["add_seconds"] for row in rows]),
            worst_of([row["next_seconds"] for row in rows]),
        ]


def mean_of(values: Array, digits: int = 2) -> str:
    """Format the mean of the values that are there; a dash if there are none."""
    there = values[np.isfinite(values)]
    return f"{np.mean(there):.{digits}f}" if len(there) else "-"


def worst_of(values: Sequence[float]) -> str:
    """Format the median and the largest of values; a dash if there are none."""
    return f"{np.median(values):.2f}, {max(values):.2f}" if values else "-"


def mistake_rows(sessions: Sequence[dict[str, Any]]) -> Iterator[list[object]]:
    """Yield how many mistakes of each sort were named, and how many false alarms there were."""
    judged = [judgement for session in sessions for judgement in judgements(session)]
    wrong = [one for one in judged if one.code]
    groups = [(code, [one for one in wrong if one.code == code]) for code in MISTAKES]
    for name, group in [*groups, ("all", wrong)]:
        if group:
            yield [
                name,
                len(group),
                share(one.named for one in group),
                share(one.right for one in group),
                share(one.ever for one in group),
                sum(one.told for one in group),
                share(one.named for one in group if one.told),
            ]
    fine = [one for one in judged if not one.code]
    yield ["none (false alarms)", len(fine), share(one.named for one in fine), "", "", "", ""]


@dataclass(frozen=True)
class Judgement:
    """What a session said at one reading."""

    code: str  # Of the mistake made there; empty: none
    named: (
        bool  # It asked for the reading again, or found the mistake; without one: it said anything
    )
    right: bool  # It found the mistake that it is
    ever: bool  # It was named there, or found later
    told: bool = False  # It can be told


def judgements(session: Mapping[str, Any]) -> Iterator[Judgement]:
    """Yield what a session said at each reading; those after something was knocked, or a stop missed, are left out."""
    for k, row in enumerate(session["rows"]):
        mistake = row["mistake"]
        found = {finding["code"] for finding in row["found"] if row["stop"] in finding["stops"]}
        code = mistake["code"] if mistake else ""
        is_knock = code in (TARGET_MOVED, BASE_MOVED)
        if (is_knock or code == MISSED) and mistake["since"] < row["number"]:
            continue  # that was before
        if not code:
            alarm = row["outcome"] == "again" or bool(found)
            yield Judgement("", alarm, right=False, ever=alarm)
            continue
        right = bool(found & NAMES[code])
        named = right or row["outcome"] == "again"
        later = [finding for after in session["rows"][k + 1 :] for finding in after["found"]]
        later += session.get("found", [])
        ever = named or any(
            finding["code"] in NAMES[code] and (is_knock or row["stop"] in finding["stops"])
            for finding in later
        )
        yield Judgement(code, named, right, ever, (row["power"] or 0.0) >= POWER)


def share(flags: Iterable[Any]) -> str:
    """Word the share of True among flags."""
    listed = list(flags)
    return f"{100 * sum(listed) / len(listed):.1f} %" if listed else ""


def groups_of(
    sessions: Sequence[dict[str, Any]],
) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Yield the sessions of each arm and kind, and all of them, with a name."""
    pairs = dict.fromkeys((session["robot"], session["kind"]) for session in sessions)
    for robot, kind in sorted(pairs, key=lambda pair: (pair[1], pair[0])):
        group = [one for one in sessions if (one["robot"], one["kind"]) == (robot, kind)]
        yield f"{robot}, {kind}", group
    yield "all", list(sessions)


def print_tables(path: Path) -> None:
    """Print the tables of a file of sessions."""
    sessions = read_sessions(path)
    print_table(
        (
            "sessions",
            "number",
            "nominal [mm]",
            "aim [mm]",
            "aim met",
            "error over aim: median, 95 %",
            "poses",
            "over random",
            "over planned",
            "over needed",
            f"late by more than {LATE}",
            "not reached",
            "add [s]: median, most",
            "next [s]: median, most",
        ),
        accuracy_rows(sessions),
    )
    if any(session["mistakes"] for session in sessions):
        print()
        print_table(
            (
                "mistake",
                "readings",
                "named at its row",
                "by its name",
                "there or later",
                "can be told",
                "of these named at its row",
            ),
            mistake_rows(sessions),
        )


def main() -> None:
    """Run sessions, or print their tables."""
    parser = study_parser(__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    runs = verbs.add_parser("run", help="run sessions")
    runs.add_argument("--robots", default=",".join(LINKS), help="arms, with commas between them")
    runs.add_argument("--kinds", default=",".join(KINDS), help="points, poses, pixels")
    runs.add_argument("--count", type=int, default=100, help="number of sessions, of all together")
    runs.add_argument("--first", type=int, default=0, metavar="SEED", help="seed of the first one")
    runs.add_argument("--mistakes", action="store_true", help="the operator makes some")
    runs.add_argument("--model", default="placement", help="of the fit and of the robot's errors")
    runs.add_argument("--assumed", action="store_true", help="the session is not told the noise")
    runs.add_argument("--out", type=Path, required=True, help="file, one line a session")
    runs.add_argument("--workers", type=int, default=1, help="number of processes")
    tables = verbs.add_parser("table", help="print the tables")
    tables.add_argument("file", type=Path)
    options = parser.parse_args()
    if options.verb == "run":
        run_all(options)
        print_tables(options.out)
    else:
        print_tables(options.file)


if __name__ == "__main__":
    main()
