"""The paper's UR3 and its table, virtual measurements of a UR3 with known errors, and scenes with any kind of row."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.basics.arrays import read_only
from calib.data.cell import Cell, GroupDistance
from calib.data.kinds import get
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, paper_measurements, paper_urdf
from calib.fit.registration.rows import Rows
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.gravity import GRAVITY, Payload, gravity_loads
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.kept import kept

#: Numbers of kinds in the registry.


@pytest.fixture(scope="session")
def table(ur3: Robot) -> Measurements:
    return Measurements.read(paper_measurements(), ur3.joint_names, ur3.joint_types)


@pytest.fixture(scope="session")
def paper_cell() -> Cell:
    return Cell(target=read_only(PAPER_TARGET), model="paper")


@pytest.fixture(scope="session")
def default_result(ur3: Robot, table: Measurements, paper_cell: Cell) -> Calibration:
    @kept
    def default() -> Calibration:
        return calibrate(ur3, table, cell=paper_cell)

    return default()


def point_rows(
    q: np.ndarray, points: np.ndarray, sigma: np.ndarray, poses: np.ndarray | None = None
) -> Rows:
    """Rows of points of one target in one frame."""
    n = len(q)
    poses = np.arange(n) if poses is None else poses
    return Rows(
        samples=Samples.at(q),
        kinds=(get("point"),),
        kind=np.zeros(n, dtype=int),
        measured=points,
        partner=np.full(n, -1),
        sigma={"m": sigma, "rad": np.full(n, 1e-3)},
        poses=poses,
        blocks=poses,
    )


@dataclass(frozen=True)
class VirtualUr3:
    """A UR3 that is wrong in a known way, and a tracker that sees its target."""

    kinematics: Kinematics
    is_length: np.ndarray

    def offsets(self, rng: np.random.Generator, length: float, angle: float) -> np.ndarray:
        return rng.normal(size=len(self.is_length)) * np.where(self.is_length, length, angle)

    def rows(self, rng: np.random.Generator, x: np.ndarray, count: int, noise: float) -> Rows:
        q = random_joint_values(self.kinematics.robot, count, int(rng.integers(2**31)))
        points = self.kinematics.points(x, q) + noise * rng.normal(size=(count, 3))
        return point_rows(q, points, np.full(count, 1e-4))

    def unseen(self) -> np.ndarray:
        return random_joint_values(self.kinematics.robot, 200, 99)


@pytest.fixture(scope="session")
def virtual(ur3: Robot) -> VirtualUr3:
    model = error_model(ur3, "paper")
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = PAPER_TARGET
    is_length = np.array([p.unit == "m" for p in model.parameters])
    return VirtualUr3(Kinematics(ur3, model, np.eye(4), T_tip_target), is_length)


def random_pose(rng: np.random.Generator, reach: float = 4.0) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    T[:3, 3] = rng.uniform(-reach, reach, 3)
    return T


@dataclass(frozen=True)
class Scene:
    """A wrong robot, frames and targets, and an instrument for every kind of row; all of it known.

    Frames and targets go by their numbers; groups are called "0", "1", ..., targets "t0", "t1", ...
    """

    kinematics: Kinematics
    x: np.ndarray
    rng: np.random.Generator
    noise: float = 0.0
    noise_angle: float = 0.0
    payload: Payload | None = None
    gravity: tuple[float, ...] = GRAVITY

    @property
    def robot(self) -> Robot:
        return self.kinematics.robot

    def samples(self, count: int, frame: int = 0, target: int = 0, q=None) -> Samples:
        if q is None:
            q = random_joint_values(self.robot, count, int(self.rng.integers(2**31)))
        load = gravity_loads(self.robot, q, self.payload, self.gravity)
        return Samples(np.asarray(q), np.full(len(q), frame), np.full(len(q), target), load)

    def tip(self, q: np.ndarray) -> np.ndarray:
        """T_base_tip of the true robot."""
        samples = self.samples(len(q), q=q)
        into_base = np.linalg.inv(self.kinematics.T_frame_base[0])
        T = self.kinematics.poses(self.x, samples)
        return into_base @ T @ np.linalg.inv(self.kinematics.T_tip_target[0])

    def points(self, count: int, frame: int = 0, target: int = 0) -> Measurements:
        samples = self.samples(count, frame, target)
        seen = self.kinematics.points(self.x, samples)
        return self._table(samples, "point", points=seen + self._noise(count, 3))

    def poses(self, count: int, frame: int = 0, target: int = 0) -> Measurements:
        samples = self.samples(count, frame, target)
        T = self.kinematics.poses(self.x, samples)
        turned = Rotation.from_rotvec(self.noise_angle * self.rng.normal(size=(count, 3)))
        return self._table(
            samples,
            "pose",
            points=T[:, :3, 3] + self._noise(count, 3),
            rotations=turned.as_matrix() @ T[:, :3, :3],
        )

    def distances(self, count: int, frame: int = 0, target: int = 0) -> Measurements:
        """Lengths from the frame's origin, which is the anchor."""
        samples = self.samples(count, frame, target)
        length = np.linalg.norm(self.kinematics.points(self.x, samples), axis=1)
        return self._table(samples, "distance", distances=length + self._noise(count))

    def pairs(self, count: int, frame: int = 0, target: int = 0) -> Measurements:
        """`count` pairs, 2 `count` rows."""
        samples = self.samples(2 * count, frame, target)
        points = self.kinematics.points(self.x, samples)
        length = np.linalg.norm(points[::2] - points[1::2], axis=1) + self._noise(count)
        words = tuple(f"{frame}{target}p{k // 2}" for k in range(2 * count))
        return self._table(samples, "pair", distances=np.repeat(length, 2), pairs=words)

    def fixed(self, count: int, frame: int = 0, target: int = 0) -> Measurements:
        """The target sits at the frame's origin, but for the noise."""
        q = self.reach(count, frame, target, [0, 1, 2])
        return self._table(self.samples(count, frame, target, q), "fixed")

    def plane(self, count: int, frame: int = 0, target: int = 0) -> Measurements:
        """The target touches the frame's x-y plane, but for the noise."""
        q = self.reach(count, frame, target, [2])
        return self._table(self.samples(count, frame, target, q), "plane")

    def reach(self, count: int, frame: int, target: int, axes: list[int]) -> np.ndarray:
        """Joint values that bring some coordinates of the target to 0, noise aside: Newton from random poses."""
        joints = len(self.robot.joint_names)
        found = np.zeros((0, joints))
        for _ in range(30):
            q = random_joint_values(self.robot, 2 * count, int(self.rng.integers(2**31)))
            goal = self._noise(len(q), len(axes))
            for _ in range(30):
                # All differences in one call.
                steps = np.vstack([np.zeros(joints), 1e-7 * np.eye(joints)])
                at = self._at((q + steps[:, None]).reshape(-1, joints), frame, target)
                here, *moved = at[:, axes].reshape(joints + 1, len(q), len(axes))
                J = np.stack([(there - here) / 1e-7 for there in moved], axis=2)
                step = np.einsum("nij,nj->ni", np.linalg.pinv(J, rcond=1e-3), here - goal)
                q = q - np.clip(step, -0.5, 0.5)
            left = np.abs(self._at(q, frame, target)[:, axes] - goal).max(axis=1)
            good = (left < 1e-12) & (np.abs(q).max(axis=1) < 2 * np.pi)
            found = np.vstack([found, q[good]])
            if len(found) >= count:
                return found[:count]
        raise AssertionError("The robot does not get there.")

    def _at(self, q, frame, target) -> np.ndarray:
        return self.kinematics.points(self.x, self.samples(len(q), frame, target, q))

    def _noise(self, *shape: int) -> np.ndarray:
        return self.noise * self.rng.normal(size=shape)

    def _table(self, samples: Samples, kind: str, **columns) -> Measurements:
        n = len(samples)
        columns = {"points": np.full((n, 3), np.nan)} | columns
        return Measurements(
            self.robot.joint_names,
            samples.q,
            kinds=(kind,) * n,
            groups=tuple(str(f) for f in samples.frame),
            targets=tuple(f"t{t}" for t in samples.target),
            **columns,
        )


