"""The content of a page of robots: robots, poses, and what was measured at them; values only.

With a table each pose is a row, or an image; without one, poses are spread over the joint limits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import trimesh

from calib.basics.arrays import Array, Integers, Mask, rigid_inverse
from calib.basics.values import ReadOnlyMapping
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import ModelError, choices
from calib.fit.registration.setup import Setup
from calib.result.calibration import Calibration
from calib.robot.ranges import column_ranges, spread_poses
from calib.robot.robot import Robot
from calib.show.measured_rows import chains_of_rows, measured_in_base, setup_of_rows
from calib.show.robot_sentences import other_run_sentence
from calib.show.scene.posed_robot import Visual, chain_bases, creased, stands, translation
from calib.show.uncertainty_map import UncertaintyMap, uncertainty_map
from calib.show.verdict_text import do_not_use_text, reason_text
from calib.verbs.evaluate.evaluation import PLACES, Evaluation, evaluate
from calib.verbs.view.camera_images import CameraImages, camera_images
from calib.verbs.view.steps import (
    choose_steps,
    errors_by_unit,
    rows_of_steps,
    seen_from_root,
    typical_step,
)

#: Name of each of two robots, and a description that stands below it.
Names = Sequence[tuple[str, str]]

#: Poses of two robots without a table.
_POSES = 24

#: Poses at which the uncertainty over the joint limits is shown: they add 30 kB to a page.
_MAP_POSES = 800

#: Poses of each joint of a robot alone.
_POSES_PER_JOINT = 9

#: Radius of a ball that marks a target on a robot of several chains [m].
_MARK = 0.012

#: No cameras are known.
NO_CAMERAS: Mapping[str, Camera] = ReadOnlyMapping()

#: A station whose frame is nearer to the base than this [m, rad] is the base.
_SAME_FRAME = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Measurements at the N poses of a view."""

    #: Shape (N, 3), the measured targets in the base [m]; NaN where no position was measured
    points: Array
    #: Shape (2, N), norm of each robot's residual by the unit's symbol; NaN where a row measures nothing in it
    errors: Mapping[str, Array] = field(default_factory=dict)
    #: Shape (N, 4, 4), base of the nominal robot in the calibrated one's as each was registered [m]; None: the same
    T_base_nominal: Array | None = None
    #: Shape (K, 4, 4), frames of the stations in the base [m], except those that are the base
    stations: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    #: Cameras, boards and the corners of each image; None if the poses are not those of images
    images: CameraImages | None = None
    #: Number of rows of the table if some of them are shown; 0 if all are
    rows: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The content of a page: N poses, one of them at a time, and the marks of all of them.

    Raises:
        ModelError: The robots have different joints.
    """

    #: The robot before calibration
    nominal: Robot
    #: The robot after it, the same chain; None to show one robot alone
    calibrated: Robot | None
    #: Shape (N, m), [rad] or [m], in the order of ``nominal.joint_names``
    q: Array
    #: Name of each pose, such as ``"row 31"``; by default they are counted
    labels: tuple[str, ...] = ()
    #: ``"estimation"``, ``"validation"``, ``"flagged"``, or by default ``"pose"``
    kinds: tuple[str, ...] = ()
    #: Shape (N, 4, 4) or (4, 4), T_tip_target of the nominal robot [m]
    nominal_target: Array = field(default_factory=lambda: np.eye(4))
    #: The same of the calibrated one
    calibrated_target: Array = field(default_factory=lambda: np.eye(4))
    #: Shape (N,), the chain that each pose was measured through, by its index in `Robot.chains`; None: the first
    chain: Integers | None = None
    #: Targets, and frames on links that joints move, of each robot, drawn at their links; by "nominal", "calibrated"
    marks: Mapping[str, tuple[Visual, ...]] = field(default_factory=dict)
    #: Measurements at the poses; None: nothing was measured
    measured: Measured | None = None
    #: Index of the pose shown first, from 0
    start: int = 0
    #: The page's heading
    title: str = ""
    #: Verdict of the calibration; empty without one
    verdict: str = ""
    #: A sentence below the heading, such as the verdict's first reason
    note: str = ""
    #: Name and description of each robot
    names: Names = (("Nominal", "the URDF as given"), ("Calibrated", "the corrected URDF"))
    #: Uncertainty of the target over the joint limits, with the targets' places in the scene; None: it is not shown
    uncertainty: UncertaintyMap | None = None
    #: Facts shown in words for each pose, by their names: N texts, such as a joint's values with their unit
    numbers: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse two robots with different joints (`ModelError`), and fill in labels and kinds that were not given."""
        nominal = self.nominal.joint_names
        if self.calibrated is not None and self.calibrated.joint_names != nominal:
            raise ModelError(
                f"The nominal robot has the joints {choices(nominal)}, the calibrated one "
                f"{choices(self.calibrated.joint_names)}. Show two robots with the same chain."
            )
        count = len(self.q)
        labels = self.labels or tuple(f"pose {k + 1}" for k in range(count))
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "kinds", self.kinds or ("pose",) * count)

    @property
    def robots(self) -> dict[str, Robot]:
        """The robots by ``"nominal"`` and, if there is one, ``"calibrated"``."""
        robots = {"nominal": self.nominal}
        if self.calibrated is not None:
            robots["calibrated"] = self.calibrated
        return robots

    @property
    def points(self) -> Array:
        """The measured targets in the base, shape (N, 3), [m]; NaN where no position was measured."""
        if self.measured is None:
            return np.full((len(self.q), 3), np.nan)
        return self.measured.points

    @property
    def has_points(self) -> bool:
        """True if the position of any target was measured."""
        return bool(np.any(np.isfinite(self.points)))

    @property
    def T_base_nominal(self) -> Array:
        """Base of the nominal robot in the calibrated one's, as each was registered, shape (N, 4, 4), [m]."""
        if self.measured is None or self.measured.T_base_nominal is None:
            return np.broadcast_to(np.eye(4), (len(self.q), 4, 4))
        return self.measured.T_base_nominal

    @property
    def is_registered_apart(self) -> bool:
        """True if the bases of the two robots were registered at different places."""
        return not np.allclose(self.T_base_nominal, np.eye(4), 0.0, _SAME_FRAME)

    @property
    def predicted(self) -> Array:
        """Target of each robot as registered, in the calibrated one's base, (2, N, 3) [m]; of one robot twice."""
        first, second = self.nominal, self.calibrated or self.nominal
        T_first = chain_bases(first, self.q, self.chain) @ first.poses(self.q, self.chain)
        T_second = chain_bases(second, self.q, self.chain) @ second.poses(self.q, self.chain)
        T_base_first = self.T_base_nominal @ T_first @ self.nominal_target
        T_base_second = T_second @ self.calibrated_target
        return np.array([T_base_first[:, :3, 3], T_base_second[:, :3, 3]])


