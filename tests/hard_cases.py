"""Calibrations of every kind that pictures and reports must cope with; each is computed once, when it is asked for.

`CASES` names them, `made` makes one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from xml.sax.saxutils import quoteattr

import numpy as np

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, paper_measurements, paper_urdf
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.gravity import Payload
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.simulate.disturbances import Outliers
from calib.verbs.simulate.scenario import Scenario
from tests.kept import kept

#: Names that break what does not escape them: HTML, mathtext, Markdown, quotes, lines, width, letters and direction.
HOSTILE = (
    "<script>document.title='owned'</script>",
    "$\\frac{a}{b$ _x^2_ | **b** `c` [d](e) 100 %",
    "joint_" + "with_a_very_long_name_" * 9 + "A",
    "joint_" + "with_a_very_long_name_" * 9 + "B",
    "\"quoted' & ünïcödé 関節 עברית 🤖",
)

#: A target's, a set-up's and a file's name of the same kind.
HOSTILE_TARGET, HOSTILE_SOURCE = "t<b>$x_{", "../<i>Ünïcöde 測定\n$y^{.csv"

_PLANAR = """<robot name="planar">
  <link name="base"/><link name="upper"/><link name="fore"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-2.5" upper="2.5" effort="1" velocity="1"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0.1"/>
    <axis xyz="0 0 1"/><limit lower="-2.5" upper="2.5" effort="1" velocity="1"/></joint>
</robot>
"""

_GANTRY = """<robot name="gantry">
  <link name="rail"/><link name="bridge"/><link name="carriage"/><link name="quill"/><link name="hand"/>
  <joint name="slide_x" type="prismatic"><parent link="rail"/><child link="bridge"/><origin xyz="0 0 0.5"/>
    <axis xyz="1 0 0"/><limit lower="-0.8" upper="0.8" effort="1" velocity="1"/></joint>
  <joint name="slide_y" type="prismatic"><parent link="bridge"/><child link="carriage"/><origin xyz="0.3 0.1 0"/>
    <axis xyz="0 1 0"/><limit lower="-0.5" upper="0.5" effort="1" velocity="1"/></joint>
  <joint name="slide_z" type="prismatic"><parent link="carriage"/><child link="quill"/><origin xyz="0 0.1 0.1"/>
    <axis xyz="0 0 1"/><limit lower="-0.3" upper="0.3" effort="1" velocity="1"/></joint>
  <joint name="turn" type="continuous"><parent link="quill"/><child link="hand"/><origin xyz="0 0.2 0.4"/>
    <axis xyz="0 0 1"/></joint>
</robot>
"""


def ur3() -> Robot:
    """The paper's robot."""
    return Robot.load(paper_urdf(), base="base", tip="tool0")


def table(robot: Robot) -> Measurements:
    """The paper's table."""
    return Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)


def simulated(
    scenario: Scenario, estimate: int, validate: int = 0, seed: int = 5, *, only: str = ""
) -> Measurements:
    """A table of a virtual cell: poses anywhere inside the limits."""
    q = np.concatenate(
        [
            scenario.random_poses(estimate, seed),
            scenario.random_poses(max(validate, 1), seed, validation=True)[:validate],
        ]
    )
    sets = ("estimate",) * estimate + ("validate",) * validate
    found = scenario.draw(seed).measure(q, seed, sets).measurements
    return replace(found, source=only or "simulated.csv")


def paper() -> Calibration:
    """The demo: 30 rows and 5 to validate, one outlier, the paper's 27 parameters, cross-validated."""
    robot = ur3()
    cell = Cell(target=read_only(PAPER_TARGET), model="paper")
    return calibrate(robot, table(robot), cell=cell)


def auto() -> Calibration:
    """The paper's table with the model that the data choose, from a ladder of candidates."""
    robot = ur3()
    return calibrate(robot, table(robot), cell=Cell(target=read_only(PAPER_TARGET)))


def poses() -> Calibration:
    """Positions and orientations in a tracker's own frame, at random poses."""
    scenario = Scenario(
        ur3(), Cell(kind="pose", estimate_frame=True, model="dh"), model="dh", sigma={"rad": 2e-4}
    )
    found = simulated(scenario, 40, 12)
    return calibrate(scenario.robot, found, cell=scenario.cell)


def two_joints() -> Calibration:
    """Two joints in a plane."""
    robot = Robot.from_urdf(Urdf.from_bytes(_PLANAR.encode(), "planar.urdf"), "base", "fore")
    scenario = Scenario(robot, Cell(model="dh"), model="dh")
    return calibrate(robot, simulated(scenario, 20, 5), cell=scenario.cell)


def prismatic() -> Calibration:
    """Three joints that slide and one that turns without limits."""
    robot = Robot.from_urdf(Urdf.from_bytes(_GANTRY.encode(), "gantry.urdf"), "rail", "hand")
    scenario = Scenario(robot, Cell(model="dh"), model="dh")
    return calibrate(robot, simulated(scenario, 30, 6), cell=scenario.cell, validate=False)


