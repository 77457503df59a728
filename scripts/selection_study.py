"""What `auto` chooses, against fixed models: over truths from nothing to everything wrong, and under gravity.

``truths 32 12 30``: so many robots of each arm, each truth and each of these numbers of points (else of all); the mean
error on unseen poses of what `auto` predicts, over that of the fixed model whose mean is the least.
``gravity 200``: arms with compliance and masses whose
URDFs have none, against a fit that knows masses, payload and structure; and arms without compliance.
``geometry 400 1000``: so many robots from this seed on whose families are wrong by widely different amounts, half of
them also by what no model holds; the geometry that `auto` takes, against that of the highest evidence.
"""

from __future__ import annotations

import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.estimate.fitting import Fitted, fit
from calib.model.families import FAMILIES
from calib.model.kinematics import Samples
from calib.result.fits import fit_table
from calib.robot.gravity import gravity_loads
from calib.robot.payload import Payload
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.selection.reference_fit import with_better_weights
from calib.simulation.truth import Truth, draw_truth
from calib.units import Array

ARMS = {"ur5": ("base_link", "tool0"), "panda": ("panda_link0", "panda_link8")}
SIGMA, UNSEEN = 5e-5, 400

#: What is wrong with a robot, and which families a URDF without masses leaves to gravity.
TRUTHS = {
    "nothing": "frames",
    "zeros": "zeros",
    "dh": "dh",
    "dh, eccentricity": "dh+eccentricity",
    "dh, compliance": "dh+compliance",
    "all": "placement+gain+eccentricity+compliance",
}
COUNTS = (12, 30, 60, 300)
FIXED = (
    *("frames", "zeros", "dh", "placement", "zeros+eccentricity", "zeros+gravity", "dh+gain"),
    *("dh+eccentricity", "dh+gravity", "dh+eccentricity+gravity"),
    "placement+gain+eccentricity+gravity",
)

#: What is wrong with a robot of `geometry`; the range that each family's errors may be over the usual ones, and those
#: of joint angles that no model holds [rad].
WIDE = ("frames", "zeros", "dh", "placement", "dh+gain", "dh+eccentricity", "placement+gravity")
SHARES, UNMODELLED = (0.05, 5.0), (1e-5, 3e-3)
WIDE_COUNTS, WIDE_SIGMAS, CORNERS = (8, 10, 12, 15, 20, 30, 50, 100), (1e-5, 1e-3), (1.0, 0.5, 0.2)

#: An ABB IRB 120 by its data sheet: mass [kg], its centre, the next joint's origin [m], axis and limit [rad].
IRB120 = (
    (0.0, "0 0 0", "0 0 0.29", "0 0 1", 2.87),
    (3.07, "0 0 -0.05", "0 0 0", "0 1 0", 1.9),
    (3.9, "0 0 0.1", "0 0 0.27", "0 1 0", 1.2),
    (2.94, "0.06 0 0.02", "0 0 0.07", "1 0 0", 2.79),
    (1.33, "0.22 0 0", "0.302 0 0", "0 1 0", 2.09),
    (0.55, "0 0 0", "0.072 0 0", "1 0 0", 3.1),
)


@dataclass(frozen=True)
class Table:
    """Points of a robot whose truth is known."""

    robot: Robot  # As calib gets it
    cell: Cell
    measurements: Measurements
    q: Array  # Unseen joint values
    true: Array  # Where the target is there, shape (N, 3) [m]

    def error(self, fitted: Fitted) -> float:
        """Of predictions at the unseen poses, rms [m]."""
        load = gravity_loads(self.robot, self.q, self.cell.payload)
        points = fitted.kinematics.points(fitted.estimate.x, Samples.at(self.q, load))
        return float(np.sqrt(np.mean(np.sum((points - self.true) ** 2, axis=1))))

    def by(self, model: str) -> Fitted:
        """The fit that predicts best."""
        fits = fit_table(self.robot, self.measurements, self.cell, model=model)
        return fits.non_geometric or fits.geometry


def measured(truth: Truth, cell: Cell, count: int, seed: int) -> Table:
    """A table of a robot, at random poses."""
    robot, rng = truth.nominal, np.random.default_rng([seed, count])
    q = random_joint_values(robot, count, seed + 1000)
    points = truth.points(q) + SIGMA * rng.normal(size=(count, 3))
    made = Measurements(robot.joint_names, q, points)
    unseen = random_joint_values(robot, UNSEEN, 99)
    return Table(robot, cell, made, unseen, truth.points(unseen))