# Views of results


def view_of(calibration: Calibration, *, accepted: bool = False) -> View:
    """Return the view of a calibration: every row a pose.

    Args:
        calibration: The result.
        accepted: The corrected URDF is used whatever the verdict says.
    """
    c = calibration
    m = c.fit.measurements
    before = Evaluation(c.nominal, m, c.nominal_setup, (), c.rows.residual_nominal, c.rows.channels)
    after = Evaluation(c.robot, m, c.setup, (), c.rows.residual_calibrated, c.rows.channels)
    view = view_at_rows(before, after, c.rows.flagged, c.optics.cameras)
    if _same_origins(c.robot, c.nominal):
        meaning = "unchanged: no joint origin was corrected"
    elif not do_not_use_text(c.verdict):
        meaning = "the corrected URDF"
    elif accepted:
        meaning = "the corrected URDF, accepted in spite of the verdict"
    else:
        meaning = "as fitted, not to be used: no URDF is written"
    names = (view.names[0], ("Calibrated", f"{meaning} (run {c.run})"))
    title = f"{c.nominal.name or 'Robot'}: nominal and calibrated"
    return _with_verdict(replace(_with_map(view, c), title=title, names=names), c)


def view_of_result(
    result: Calibration,
    robot: Robot,
    table: Measurements | None = None,
    cell: Cell | None = None,
    *,
    known: Sequence[str] = PLACES,
    source: str = "the result",
) -> View:
    """Return the view of a robot with the joint origins before and after a result that was read from a file.

    Args:
        result: The result.
        robot: The robot, nominal or corrected.
        table: The rows that are shown; those that the fit flagged are marked if this is the table of the fit. None for
            poses over the joint limits.
        cell: Frames and targets that the result does not give.
        known: Those of ``"frame"`` and ``"target"`` that are the result's, not the cell's.
        source: Name of the result on the page.

    Returns:
        The view; its errors are those of `calib.evaluate`.
    """
    cell = result.complete_cell(cell or Cell())
    before = result.uncorrected(robot)
    after = result.corrected(robot)
    if table is None:
        view = view_of_robots(before, after, cells=(cell, cell))
        marks = {
            "nominal": marks_of(before, result.nominal_setup),
            "calibrated": marks_of(after, result.setup),
        }
        view = replace(view, marks=marks)
        if before.branches and "target" in known:
            # The chains in turn, each with its first target.
            chain = np.arange(len(view.q)) % len(before.chains)
            tips = [before.chains[number].tip for number in chain]
            of_pose = [result.setup.target_links.index(tip) for tip in tips]
            view = replace(
                view,
                chain=chain,
                nominal_target=result.nominal_setup.T_tip_target[of_pose],
                calibrated_target=result.setup.T_tip_target[of_pose],
            )
        elif "target" in known:
            first_target = result.nominal_setup.T_tip_target[0]
            second_target = result.setup.T_tip_target[0]
            view = replace(view, nominal_target=first_target, calibrated_target=second_target)
    else:
        which = tuple(known)
        first = evaluate(before, table, cell, known=result.nominal_setup, which=which)
        second = evaluate(after, table, cell, known=result.setup, which=which)
        # Row numbers of another table mean other rows.
        numbers = [outlier.row for outlier in (*result.rows.outliers, *result.rows.suspects)]
        is_same_table = result.source.sha256 == table.sha256
        flagged = np.isin(table.rows, numbers) & is_same_table
        view = view_at_rows(first, second, flagged, result.optics.cameras or cell.cameras)
    origins = f"joint origins of {source}"
    if _same_origins(before, after):
        origins = "unchanged: no joint origin was corrected"
    names = (("Nominal", "before the calibration"), ("Calibrated", f"{origins} (run {result.run})"))
    view = _with_verdict(replace(_with_map(view, result), names=names), result)
    other_run = other_run_sentence(robot, result, source)
    return replace(view, note=" ".join(filter(None, [view.note, other_run])))


