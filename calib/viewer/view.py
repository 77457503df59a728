"""What is shown: which robots, their shapes, at which poses, and what was measured there; values only.

At the rows of a table each row is a pose; of robots alone poses are spread over the joint limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import ModelError, choices
from calib.report.row_values import (
    angles_of,
    flagged_rows,
    lengths_of,
    measured_in_base,
    setup_of_rows,
)
from calib.result.calibration import CalibrationValues
from calib.result.comparison import ComparisonValues
from calib.result.evaluation import PLACES, Evaluation, evaluate
from calib.robot.full_model import full_configurations, full_model, link_frame
from calib.robot.meshes import LinkShape, find_mesh, link_shapes, mesh_folders, read_mesh
from calib.robot.ranges import column_ranges, spread_poses
from calib.robot.robot import Robot, rigid_inverse
from calib.robot.urdf import Urdf
from calib.text.comparison import sentence
from calib.text.verdict import reason_text
from calib.units import Array, Mask

#: Vertices, shape (V, 3), [m], and faces, shape (F, 3), indices of vertices.
Mesh = tuple[NDArray[np.floating], NDArray[np.int64]]

#: What two robots are called, and what that means.
Names = Sequence[tuple[str, str]]

#: Poses of two robots of which nothing was measured, and rows that are shown at most.
_POSES, MOST_ROWS = 24, 400

#: Faces that meet at less than this angle look like one smooth surface [rad].
_CREASE = np.deg2rad(35.0)

#: Radius of a stick figure's rods, as a part of the robot's size; poses that are looked at for what the shapes reach.
_STICK, _REACHED = 0.018, 60

#: The corners of a cube about the origin.
CORNERS = np.indices((2, 2, 2)).reshape(3, -1).T - 0.5


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What is shown: N poses, one of them at a time, and the marks of all of them. What is left out is filled in.

    Raises:
        ModelError: The robots have different joints.
    """

    nominal: Robot  #: The robot before calibration
    calibrated: Robot | None  #: The robot after it, the same chain; None to show one robot alone
    q: Array  #: shape (N, m), [rad] or [m], in the order of ``nominal.joint_names``
    labels: tuple[str, ...] = ()  #: What each pose is called, such as ``"row 31"``
    #: ``"estimation"``, ``"validation"``, ``"flagged"`` or, where nothing was measured, ``"pose"``
    kinds: tuple[str, ...] = ()
    #: shape (N, 4, 4) or (4, 4), T_tip_target of the nominal robot [m]
    nominal_target: Array = field(default_factory=lambda: np.eye(4))
    calibrated_target: Array = field(default_factory=lambda: np.eye(4))  #: Of the calibrated one
    #: shape (N, 4, 4) or (4, 4), base of the nominal robot in the calibrated one's [m]
    T_base_nominal: Array = field(default_factory=lambda: np.eye(4))
    #: shape (N, 3), the measured targets in the base [m]; NaN where nothing was measured
    measured: Array = field(default_factory=lambda: np.array(np.nan))
    #: shape (2, N), norm of each robot's residual of lengths [m]; NaN where none was measured
    errors: Array = field(default_factory=lambda: np.array(np.nan))
    angles: Array = field(default_factory=lambda: np.array(np.nan))  #: Of orientations [rad]
    #: shape (K, 4, 4), poses in the base of what the targets were seen with [m]
    instruments: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    start: int = 0  #: Which pose is shown first
    rows: int = 0  #: How many rows there are, where those shown are a choice; 0 where all are shown
    title: str = ""  #: The page's heading
    verdict: str = ""  #: What a calibration's verdict is
    note: str = ""  #: A sentence below the heading, such as the verdict's first reason
    #: What the two robots are called, and what that means
    names: Names = (("Nominal", "the URDF as given"), ("Calibrated", "the corrected URDF"))

    def __post_init__(self) -> None:
        """Fill in what was left out."""
        robot, other, count = self.nominal, self.calibrated, len(self.q)
        if other is not None and robot.joint_names != other.joint_names:
            raise ModelError(
                f"The nominal robot has the joints {choices(robot.joint_names)}, the calibrated one "
                f"{choices(other.joint_names)}. Show two robots with the same chain."
            )
        shapes = {"measured": (count, 3), "errors": (2, count), "angles": (2, count)}
        poses = ("nominal_target", "calibrated_target", "T_base_nominal")
        for name, shape in (shapes | dict.fromkeys(poses, (count, 4, 4))).items():
            object.__setattr__(self, name, np.broadcast_to(getattr(self, name), shape))
        labels = self.labels or tuple(f"pose {k + 1}" for k in range(count))
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "kinds", self.kinds or ("pose",) * count)

    @property
    def robots(self) -> dict[str, Robot]:
        """``"nominal"`` and, if there is one, ``"calibrated"``."""
        both = {"nominal": self.nominal}
        return both if self.calibrated is None else {**both, "calibrated": self.calibrated}

    @property
    def measures(self) -> bool:
        """Whether any row tells where the target was."""
        return bool(np.any(np.isfinite(self.measured)))

    @property
    def predicted(self) -> Array:
        """Where each robot puts the target, in the base, shape (2, N, 3), [m]; of one robot twice."""
        nominal = self.T_base_nominal @ self.nominal.poses(self.q) @ self.nominal_target
        other = (self.calibrated or self.nominal).poses(self.q) @ self.calibrated_target
        return np.array([nominal[:, :3, 3], other[:, :3, 3]])