def joined(*tables: Measurements) -> Measurements:
    """Several tables below each other."""
    optional = {}
    for name, shape in (("rotations", (3, 3)), ("distances", ())):
        if any(getattr(t, name) is not None for t in tables):
            parts = [(np.full((len(t), *shape), np.nan), getattr(t, name)) for t in tables]
            optional[name] = np.concatenate([one if v is None else v for one, v in parts])
    words = {
        name: sum((getattr(t, name) for t in tables), ())
        for name in ("kinds", "groups", "targets", "pairs")
    }
    return Measurements(
        tables[0].joint_names,
        np.concatenate([t.joints for t in tables]),
        np.concatenate([t.points for t in tables]),
        **words,
        **optional,
    )


def table_of_missed_stops(scene, count: int, targets: int) -> Measurements:
    """Targets of a scene at stops that the robot misses by ten times their own noise, all of a stop alike."""
    rng, q = np.random.default_rng(4), random_joint_values(scene.robot, count, 4)
    shift = 2e-4 * rng.normal(size=(count, 3))
    tables = []
    for target in range(targets):
        samples = scene.samples(count, 0, target, q)
        points = scene.kinematics.points(scene.x, samples) + shift
        points += 2e-5 * rng.normal(size=points.shape)
        tables.append(scene._table(samples, "point", points=points))
    return joined(*tables)