def _with_map(view: View, result: Calibration) -> View:
    """Return the view with the uncertainty of the target over the joint limits, if it is known.

    On a robot whose base moves the instrument is carried, and the map is at its places.
    """
    if result.unknown_accuracy:
        return view
    found = uncertainty_map(result, _MAP_POSES)
    robot = view.calibrated or view.nominal
    if (robot.base, robot.tip) == (result.nominal.base, result.nominal.tip):
        T_scene_base = chain_bases(robot, found.q, None)
        places = np.einsum("nij,nj->ni", T_scene_base[:, :3, :3], found.places)
        places = places + T_scene_base[:, :3, 3]
    else:
        T_tip_frame = rigid_inverse(result.robot.poses(found.q)) @ rigid_inverse(
            result.T_frame_base
        )
        places = T_tip_frame[:, :3, 3]
    return replace(view, uncertainty=replace(found, places=places))


def _same_origins(robot: Robot, other: Robot) -> bool:
    """Return whether two robots of the same chains have the same joint origins."""
    chains = zip(robot.chains, other.chains, strict=True)
    return all(np.array_equal(one.placements, two.placements) for one, two in chains)


def _with_verdict(view: View, c: Calibration) -> View:
    """Return the view with the verdict of a result and its first reason, or a note that it has no verdict."""
    if c.verdict is None:
        return replace(view, note="No verdict: the result was not cross-validated.")
    note = ""
    if c.verdict.reasons:
        note = reason_text(c.verdict.reasons[0])
    return replace(view, verdict=c.verdict.use, note=note)