def view_of(calibration: CalibrationValues) -> View:
    """The view of a calibration: every row a pose."""
    c, m = calibration, calibration.measurements
    before = Evaluation(c.nominal, m, c.nominal_setup, (), c.residual_nominal, c.used)
    after = Evaluation(c.robot, m, c.setup, (), c.residual_calibrated, c.used)
    shown = _at_rows(before, after, flagged_rows(c))
    return _judged(replace(shown, title=f"{c.nominal.name or 'Robot'}: nominal and calibrated"), c)


def view_of_result(
    result: CalibrationValues,
    robot: Robot,
    table: Measurements | None = None,
    cell: Cell | None = None,
    *,
    known: Sequence[str] = PLACES,
    source: str = "the result",
) -> View:
    """A robot with the origins before and after a result that was read from a file, at the rows of a table.

    Errors are those of the result's frames and targets, as `calib.evaluate` finds them; ``known`` says which of them
    the result has, not the cell. Without a table two robots go through poses over the joint limits. Rows that the fit
    flagged are marked if the table is the one that was fitted. ``source`` is what the result is called.
    """
    cell = cell or Cell()
    both = result.uncorrected(robot), result.corrected(robot)
    setups = result.nominal_setup, result.setup
    if table is None:
        shown = view_of_robots(*both, cells=(cell, cell))
        if "target" in known:
            first, second = (setup.T_tip_target[0] for setup in setups)
            shown = replace(shown, nominal_target=first, calibrated_target=second)
    else:
        before, after = (
            evaluate(one, table, cell, known=setup, which=tuple(known))
            for one, setup in zip(both, setups, strict=True)
        )
        rows = [one.row for one in (*result.outliers, *result.suspects)]
        same = result.source.sha256 == table.sha256
        shown = _at_rows(before, after, np.isin(table.rows, rows) & same)
    names = ("Nominal", "before the calibration"), ("Calibrated", f"joint origins of {source}")
    return _judged(replace(shown, names=names), result)