@pytest.fixture(scope="session")
def join() -> Callable[..., Measurements]:
    return joined


@pytest.fixture(scope="session")
def make_scene(ur3: Robot) -> Callable[..., Scene]:
    """A function that makes a scene: 3 mm and 10 mrad wrong, far frames, targets 0.3 m away, unless told otherwise."""

    def make(
        seed: int,
        *,
        frames: int | Sequence[np.ndarray] = 1,
        targets: int | Sequence[np.ndarray] = 1,
        robot: Robot = ur3,
        model: str = "dh",
        length: float = 3e-3,
        angle: float = 10e-3,
        noise: float = 0.0,
        noise_angle: float = 0.0,
        reach: float = 4.0,
        other: Mapping[str, float] | None = None,
        payload: Payload | None = None,
        gravity: Sequence[float] = GRAVITY,
    ) -> Scene:
        rng = np.random.default_rng(seed)
        if isinstance(frames, int):
            frames = [random_pose(rng, reach) for _ in range(frames)]
        if isinstance(targets, int):
            targets = [random_pose(rng, 0.0) for _ in range(targets)]
            for T in targets:
                direction = rng.normal(size=3)
                T[:3, 3] = 0.3 * direction / np.linalg.norm(direction)
        errors = error_model(
            robot,
            model,
            frame={str(k): () for k in range(len(frames))},
            target=False,
            targets=tuple(f"t{k}" for k in range(len(targets))),
            gravity=gravity,
        )
        size = np.where([u == "m" for u in errors.units], length, angle)
        for family, std in (other or {}).items():
            size[errors.family(family)] = std
        x = size * rng.normal(size=len(errors))
        kinematics = Kinematics(robot, errors, np.array(frames), np.array(targets))
        return Scene(kinematics, x, rng, noise, noise_angle, payload, tuple(gravity))

    return make