def marks_of(robot: Robot, setup: Setup) -> tuple[Visual, ...]:
    """Return what is drawn of a setup at the links of a robot of several chains: targets, and frames that are carried.

    Targets are balls; frames boxes, longer along their z. Frames that stand still are drawn as stations.
    """
    if not robot.branches:
        return ()
    ball = trimesh.creation.icosphere(2, _MARK)
    marks = [
        Visual(link, T, creased(ball.vertices, ball.faces))
        for link, T in zip(setup.target_links, setup.T_tip_target, strict=False)
    ]
    if not stands(robot):
        box = trimesh.creation.box((2.0 * _MARK, 2.0 * _MARK, 4.0 * _MARK))
        for link, T in zip(setup.frame_links, setup.T_frame_base, strict=False):
            _, way = robot.urdf.chain(robot.urdf.root, link)
            if any(robot.urdf.joint(name).type != "fixed" for name in way):
                marks.append(Visual(link, rigid_inverse(T), creased(box.vertices, box.faces)))
    return tuple(marks)


# Views of robots


def view_of_robots(
    nominal: Robot,
    calibrated: Robot | None = None,
    table: Measurements | None = None,
    *,
    cells: Sequence[Cell] = (Cell(), Cell()),
    names: Names = (),
) -> View:
    """Return the view of one or two robots.

    Args:
        nominal: The first robot.
        calibrated: The second one, of the same chain; None to show one robot alone.
        table: The rows that are shown, with the errors of `calib.evaluate`. None: two robots go through poses spread
            over the joint limits, and one moves one joint after the other.
        cells: Target and frame of each robot, if they are known.
        names: Name and description of each robot; by default nominal and calibrated, and their files.
    """
    title = nominal.name if calibrated is None else ""
    if not names:
        file = Path(nominal.urdf.source).name
        if calibrated is None:
            names = [(nominal.name or "Nominal", file)]
        else:
            names = [("Nominal", file), ("Calibrated", Path(calibrated.urdf.source).name)]
    if table is not None:
        first = evaluate(nominal, table, cells[0])
        second = evaluate(calibrated, table, cells[1]) if calibrated else None
        view = view_at_rows(first, second, np.zeros(len(table), bool), cells[-1].cameras)
        return replace(view, names=names, title=title)
    targets = []
    for cell in cells:
        point = next(iter(cell.targets.values()), cell.target)
        targets.append(translation((0.0, 0.0, 0.0) if point is None else point))
    numbers: Mapping[str, Sequence[str]] = {}
    if calibrated is None:
        # Each joint in turn goes through its range.
        ranges = column_ranges(nominal)
        middle = np.clip(0.0, *ranges.T)
        values_of_poses = [middle]
        texts = ["all joints at zero, or as near as they can be"]
        for k, joint in enumerate(nominal.inputs):
            scale, unit = _shown_unit(joint.type)
            low, high = ranges[k]
            for value in np.linspace(low, high, _POSES_PER_JOINT):
                values = middle.copy()
                values[k] = value
                values_of_poses.append(values)
                texts.append(f"{joint.name} at {scale * value:.4g} {unit}")
        q, labels = nominal.readings(np.array(values_of_poses)), tuple(texts)
        numbers = joint_texts(nominal, q)
    else:
        q = spread_poses(nominal, _POSES)
        labels = tuple(f"pose {k + 1} of {len(q)} over the joint limits" for k in range(len(q)))
    return View(
        nominal,
        calibrated,
        q,
        labels,
        nominal_target=targets[0],
        calibrated_target=targets[-1],
        names=names,
        title=title,
        numbers=numbers,
    )


def _shown_unit(joint_type: str) -> tuple[float, str]:
    """Return the factor from SI units to the unit in which a joint's values are shown, and this unit."""
    return (1e3, "mm") if joint_type == "prismatic" else (float(np.degrees(1.0)), "deg")