def with_outliers() -> Calibration:
    """60 rows of which six are off by some 5 mm, two of them to validate."""
    scenario = Scenario(ur3(), Cell(model="dh"), model="dh", outliers=Outliers(count=6))
    found = simulated(scenario, 50, 10)
    points = found.points.copy()
    points[[52, 57]] += [4e-3, -3e-3, 2e-3]
    return calibrate(scenario.robot, replace(found, points=points), cell=scenario.cell)


def do_not_use() -> Calibration:
    """The columns of two joints are swapped: errors of decimetres, and the verdict says so."""
    robot = ur3()
    right = table(robot)
    wrong = replace(right, joints=right.joints[:, [1, 0, 2, 3, 4, 5]], source="swapped.csv")
    return calibrate(robot, wrong, cell=Cell(target=read_only(PAPER_TARGET), model="dh"))


def few_rows(count: int = 3) -> Calibration:
    """The first rows of the paper's table, too few for anything."""
    robot = ur3()
    mask = np.arange(35) < count
    cell = Cell(target=read_only(PAPER_TARGET), model="paper")
    return calibrate(robot, table(robot).select(mask), cell=cell, validate=count > 1)


def hostile_names() -> Calibration:
    """Joints, robot, target and file with names that must be escaped, shortened or drawn with other fonts."""
    links = [f"link{i}" for i in range(len(HOSTILE) + 1)]
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0")
    joints = "".join(
        f'<joint name={quoteattr(name)} type="{"prismatic" if i == 3 else "revolute"}">'
        f'<parent link="{links[i]}"/><child link="{links[i + 1]}"/><origin xyz="0.1 0.05 0.2"/>'
        f'<axis xyz="{axes[i]}"/><limit lower="-0.9" upper="1.1" effort="1" velocity="1"/></joint>'
        for i, name in enumerate(HOSTILE)
    )
    parts = "".join(f"<link name={quoteattr(name)}/>" for name in links) + joints
    text = f"<robot name={quoteattr(HOSTILE[0])}>{parts}</robot>"
    urdf = Urdf.from_bytes(text.encode(), HOSTILE[1] + ".urdf")
    robot = Robot.from_urdf(urdf, links[0], links[-1])
    targets = {HOSTILE_TARGET: read_only((0.05, 0.05, 0.05)), "plain": read_only((-0.1, 0.0, 0.05))}
    cell = Cell(targets=targets, model="placement")
    found = simulated(Scenario(robot, cell), 30, 5, only=HOSTILE_SOURCE)
    return calibrate(robot, found, cell=cell, validate=False)


def non_geometric() -> Calibration:
    """Joints that give way under a payload, which no URDF can say."""
    payload = Payload(3.0, (0.0, 0.0, 0.1))
    scenario = Scenario(ur3(), Cell(model="dh+compliance", payload=payload), model="dh+compliance")
    return calibrate(scenario.robot, simulated(scenario, 40, 10), cell=scenario.cell)


def distances() -> Calibration:
    """Lengths from anchors: no row has coordinates."""
    scenario = Scenario(ur3(), Cell(kind="distance", model="dh"), model="dh")
    found = simulated(scenario, 60, 10)
    return calibrate(scenario.robot, found, cell=scenario.cell, validate=False)


def mixed() -> Calibration:
    """Points and poses in one table: some rows have no orientation."""
    scenario = Scenario(ur3(), Cell(kind="pose", model="dh"), model="dh", sigma={"rad": 2e-4})
    found = simulated(scenario, 40)
    kinds = tuple("point" if k % 3 else "pose" for k in range(len(found)))
    return calibrate(
        scenario.robot, replace(found, kinds=kinds), cell=Cell(model="dh"), validate=False
    )


@kept
def many_rows(count: int = 20_000) -> Calibration:
    """As many rows as are asked for, a tenth of them to validate."""
    scenario = Scenario(ur3(), Cell(model="dh"), model="dh", outliers=Outliers(count=count // 1000))
    found = simulated(scenario, count - count // 10, count // 10)
    return calibrate(scenario.robot, found, cell=scenario.cell, validate=False)


def with_rows(c: Calibration, m: Measurements) -> Calibration:
    """The calibration as if its rows had been others."""
    rows = replace(
        c.rows,
        numbers=m.rows,
        sets=m.sets,
        kinds=m.kinds,
        groups=m.groups,
        targets=m.targets,
        images=(),
    )
    return replace(c, rows=rows, fit_in_memory=replace(c.fit, measurements=m))


#: What makes each case; in tests ``many_rows`` has 20,000 rows.
CASES: dict[str, Callable[[], Calibration]] = {
    "paper": paper,
    "auto": auto,
    "poses": poses,
    "two_joints": two_joints,
    "prismatic": prismatic,
    "with_outliers": with_outliers,
    "do_not_use": do_not_use,
    "three_rows": few_rows,
    "one_row": lambda: few_rows(1),
    "hostile_names": hostile_names,
    "non_geometric": non_geometric,
    "distances": distances,
    "mixed": mixed,
    "many_rows": many_rows,
}


@kept
def made(name: str) -> Calibration:
    """The calibration of a case."""
    return CASES[name]()
