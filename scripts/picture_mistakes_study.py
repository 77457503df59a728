"""Mistakes of pictures: exchanged, shifted, turned, from a camera that was bumped or refocused, or with late joints.

    python scripts/picture_mistakes_study.py --runs 20 --first 1000
    python scripts/picture_mistakes_study.py --runs 24 --first 500 --quick
    python scripts/picture_mistakes_study.py --only bumped,refocused --workers 2

Virtual cells: arms with typical errors, a camera on the hand or beside the robot, a print of 7 x 5 squares, 25 to 40
pictures, noise of 0.3 px. In each table one mistake is made, of a size that is drawn. Printed are how many of the
verdicts name the mistake as their first reason, how many of the untouched tables have such a reason, and the longest
time of a calibration. With ``--quick`` only what precedes the fits is run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from camera_study import ARMS, STATED, draw
from cell_truth import joined as rows_below_each_other
from scipy.spatial.transform import Rotation
from studies import draw_seed, run_jobs, study_parser

from calib.basics.arrays import Array, Integers, read_only
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError
from calib.result.calibrate import calibrate, without_mistakes_of_pictures
from calib.verbs.simulate.scenario import VirtualCell

#: Fewest and most pictures of a table.
PICTURES = (25, 40)

#: Arms besides those of the study of cameras: links of camera and board.
FURTHER = (
    ("ur10", "tool0", "base_link"),
    ("iiwa14", "iiwa_link_0", "iiwa_link_ee"),
    ("ur3", "base_link", "tool0"),
)

#: Least and largest size of a bump of the camera [m] and [rad], of a change of the focal length as a share, and of the
#: share of the last move by which joint values are late.
BUMP = (2e-3, 3e-2)
TURN = (2e-3, 5e-2)
FOCUS = (0.005, 0.06)
LAG = (0.01, 0.3)


@dataclass(frozen=True, slots=True)
class Drawn:
    """A virtual cell and the poses of its pictures."""

    #: The cell
    cell: VirtualCell
    #: shape (n, m), joint values [rad]
    q: Array
    #: Seed of the measurement
    seed: int
    #: Random numbers of the mistake
    random: np.random.Generator

    def table(self, cell: VirtualCell | None = None) -> Measurements:
        """Return the table of corners of the cell, or of one that was changed."""
        return (cell or self.cell).measure(self.q, self.seed).measurements

    def place(self) -> int:
        """Draw the picture from which on something changed, from 0."""
        return int(self.random.integers(len(self.q) // 5, len(self.q) - len(self.q) // 5))


def of_pictures(table: Measurements) -> Integers:
    """Return the number of each row's picture in their order, shape (N,)."""
    first = dict.fromkeys(table.images)
    number = {name: k for k, name in enumerate(first)}
    return np.array([number[name] for name in table.images])


def with_joints_of(table: Measurements, pictures: Integers) -> Measurements:
    """Return a table in which each picture k has the joint values of the picture ``pictures[k]``, (n,)."""
    number = of_pictures(table)
    first = np.array([int(np.argmax(number == k)) for k in range(number.max() + 1)])
    return replace(table, joints=table.joints[first[pictures]][number], moves=None)


def untouched(drawn: Drawn) -> Measurements:
    """No mistake."""
    return drawn.table()


def exchanged(drawn: Drawn) -> Measurements:
    """Two pictures are exchanged."""
    table = drawn.table()
    count = int(of_pictures(table).max()) + 1
    order = np.arange(count)
    i, j = drawn.random.choice(count, 2, replace=False)
    order[[i, j]] = order[[j, i]]
    return with_joints_of(table, order)


def shifted(drawn: Drawn) -> Measurements:
    """From some picture on, each has the joint values of the one before; or all have."""
    table = drawn.table()
    order = np.arange(int(of_pictures(table).max()) + 1)
    k = 1 if drawn.random.uniform() < 0.5 else drawn.place()
    order[k:] -= 1
    return with_joints_of(table, order)


def between(random: np.random.Generator, sizes: tuple[float, float]) -> float:
    """Draw a size, evenly on a logarithmic scale."""
    return float(np.exp(random.uniform(*np.log(sizes))))


def joined(before: Measurements, after: Measurements, k: int) -> Measurements:
    """Return a table with the pictures before the k-th of one table, and the others of another."""
    a, b = before.select(of_pictures(before) < k), after.select(of_pictures(after) >= k)
    return rows_below_each_other([a, b])