def joint_texts(robot: Robot, q: Array) -> dict[str, tuple[str, ...]]:
    """Return the values of each joint as texts with their unit.

    Args:
        robot: The robot.
        q: shape (N, m), joint values [rad or m], columns as ``robot.joint_names``.

    Returns:
        N texts by the joint's name, in degrees, or millimetres for sliding joints, with three decimals.
    """
    texts = {}
    for values, (name, joint_type) in zip(q.T, robot.joint_types.items(), strict=True):
        scale, unit = _shown_unit(joint_type)
        texts[name] = tuple(f"{scale * value + 0.0:.3f} {unit}" for value in values)
    return texts


# Views of tables


def view_at_rows(
    first: Evaluation,
    second: Evaluation | None,
    flagged: Mask,
    cameras: Mapping[str, Camera] = NO_CAMERAS,
) -> View:
    """Return the view of one or two robots at the rows of a table, or at its images.

    Args:
        first: The first robot's residuals.
        second: The second robot's at the same rows; None to show one robot alone.
        flagged: shape (M,), the flagged rows.
        cameras: Cameras of images by their stations; without any, neither they nor boards are drawn.

    Returns:
        The view of all N steps; if there are many, of an even choice and flagged ones. A typical one is shown first.
    """
    chain = first.robot
    first = seen_from_root(first)
    last = first if second is None else seen_from_root(second)
    table = first.measurements
    rows = rows_of_steps(table)
    begins = np.zeros(len(table), dtype=bool)
    begins[[int(of_step[0]) for of_step in rows]] = True
    m = table.select(begins)  # one row of each step

    is_flagged = np.array([bool(np.any(flagged[of_step])) for of_step in rows])
    errors = errors_by_unit(first, last, rows)
    leading = next(iter(errors.values()), np.full((2, len(rows)), np.nan))
    start = typical_step(leading, m.estimation & ~is_flagged)
    shown = choose_steps(is_flagged, start)

    labels = []
    kinds = []
    is_image = m.is_image
    for k in shown:
        image = m.images[k] if is_image[k] else ""
        labels.append(image or f"row {m.rows[k]}")
        fitted_or_not = "validation" if m.validation[k] else "estimation"
        kinds.append("flagged" if is_flagged[k] else fitted_or_not)

    T_frame_first, nominal_target = setup_of_rows(first.setup, m)
    T_frame_base, calibrated_target = setup_of_rows(last.setup, m)
    # Both robots are seen from the same station, so that the errors in the picture are those of the tables. If no row
    # measures a position, neither robot's place is estimated: they share their base.
    T_base_nominal = None
    if stands(last.robot) and np.any(m.where(lambda kind: kind.coordinates)):
        T_base_nominal = (rigid_inverse(T_frame_base) @ T_frame_first)[shown]
    T_base_frame = rigid_inverse(T_frame_base)
    is_base = np.all(np.isclose(T_base_frame, np.eye(4), 0.0, _SAME_FRAME), axis=(1, 2))
    images = None
    if stands(last.robot):
        images = camera_images(first, last, rows, cameras, carries_camera=first.robot is not chain)
    q = m.joints_for(first.robot.joint_names)
    chain_of_row = chains_of_rows(first.robot, first.setup, m)
    points = measured_in_base(m, T_frame_base)
    T_scene_base = chain_bases(last.robot, q, chain_of_row)
    points = np.einsum("nij,nj->ni", T_scene_base[:, :3, :3], points) + T_scene_base[:, :3, 3]
    stand = stands(last.robot)
    marks = {"nominal": marks_of(first.robot, first.setup)}
    if second is not None:
        marks["calibrated"] = marks_of(last.robot, last.setup)
    measured = Measured(
        points=points[shown],
        errors={unit: of_unit[:, shown] for unit, of_unit in errors.items()},
        T_base_nominal=T_base_nominal,
        stations=np.unique(T_base_frame[m.positions & ~is_base & stand], axis=0),
        images=None if images is None else images.at(shown),
        rows=len(rows) if len(shown) < len(rows) else 0,
    )
    return View(
        first.robot,
        None if second is None else last.robot,
        q[shown],
        labels=tuple(labels),
        kinds=tuple(kinds),
        nominal_target=nominal_target[shown],
        calibrated_target=calibrated_target[shown],
        chain=None if chain_of_row is None else chain_of_row[shown],
        marks=marks,
        measured=measured,
        start=int(np.searchsorted(shown, start)),
    )