def without_masses(robot: Robot) -> Robot:
    """The same robot, by a URDF that says nothing of inertia."""
    text = robot.urdf.data.decode(robot.urdf.encoding)
    text = re.sub(r"<inertial\b.*?</inertial>|<inertial\s*/>", "", text, flags=re.S)
    urdf = Urdf.from_bytes(text.encode(robot.urdf.encoding), "bare.urdf")
    return Robot.from_urdf(urdf, robot.base, robot.tip)


def irb120() -> Robot:
    """See `IRB120`."""
    links, joints = "", ""
    for k, (mass, centre, origin, axis, limit) in enumerate(IRB120):
        inertia = 'ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"'
        inside = f'<origin xyz="{centre}"/><mass value="{mass}"/><inertia {inertia}/>'
        links += f'<link name="link_{k}">{f"<inertial>{inside}</inertial>" if mass else ""}</link>'
        joints += (
            f'<joint name="joint_{k + 1}" type="revolute"><parent link="link_{k}"/>'
            f'<child link="link_{k + 1}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>'
            f'<limit lower="{-limit}" upper="{limit}" effort="1" velocity="1"/></joint>'
        )
    text = f'<robot name="irb120">{links}<link name="link_6"/>{joints}</robot>'
    return Robot.from_urdf(Urdf.from_bytes(text.encode(), "irb120.urdf"), "link_0", "link_6")


def table_of_truth(arm: str, true: str, count: int, seed: int) -> Table:
    """A table of a robot that is wrong in a known way; the frame is known to half of them."""
    robot, rng = Robot.load(arm, *ARMS[arm]), np.random.default_rng([seed, count])
    cell = Cell(estimate_frame=bool(seed % 2), payload=Payload(2.0, np.array([0.0, 0.0, 0.05])))
    sizes = None if true == "frames" else {"compliance": 10.0 ** rng.uniform(-5.0, -4.0)}
    table = measured(draw_truth(robot, true, sizes, seed, cell=cell), cell, count, seed)
    if not true.endswith("compliance"):
        return table
    return replace(table, robot=without_masses(robot), cell=replace(cell, payload=None))


def errors_by_model(table: Table) -> dict[str, float]:
    """The error of each fixed model, and of `auto`."""
    auto = fit_table(table.robot, table.measurements, table.cell, model="auto")
    found = {"auto": table.error(auto.non_geometric or auto.geometry)}
    task, rows = replace(auto.geometry.task, lenient=True), auto.geometry.estimate.problem.rows
    found |= {m: table.error(fit(replace(task, model=m), rows)) for m in FIXED}
    return found


def truths(runs: int, *counts: int) -> Iterator[str]:
    """A line for each truth and number of points."""
    for name, true in TRUTHS.items():
        for count in counts or COUNTS:
            found = defaultdict(list)
            for arm in ARMS:
                for seed in range(runs):
                    for model, error in errors_by_model(
                        table_of_truth(arm, true, count, seed)
                    ).items():
                        found[model].append(error)
            mean = {model: float(np.mean(one)) for model, one in found.items()}
            best = min((m for m in mean if m != "auto"), key=mean.__getitem__)
            yield (
                f"{name:18} n {count:4}: auto {1e3 * mean['auto']:.4f} mm, "
                f"{mean['auto'] / mean[best]:.3f} of {best}"
            )