def view_of_robots(
    nominal: Robot,
    calibrated: Robot | None = None,
    table: Measurements | None = None,
    *,
    cells: Sequence[Cell] = (Cell(), Cell()),
    names: Names = (),
) -> View:
    """One or two robots at the rows of a table, with the errors that `calib.evaluate` finds.

    Without a table two robots go through poses spread over the joint limits, and one moves one joint after the other.
    ``cells`` have target and frame of each robot, where they are known; ``names`` what the robots are called, and what
    that means, by default nominal and calibrated, and their files.
    """
    robots = [nominal] if calibrated is None else [nominal, calibrated]
    title = nominal.name if calibrated is None else ""
    words = (title or "Nominal", "Calibrated")
    names = names or [(w, Path(r.urdf.source).name) for w, r in zip(words, robots, strict=False)]
    if table is not None:
        found = [evaluate(one, table, cell) for one, cell in zip(robots, cells, strict=False)]
        shown = _at_rows(found[0], found[1] if calibrated else None, np.zeros(len(table), bool))
        return replace(shown, names=names, title=title)
    if calibrated is None:
        q, labels = _one_joint_after_the_other(nominal)
    else:
        q = spread_poses(nominal, _POSES)
        labels = tuple(f"pose {k + 1} of {len(q)} over the joint limits" for k in range(len(q)))
    points = [next(iter(cell.targets.values()), cell.target) for cell in cells]
    targets = [translation((0.0, 0.0, 0.0) if p is None else p) for p in points]
    view = View(nominal, calibrated, q, labels, names=names, title=title)
    return replace(view, nominal_target=targets[0], calibrated_target=targets[-1])


def view_of_comparison(comparison: ComparisonValues) -> View:
    """The view of two results of one robot, with the first one's target, each in the base as its own fit has it.

    The poses are not measured ones: they are spread over the joint limits, and their labels say so.
    """
    c = comparison
    names = (f"a: {c.names[0]}", "the first result"), (f"b: {c.names[1]}", "the second result")
    title, target = f"{c.a.nominal.name or 'Robot'}: two calibrations", translation(c.a.target)
    view = view_of_robots(c.a.corrected(c.robot), c.b.corrected(c.robot), names=names)
    view = replace(view, nominal_target=target, calibrated_target=target)
    return replace(view, title=title, note=sentence(c))


def _judged(view: View, c: CalibrationValues) -> View:
    """The view with the verdict of a result and its first reason."""
    if c.verdict is None:
        return replace(view, note="No verdict: nothing was cross-validated.")
    note = " ".join(map(reason_text, c.verdict.reasons[:1]))
    return replace(view, verdict=c.verdict.use, note=note)


def _at_rows(first: Evaluation, second: Evaluation | None, flagged: Mask) -> View:
    """One or two robots at the rows of a table; of many rows at an even choice, with flagged ones.

    Shown first is the row where the nominal robot is furthest off, of the validation rows if there are any, flagged
    ones aside.
    """
    m, last, count = first.measurements, second or first, len(flagged)
    errors = np.array([lengths_of(one.residual, one.used) for one in (first, last)])
    angles = np.array([angles_of(one.residual, one.used) for one in (first, last)])
    rank = np.where(flagged, 0.0, np.where(m.validation, 2e6, 1e6))
    start = int(np.argmax(np.where(np.isfinite(errors[0]), rank + errors[0], -1.0)))
    at = np.arange(count)
    if count > MOST_ROWS:
        evenly = np.linspace(0, count - 1, MOST_ROWS - 50).round().astype(int)
        at = np.unique([start, *np.flatnonzero(flagged)[:49], *evenly])
    T_frame_nominal, nominal_target = setup_of_rows(first.setup, m)
    T_frame_base, calibrated_target = setup_of_rows(last.setup, m)
    T_base_frame = rigid_inverse(T_frame_base)
    # The error in the picture is then that of the tables, not where each of the two finds the tracker. Where nothing
    # tells a place, neither finds where it stands: the two share their base.
    places = np.any(m.where(lambda kind: kind.coordinates))
    T_base_nominal = T_base_frame @ T_frame_nominal if places else np.eye(4)
    elsewhere = ~np.all(np.isclose(T_base_frame, np.eye(4), 0.0, 1e-9), axis=(1, 2))
    kinds = np.where(flagged, "flagged", np.where(m.validation, "validation", "estimation"))
    return View(
        nominal=first.robot,
        calibrated=None if second is None else second.robot,
        q=m.joints_for(first.robot.joint_names)[at],
        labels=tuple(f"row {m.rows[k]}" for k in at),
        kinds=tuple(kinds[at].tolist()),
        nominal_target=nominal_target[at],
        calibrated_target=calibrated_target[at],
        T_base_nominal=np.broadcast_to(T_base_nominal, (count, 4, 4))[at],
        measured=measured_in_base(m, T_frame_base)[at],
        errors=errors[:, at],
        angles=angles[:, at],
        instruments=np.unique(T_base_frame[m.positions & elsewhere], axis=0),
        start=int(np.searchsorted(at, start)),
        rows=count if count > MOST_ROWS else 0,
    )