def place(xyz: Sequence[float], turn: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """A pose from a position and a rotation vector."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    T[:3, 3] = xyz
    return T


#: Where the base stands as seen from sockets and anchors in reach, from planes in reach, and from trackers.
SOCKETS = [place(-np.array(p)) for p in ([0.3, 0.1, 0.3], [-0.3, 0.2, 0.4], [0.1, -0.3, 0.5])]
PLANES = [
    place([0.0, 0.0, -0.2]),
    place([0.0, 0.1, -0.25], [1.2, 0.1, 0.0]),
    place([0.1, 0.0, -0.2], [-0.9, 0.8, 0.0]),
]
TRACKERS = [
    place([2.0, -1.0, 0.4], [0.1, 0.2, 2.0]),
    place([-2.0, 1.0, 0.3], [0.2, -0.1, -1.0]),
    place([0.5, 2.5, 0.2], [0.0, 0.3, 0.5]),
]
TARGETS = [place([0.05, 0.04, 0.16], [0.3, -0.2, 0.5]), place([-0.1, 0.06, 0.08], [0.1, 0.2, -0.3])]


def gaps(frames: Sequence[np.ndarray]) -> tuple[GroupDistance, ...]:
    """The distance between the first two sockets."""
    c = [-T[:3, :3].T @ T[:3, 3] for T in frames]
    return (GroupDistance("0", "1", float(np.linalg.norm(c[0] - c[1])), 1e-5),)


def every_sixth_validates(m: Measurements) -> Measurements:
    """Some rows held back, of a pair both or none."""
    number = np.arange(len(m)) // (2 if any(m.pairs) else 1)
    return replace(m, sets=tuple("validate" if k % 6 == 5 else "estimate" for k in number))


def _mixed(make):
    scene = make(41, frames=[TRACKERS[0], SOCKETS[1], PLANES[2], SOCKETS[0]], noise_angle=1e-4)
    tables = [scene.poses(15), scene.points(15), scene.fixed(12, 1), scene.plane(18, 2)]
    return scene, joined(*tables, scene.distances(18, 3), scene.pairs(6)), Cell(estimate_frame=True)


def _compliance(make):
    payload, gravity = Payload(5.0, np.array([0.0, 0.02, 0.1])), np.array([0.0, 1.0, -9.75])
    bent = {"model": "dh+compliance", "other": {"compliance": 3e-5}}
    scene = make(43, frames=BASE, targets=TARGETS, payload=payload, gravity=gravity, **bent)
    cell = Cell(payload=payload, gravity=gravity, model="dh+compliance")
    return scene, two_targets(scene.points), cell


def _gravity(make):
    """Hung from the ceiling."""
    gravity = np.array([0.0, 0.0, 9.81])
    scene = make(46, frames=BASE, gravity=gravity, model="dh+gravity", other={"gravity": 2e-3})
    return scene, scene.points(60), Cell(gravity=gravity, model="dh+gravity")


def _held(make):
    held = {"wrist_2_joint": 0.8}
    robot = Robot.load(paper_urdf(), base="base", tip="tool0", held=held)
    scene = make(44, frames=BASE, robot=robot, model="dh+gain", other={"gain": 1e-3})
    return scene, scene.points(76), Cell(held=held, model="zeros+gain")


def two_targets(kind, count=40) -> Measurements:
    return joined(kind(count), kind(count, target=1))


def in_each(kind, count, frames=3) -> Measurements:
    return joined(*(kind(count, f) for f in range(frames)))


BASE, FREE = [np.eye(4)], Cell(estimate_frame=True)
GIVEN = Cell(frames={str(f): TRACKERS[f] for f in range(2)})

#: A scene, its table and its cell for every kind of measurement, several targets and set-ups, and non-geometric models.
CASES = {
    "points": lambda make: (s := make(31, frames=BASE), s.points(76), Cell()),
    "poses": lambda make: (s := make(32, frames=TRACKERS[:1], noise_angle=1e-4), s.poses(76), FREE),
    "targets": lambda make: (
        s := make(33, frames=BASE, targets=TARGETS),
        two_targets(s.points),
        Cell(),
    ),
    "turned targets": lambda make: (
        s := make(34, frames=BASE, targets=TARGETS, noise_angle=1e-4),
        two_targets(s.poses, 38),
        Cell(),
    ),
    "set-ups": lambda make: (s := make(35, frames=TRACKERS), in_each(s.points, 30), FREE),
    "known set-ups": lambda make: (
        s := make(36, frames=TRACKERS[:2]),
        in_each(s.points, 40, 2),
        GIVEN,
    ),
    "distances": lambda make: (s := make(37, frames=SOCKETS), in_each(s.distances, 48), Cell()),
    "pairs": lambda make: (s := make(38, frames=BASE), s.pairs(76), Cell()),
    "sockets": lambda make: (
        s := make(39, frames=SOCKETS),
        in_each(s.fixed, 24),
        Cell(distances=gaps(SOCKETS)),
    ),
    "planes": lambda make: (s := make(40, frames=PLANES), in_each(s.plane, 40), Cell()),
    "mixed": _mixed,
    "gain": lambda make: (
        s := make(42, frames=TRACKERS[:1], model="dh+gain", other={"gain": 1e-3}),
        s.points(76),
        FREE,
    ),
    "compliance": _compliance,
    "gravity": _gravity,
    "held": _held,
}


@pytest.fixture(scope="session")
def calibrated(make_scene: Callable[..., Scene]) -> Callable[[str], tuple[Scene, Calibration]]:
    """A function that gives the scene of one of `CASES` and its calibration; each is fitted once."""

    def make(seed: int, **given: Any) -> Scene:
        usual = {"targets": TARGETS[:1], "length": 3e-4, "angle": 3e-3, "noise": 2e-5}
        return make_scene(seed, **(usual | given))

    @kept
    def run(name: str) -> tuple[Scene, Calibration]:
        scene, table, cell = CASES[name](make)
        return scene, calibrate(scene.robot, every_sixth_validates(table), cell=cell)

    return run


@pytest.fixture(params=CASES, scope="session")
def case(
    request: pytest.FixtureRequest, calibrated: Callable[[str], tuple[Scene, Calibration]]
) -> tuple[Scene, Calibration]:
    """Each of `CASES` in turn; of the session, so that all tests of one case follow each other on one worker."""
    return calibrated(request.param)