def bumped(drawn: Drawn) -> Measurements:
    """From some picture on the camera stands elsewhere."""
    random, truth = drawn.random, drawn.cell.truth
    axes = random.standard_normal((2, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    bump = np.eye(4)
    bump[:3, :3] = Rotation.from_rotvec(between(random, TURN) * axes[0]).as_matrix()
    bump[:3, 3] = between(random, BUMP) * axes[1]
    elsewhere = replace(truth, T_frame_base=read_only(bump @ truth.T_frame_base))
    return joined(drawn.table(), drawn.table(replace(drawn.cell, truth=elsewhere)), drawn.place())


def refocused(drawn: Drawn) -> Measurements:
    """From some picture on the focal lengths are others, and the centre of the lens."""
    random, equipment = drawn.random, drawn.cell.equipment
    assert equipment is not None
    assert equipment.camera.values is not None
    values = equipment.camera.values.copy()
    values[:2] *= 1.0 + between(random, FOCUS) * random.choice([-1.0, 1.0])
    values[2:4] += random.normal(0.0, 2.0, 2)
    other = replace(equipment, cameras=(replace(equipment.camera, values=read_only(values)),))
    return joined(drawn.table(), drawn.table(replace(drawn.cell, equipment=other)), drawn.place())


def turned(drawn: Drawn) -> Measurements:
    """One to three pictures are turned by half a turn."""
    table = drawn.table()
    number = of_pictures(table)
    some = drawn.random.choice(number.max() + 1, drawn.random.integers(1, 4), replace=False)
    chosen = np.isin(number, some)
    size = {"u": STATED.width - 1.0, "v": STATED.height - 1.0}
    readings = {
        name: np.where(chosen, size[name] - values, values)
        for name, values in table.readings.items()
    }
    return replace(table, readings=readings)


def late(drawn: Drawn) -> Measurements:
    """Joint values miss a share of the last move."""
    table = drawn.table()
    number = of_pictures(table)
    first = np.array([int(np.argmax(number == k)) for k in range(number.max() + 1)])
    q = table.joints[first]
    q = q - between(drawn.random, LAG) * np.diff(q, axis=0, prepend=q[:1])
    return replace(table, joints=q[number], moves=None)


#: Mistakes, each with the codes of the reasons that name it.
MISTAKES: Mapping[str, tuple[Callable[[Drawn], Measurements], tuple[str, ...]]] = {
    "untouched": (untouched, ()),
    "exchanged": (exchanged, ("pictures_exchanged",)),
    "shifted": (shifted, ("rows_shifted", "rows_moved")),
    "bumped": (bumped, ("camera_moved",)),
    "refocused": (refocused, ("camera_refocused",)),
    "turned": (turned, ("pictures_turned",)),
    "late": (late, ("joints_lag", "joints_late")),
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a calibration said of a table."""

    #: Arm and seed
    name: str
    #: The verdict, and the codes of its reasons
    use: str
    codes: tuple[str, ...]
    #: Time that it took [s]
    seconds: float


def run(mistake: str, seed: int, *, quick: bool = False) -> Outcome | None:
    """Calibrate a table with a mistake, or only look for it; None if a camera sees the board at too few poses."""
    arms = (*ARMS, *FURTHER)
    arm = arms[seed % len(arms)]
    random = np.random.default_rng([seed, *mistake.encode()])
    try:
        cell = draw(*arm, seed)
        q = cell.poses(int(random.integers(*PICTURES)), seed)
    except CalibError:
        return None
    assert cell.scenario.cell is not None
    change, _ = MISTAKES[mistake]
    table = change(Drawn(cell, q, draw_seed(random), random))
    camera = STATED if seed % 2 else Camera(width=STATED.width, height=STATED.height)
    known = Cell(cameras={"": camera}, boards=cell.scenario.cell.boards)
    began = time.perf_counter()
    try:
        if quick:
            _, found, wrong = without_mistakes_of_pictures(cell.truth.nominal, known, table)
            codes = tuple(reason.code for reason in (*found, wrong) if reason is not None)
            seconds = time.perf_counter() - began
            return Outcome(f"{arm[0]} on {arm[1]}, seed {seed}", "quick", codes, seconds)
        verdict = calibrate(cell.truth.nominal, table, cell=known).geometry.verdict
        assert verdict is not None
        use, codes = verdict.use, tuple(reason.code for reason in verdict.reasons)
    except CalibError as error:
        use, codes = f"{type(error).__name__}: {error}", ()
    return Outcome(f"{arm[0]} on {arm[1]}, seed {seed}", use, codes, time.perf_counter() - began)


def main() -> None:
    """Run the study."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("--runs", type=int, default=20, help="tables of each mistake")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", default=",".join(MISTAKES), help="some mistakes, by commas")
    parser.add_argument("--quick", action="store_true", help="without the fits")
    parser.add_argument("--verbose", action="store_true", help="print every verdict")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.runs)
    for mistake in arguments.only.split(","):
        _, codes = MISTAKES[mistake]
        every = {code for _, of_mistake in MISTAKES.values() for code in of_mistake}
        jobs = [(mistake, seed) for seed in seeds]
        one = partial(run, quick=arguments.quick)
        outcomes = [o for o in run_jobs(one, jobs, workers=arguments.workers) if o is not None]
        named = sum(bool(o.codes) and o.codes[0] in codes for o in outcomes)
        if not codes:
            named = sum(not every & set(o.codes) for o in outcomes)
        slowest = max(o.seconds for o in outcomes)
        print(f"{mistake}: {named} of {len(outcomes)}, {slowest:.0f} s", flush=True)
        for o in outcomes:
            fine = (o.codes[:1] and o.codes[0] in codes) or not (codes or every & set(o.codes))
            if arguments.verbose or not fine:
                print(
                    f"  {o.name}: {o.use}: {', '.join(o.codes[:4])} ({o.seconds:.0f} s)", flush=True
                )


if __name__ == "__main__":
    main()