def _one_joint_after_the_other(robot: Robot) -> tuple[Array, tuple[str, ...]]:
    """Poses in which each joint in turn goes through its range, and what they are called."""
    ranges = column_ranges(robot)
    middle = np.clip(0.0, *ranges.T)
    poses, labels = [middle], ["all joints at zero, or as near as they can be"]
    for k, joint in enumerate(robot.inputs):
        scale, unit = (1e3, "mm") if joint.type == "prismatic" else (np.degrees(1.0), "deg")
        for value in np.linspace(ranges[k, 0], ranges[k, 1], 9):
            poses.append(np.where(np.arange(len(middle)) == k, value, middle))
            labels.append(f"{joint.name} at {scale * value:.4g} {unit}")
    return np.array(poses), tuple(labels)


class Visual(NamedTuple):
    """One shape of one link, at T_link_shape of shape (4, 4), [m]; None where its mesh cannot be found or read."""

    link: str
    T_link_shape: Array
    mesh: Mesh | None


def read_visuals(urdf: Urdf) -> tuple[tuple[Visual, ...], tuple[str, ...]]:
    """Every visual of every link, in the file's order, and a sentence for each that is not drawn as the URDF says."""
    folders = mesh_folders(urdf)
    visuals: list[Visual] = []
    warnings: dict[str, None] = {}
    for one in link_shapes(urdf, "visual"):
        if one.mesh is None:
            mesh = _solid(one)
            what, problem = "a visual", "" if mesh else "has no geometry that can be drawn"
        else:
            name, scale = one.mesh
            path, what = find_mesh(name, folders), f"the mesh '{name}'"
            mesh, problem = None, "was not found; a simple shape stands for it"
            if path is not None:
                mesh, problem = _mesh_file(path, scale)
        visuals.append(Visual(one.link, one.T_link_shape, mesh))
        warnings |= {f"link '{one.link}': {what} {problem}": None} if problem else {}
    return tuple(visuals), tuple(warnings)


@lru_cache(maxsize=64)
def _mesh_file(path: Path, scale: tuple[float, float, float]) -> tuple[Mesh | None, str]:
    """The triangles of a file, and what is wrong with them."""
    mesh, problem = read_mesh(path, scale)
    if mesh is None:
        return None, f"{problem}; a simple shape stands for it"
    return creased(*mesh), ""


def _solid(shape: LinkShape) -> Mesh | None:
    """A box, a sphere or a cylinder as triangles; a capsule is drawn as a cylinder."""
    sizes, make = shape.sizes, trimesh.creation
    if sizes is None:
        return None
    if shape.geometry.tag == "box":
        solid = make.box(sizes)
    elif shape.geometry.tag == "sphere":
        solid = make.icosphere(3, sizes[0])
    else:
        solid = make.cylinder(sizes[0], sizes[1])
    return creased(solid.vertices, solid.faces)


def creased(vertices: NDArray[np.floating], faces: NDArray[np.int64]) -> Mesh:
    """A mesh whose vertices on a crease are doubled, one for each smooth side: three.js smooths at each vertex."""
    mesh = trimesh.graph.smooth_shade(trimesh.Trimesh(vertices, faces), _CREASE, facet_minarea=None)
    return np.asarray(mesh.vertices, dtype=np.float32), np.asarray(mesh.faces)


