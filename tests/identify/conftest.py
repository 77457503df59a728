"""The paper's UR3 and its table, virtual measurements of a UR3 with known errors, and scenes with any kind of row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data import PAPER_TARGET, paper_measurements, paper_urdf
from calib.identify.calibration import Calibration, calibrate
from calib.identify.rows import POINT, Rows
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples
from calib.model.readback import random_joint_values
from calib.model.robot import Robot, read_only


@pytest.fixture(scope="session")
def ur3() -> Robot:
    return Robot.load(paper_urdf(), base="base", tip="tool0")


@pytest.fixture(scope="session")
def table(ur3: Robot) -> Measurements:
    return Measurements.read(paper_measurements(), ur3.joint_names, ur3.joint_types)


@pytest.fixture(scope="session")
def paper_cell() -> Cell:
    return Cell(target=read_only(PAPER_TARGET), model="paper")


@pytest.fixture(scope="session")
def default_result(ur3: Robot, table: Measurements, paper_cell: Cell) -> Calibration:
    return calibrate(ur3, table, cell=paper_cell)


def point_rows(
    q: np.ndarray, points: np.ndarray, sigma: np.ndarray, poses: np.ndarray | None = None
) -> Rows:
    """Rows of points of one target in one frame."""
    n = len(q)
    poses = np.arange(n) if poses is None else poses
    return Rows(
        samples=Samples.at(q),
        kinds=np.full(n, POINT),
        points=points,
        rotations=np.tile(np.eye(3), (n, 1, 1)),
        distances=np.zeros(n),
        partner=np.full(n, -1),
        sigma=sigma,
        sigma_angle=np.full(n, 1e-3),
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

    @property
    def robot(self) -> Robot:
        return self.kinematics.robot

    def samples(self, count: int, frame: int = 0, target: int = 0, q=None) -> Samples:
        if q is None:
            q = random_joint_values(self.robot, count, int(self.rng.integers(2**31)))
        return Samples(np.asarray(q), np.full(len(q), frame), np.full(len(q), target))

    def tip(self, q: np.ndarray) -> np.ndarray:
        """T_base_tip of the true robot."""
        samples = self.samples(len(q), q=q)
        into_base = np.linalg.inv(self.kinematics.T_frame_base[0])
        return (
            into_base
            @ self.kinematics.poses(self.x, samples)
            @ np.linalg.inv(self.kinematics.T_tip_target[0])
        )

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
        found = np.zeros((0, len(self.robot.joint_names)))
        for _ in range(30):
            q = random_joint_values(self.robot, 2 * count, int(self.rng.integers(2**31)))
            goal = self._noise(len(q), len(axes))
            for _ in range(60):
                miss = self._at(q, frame, target)[:, axes] - goal
                J = np.stack([self._slope(q, e, frame, target)[:, axes] for e in np.eye(6)], axis=2)
                step = np.einsum("nij,nj->ni", np.linalg.pinv(J, rcond=1e-3), miss)
                q = q - np.clip(step, -0.3, 0.3)
            left = np.abs(self._at(q, frame, target)[:, axes] - goal).max(axis=1)
            good = (left < 1e-12) & (np.abs(q).max(axis=1) < 2 * np.pi)
            found = np.vstack([found, q[good]])
            if len(found) >= count:
                return found[:count]
        raise AssertionError("The robot does not get there.")

    def _slope(self, q, along, frame, target) -> np.ndarray:
        step = 1e-6 * along
        ahead, behind = self._at(q + step, frame, target), self._at(q - step, frame, target)
        return (ahead - behind) / 2e-6

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
            optional[name] = np.concatenate(
                [
                    np.full((len(t), *shape), np.nan)
                    if getattr(t, name) is None
                    else getattr(t, name)
                    for t in tables
                ]
            )
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
        )
        size = np.where([u == "m" for u in errors.units], length, angle)
        x = size * rng.normal(size=len(errors))
        kinematics = Kinematics(robot, errors, np.array(frames), np.array(targets))
        return Scene(kinematics, x, rng, noise, noise_angle)

    return make