def gravity(runs: int) -> Iterator[str]:
    """A line for each arm with compliance, and one for arms without."""
    arms = {arm: Robot.load(arm, *links) for arm, links in ARMS.items()} | {"irb120": irb120()}
    for soft in (True, False):
        for arm, robot in arms.items():
            auto, known = [], []
            for seed in range(runs):
                rng = np.random.default_rng([seed, len(arm)])
                count, free = int(rng.choice([40, 60, 100, 200])), bool(rng.integers(2))
                cell, c = Cell(estimate_frame=free), 10.0 ** rng.uniform(-5.0, -4.0)
                springs = c * rng.uniform(0.5, 1.5, len(robot.joints)) * soft
                errors = {
                    f"{j.name}.compliance": s for j, s in zip(robot.joints, springs, strict=True)
                }
                true = (
                    "dh+compliance" if soft else ("dh", "dh+eccentricity", "zeros+gain")[seed % 3]
                )
                truth = draw_truth(
                    robot, true, {}, seed, cell=cell, errors=errors if soft else None
                )
                table = measured(truth, cell, count, seed)
                known.append(table.error(table.by(true)))
                bare = replace(table, robot=without_masses(robot))
                auto.append(bare.error(bare.by("auto")))
            ratio = np.log(np.array(auto) / np.array(known))
            yield (
                f"{'compliant' if soft else 'stiff':9} {arm:7} auto over the known structure: "
                f"means {np.mean(auto) / np.mean(known):.3f}, geometric {np.exp(ratio.mean()):.3f}"
                f" +- {ratio.std() / np.sqrt(runs):.3f}, median {np.exp(np.median(ratio)):.3f}"
            )


def drawn_widely(seed: int) -> tuple[str, Table]:
    """What is wrong with a robot, and a table of it in a part of its joints' ranges."""
    rng = np.random.default_rng([23, seed])
    arm, wrong = str(rng.choice(list(ARMS))), str(rng.choice(WIDE))
    robot, cell = Robot.load(arm, *ARMS[arm]), Cell(estimate_frame=bool(rng.integers(2)))
    sizes = {name: row.typical * log_uniform(rng, SHARES) for name, row in FAMILIES.items()}
    truth = draw_truth(
        robot, wrong, None if wrong == "frames" else sizes, int(rng.integers(10**6)), cell=cell
    )
    joints = len(robot.joint_names)
    size = log_uniform(rng, UNMODELLED) * bool(rng.integers(2))
    order, phase = rng.integers(2, 6, joints), rng.uniform(0.0, 2.0 * np.pi, joints)

    def points(q: Array) -> Array:
        return truth.points(q + size * np.sin(order * q + phase))

    middle = random_joint_values(robot, 1, int(rng.integers(10**6)))
    share, count = float(rng.choice(CORNERS)), int(rng.choice(WIDE_COUNTS))
    seeds = int(rng.integers(10**6)), 98
    q, unseen = (
        middle + share * (random_joint_values(robot, n, s) - middle)
        for n, s in zip((count, UNSEEN), seeds, strict=True)
    )
    noise = log_uniform(rng, WIDE_SIGMAS) * rng.normal(size=(count, 3))
    made = Measurements(robot.joint_names, q, points(q) + noise)
    return wrong.split("+")[0], Table(robot, cell, made, unseen, points(unseen))


def log_uniform(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    """A number between two limits, each power of ten as likely."""
    return float(np.exp(rng.uniform(*np.log(limits))))


def geometry(runs: int, first: int = 0) -> Iterator[str]:
    """A line for each kind of robot: error of the geometry of `auto` over that of the highest evidence."""
    ratios = defaultdict(list)
    for seed in range(first, first + runs):
        wrong, table = drawn_widely(seed)
        fits = fit_table(table.robot, table.measurements, table.cell, model="auto")
        sets = [c for c in fits.candidates if "+" not in c.name]
        likeliest = max(sets, key=lambda c: c.evidence).name
        ratio = 1.0
        if likeliest != fits.geometry.task.model:
            task, rows = fits.geometry.task, fits.geometry.estimate.problem.rows
            other = fit(replace(task, model=likeliest), rows)
            judge = fits.non_geometric or fits.geometry
            ratio = table.error(fits.geometry) / table.error(
                with_better_weights(other, rows, judge)
            )
        count = len(table.measurements)
        for group in ("all", wrong, "below 16 poses" if count < 16 else "16 poses and more"):
            ratios[group].append(ratio)
    for group, found in ratios.items():
        logs = np.log(found)
        yield (
            f"{group:18} {len(found):4} robots: {np.exp(logs.mean()):.4f}, another geometry in "
            f"{np.sum(logs != 0.0)}, better by 1 % in {np.sum(logs < -0.01)}, worse in "
            f"{np.sum(logs > 0.01)}"
        )


def main() -> None:
    """One of the three."""
    study = {"truths": truths, "gravity": gravity, "geometry": geometry}[sys.argv[1]]
    for line in study(*map(int, sys.argv[2:])):
        print(line, flush=True)


if __name__ == "__main__":
    main()