class Puppet(NamedTuple):
    """What of one robot is drawn, and where it is at each pose."""

    links: tuple[
        str, ...
    ]  #: That move; the movers are these, then the frames of base, tip and target
    parts: list[
        tuple[int, Mesh, Array]
    ]  #: A mover's number, a mesh, and T_mover_shape, (4, 4), [m]
    rods: list[
        tuple[int, int]
    ]  #: Two movers with a rod from the origin of one to that of the other
    radius: float  #: Of the rods [m]
    poses: Array  #: shape (N, L, 4, 4), each mover in the scene at each pose [m]

    @classmethod
    def of(
        cls, robot: Robot, q: Array, visuals: Sequence[Visual], T_scene_base: Array, target: Array
    ) -> Puppet:
        """A robot at poses q, (N, m), standing at T_scene_base, (N, 4, 4), [m]; ``target`` is T_tip_target.

        Links whose mesh is missing, or all links of a robot without shapes, are rods from one to the next.
        """
        in_root = root_poses(robot, q)
        T_scene_root = T_scene_base @ rigid_inverse(in_root[robot.base])
        shown = {v.link for v in visuals if v.mesh is not None}
        sticks = {v.link for v in visuals if v.mesh is None} if shown else set(robot.urdf.links)
        joints = [joint for joint in robot.urdf.joints if joint.parent in sticks]
        needed = shown | sticks | {joint.child for joint in joints}
        links = tuple(link for link in robot.urdf.links if link in needed)
        # The robot's own forward kinematics put tip and target: those are the points that the tables speak of.
        T_tip = T_scene_base @ robot.poses(q)
        moved = [T_scene_root @ in_root[link] for link in links]
        poses = np.stack([*moved, T_scene_base, T_tip, T_tip @ target], axis=1)
        origins = [T[0, :3, 3] for T in in_root.values()]
        radius = _STICK * float(np.linalg.norm(np.ptp(origins, axis=0)))
        parts = [
            (links.index(v.link), v.mesh, v.T_link_shape) for v in visuals if v.mesh is not None
        ]
        rods = [(links.index(joint.parent), links.index(joint.child)) for joint in joints]
        return cls(links, parts, rods, radius, poses)

    def outline(self, poses: slice = slice(None)) -> Array:
        """Points that hold the robot at some poses: origins, and the corners of boxes about parts, (K, 3), [m]."""
        at = self.poses[poses]
        at = at[np.linspace(0, len(at) - 1, min(len(at), _REACHED)).round().astype(int)]
        points = [at[:, :, :3, 3].reshape(-1, 3)]
        for mover, (vertices, _), T in self.parts:
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            box = np.c_[0.5 * (low + high) + CORNERS * (high - low), np.ones(8)]
            points.append((at[:, mover] @ T @ box.T)[:, :3].swapaxes(1, 2).reshape(-1, 3))
        return np.concatenate(points)


def root_poses(robot: Robot, q: Array) -> dict[str, Array]:
    """T_root_link of every link of the URDF at poses of shape (N, m), by link, shape (N, 4, 4), [m]."""
    model = full_model(robot.urdf)
    data = model.createData()
    frames = [link_frame(model, link) for link in robot.urdf.links]
    poses = np.empty((len(q), len(frames), 4, 4))
    for n, configuration in enumerate(full_configurations(model, robot.urdf_values(q))):
        pin.framesForwardKinematics(model, data, configuration)
        poses[n] = [data.oMf[frame].homogeneous for frame in frames]
    return {link: poses[:, k] for k, link in enumerate(robot.urdf.links)}


def packed(poses: Array) -> NDArray[np.float32]:
    """Poses of shape (..., 4, 4), [m], as position and quaternion (x, y, z, w), shape (..., 7)."""
    flat = poses.reshape(-1, 4, 4)
    # A copy: SciPy before 1.14 takes no matrix that is read-only.
    turned = Rotation.from_matrix(flat[:, :3, :3].copy()).as_quat()
    both = np.concatenate([flat[:, :3, 3], turned], axis=1).astype(np.float32)
    return both.reshape(*poses.shape[:-2], 7)


def translation(offset: ArrayLike) -> Array:
    """A pose without rotation, shape (4, 4)."""
    T = np.eye(4)
    T[:3, 3] = offset
    return T
