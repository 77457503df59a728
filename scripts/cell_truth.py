"""True cells of `cell_study.py`, by Pinocchio alone: robots of several limbs, what stands on their links, what is seen.

Every joint placement of the true robot is off, those of shared joints too. Nothing of calib's kinematics is used.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, Mask
from calib.data.measurements import Measurements

#: Standard deviation of the errors of placements that are lengths [m].
LENGTH = 0.5e-3

#: Standard deviation of those that are angles [rad].
ANGLE = 3e-3

#: Joints are moved between these values, or their limits [rad or m].
LARGEST = 2.0

#: Corners of a board with so many squares of 50 mm to each side [m].
_CORNERS = np.array([[0.05 * i, 0.05 * j, 0.0] for i in range(4) for j in range(3)])

#: Focal length and principal point of the cameras [px], and size of their images.
FOCAL = 1000.0
SIZE = (1280, 960)

#: Poses are drawn this share of the way from the posture at which the camera was aimed to any other.
_AROUND = 0.35

#: Cosine of the largest angle between a camera's line of sight and its boards.
_WITHIN = 0.93

#: The farthest board that is detected [m], and the steepest view of it (cosine).
_FARTHEST = 1.5
_STEEPEST = 0.4


@dataclass(frozen=True, eq=False)
class TrueCell:
    """A true robot, and frames and targets on its links."""

    #: The nominal URDF.
    nominal: pin.Model
    #: The true robot.
    true: pin.Model
    #: Links and poses in them, (4, 4) [m], of measurement frames.
    frames: Mapping[str, tuple[str, pin.SE3]]
    #: Links and poses in them of targets.
    targets: Mapping[str, tuple[str, pin.SE3]]
    #: Joints that move.
    joints: list[str] = field(init=False)
    #: Their limits, (n,) each [rad or m].
    _limits: tuple[Array, Array] = field(init=False)
    #: Pinocchio's own memory of the nominal and the true robot: as much as a pose takes otherwise.
    _data: tuple[pin.Data, pin.Data] = field(init=False)
    #: For each camera that is aimed the posture at which it is, (n,).
    _postures: dict[str, Array] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        """List the joints between the links."""
        supports = [set(self._supports(link)) for link in self.links]
        common = set.intersection(*supports)
        moving = sorted(set.union(*supports) - common)
        object.__setattr__(self, "joints", [self.true.names[j] for j in moving])
        limits = []
        for joint in (self.true.joints[j] for j in moving):
            lower, upper = -LARGEST, LARGEST
            if joint.nq == 1:
                lower = max(self.true.lowerPositionLimit[joint.idx_q], lower)
                upper = min(self.true.upperPositionLimit[joint.idx_q], upper)
            limits.append((lower, upper))
        object.__setattr__(self, "_limits", tuple(np.array(limits).T))
        object.__setattr__(self, "_data", (self.nominal.createData(), self.true.createData()))

    @property
    def links(self) -> list[str]:
        """The links that something stands on."""
        return [link for link, _ in (*self.frames.values(), *self.targets.values())]

    def _supports(self, link: str) -> list[int]:
        """Return the numbers of the joints from the root to a link."""
        parent = self.true.frames[self.true.getFrameId(link)].parentJoint
        return [j for j in self.true.supports[parent] if j > 0]

    def needed(self, frame: str, target: str) -> Mask:
        """Return which joints lie between a frame and a target, shape (n,)."""
        ends = self.frames[frame][0], self.targets[target][0]
        between = set(self._supports(ends[0])) ^ set(self._supports(ends[1]))
        return np.array([self.true.getJointId(name) in between for name in self.joints])

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Draw joint values, shape (count, n), [rad] or [m]."""
        return rng.uniform(*self._limits, (count, len(self.joints)))

    def fresh(self, rng: np.random.Generator, frame: str, count: int) -> Array:
        """Draw joint values, (count, n), at which to predict what a frame sees: of a camera those near its posture."""
        values = self.draw(rng, count)
        if frame not in self._postures:
            return values
        around = self._postures[frame]
        near: Array = around + _AROUND * (values - around)
        return near

    def configuration(self, values: Array) -> Array:
        """Return Pinocchio's configuration of joint values, (n,)."""
        q: Array = pin.neutral(self.true)
        for name, value in zip(self.joints, values, strict=True):
            joint = self.true.joints[self.true.getJointId(name)]
            if joint.nq == 1:
                q[joint.idx_q] = value
            else:
                q[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
        return q

    def pose(self, values: Array, frame: str, target: str, *, nominal: bool = False) -> pin.SE3:
        """Return T_frame_target at joint values, (n,)."""
        model, data = (self.nominal if nominal else self.true), self._data[0 if nominal else 1]
        pin.forwardKinematics(model, data, self.configuration(values))
        (base, T_base_frame), (tip, T_tip_target) = self.frames[frame], self.targets[target]
        T_world_base = pin.updateFramePlacement(model, data, model.getFrameId(base))
        T_world_tip = pin.updateFramePlacement(model, data, model.getFrameId(tip))
        T_base_tip = T_world_base.inverse() * T_world_tip
        return T_base_frame.inverse() * T_base_tip * T_tip_target

    def aimed(self, rng: np.random.Generator, seen: Iterable[tuple[str, str]]) -> TrueCell:
        """Return the cell with cameras that look at their boards, and boards that face them, at one posture.

        A camera stays where it is and turns; a board turns about its own origin.
        """
        boards: dict[str, list[str]] = {}
        for frame, target in seen:
            boards.setdefault(frame, []).append(target)
        frames, targets = dict(self.frames), dict(self.targets)
        for frame, names in boards.items():
            while True:
                values = self.draw(rng, 1)[0]
                poses = [self.pose(values, frame, name) for name in names]
                towards = [pose.translation / np.linalg.norm(pose.translation) for pose in poses]
                far = [float(np.linalg.norm(pose.translation)) for pose in poses]
                middle = np.mean(towards, axis=0)
                spread = min(float(t @ middle) for t in towards) / np.linalg.norm(middle)
                if min(far) > 0.45 and max(far) < 1.1 and spread > _WITHIN:
                    break
            # The camera's z axis goes through the middle.
            turn = pin.SE3(_rotation_to(middle), np.zeros(3))
            link, T_link_frame = frames[frame]
            frames[frame] = (link, T_link_frame * turn)
            for name, pose in zip(names, poses, strict=True):
                seen_pose = turn.inverse() * pose
                facing = seen_pose.rotation.T  # the board's axes along the camera's
                link, T_link_target = targets[name]
                tilt = pin.exp3(0.3 * rng.standard_normal(3))
                targets[name] = (link, T_link_target * pin.SE3(facing @ tilt, np.zeros(3)))
            object.__setattr__(self, "_postures", {**self._postures, frame: values})
        result = TrueCell(self.nominal, self.true, frames, targets)
        object.__setattr__(result, "_postures", self._postures)
        return result

    # What is measured

    def points(
        self, rng: np.random.Generator, seen: Iterable[tuple[str, str]], count: int, sigma: float
    ) -> Measurements:
        """Return measured positions of targets, ``count`` from each frame of each target, with noise [m]."""
        parts = []
        for frame, target in seen:
            q = self.draw(rng, count)
            p = np.array([self.pose(row, frame, target).translation for row in q])
            noisy = p + sigma * rng.standard_normal(p.shape)
            parts.append(self._table(q, frame, target, "point", points=noisy))
        return joined(parts)

    def pixels(
        self, rng: np.random.Generator, seen: Iterable[tuple[str, str]], count: int, sigma: float
    ) -> Measurements:
        """Return images of boards, ``count`` from each camera of each board, with noise [px]."""
        parts = []
        for frame, target in seen:
            q: list[Array] = []
            u: list[Array] = []
            while len(q) < count:
                values = self.fresh(rng, frame, 1)[0]
                image = self.image(self.pose(values, frame, target))
                if image is not None:
                    q.append(values)
                    u.append(image)
            corners = len(_CORNERS)
            noisy = np.concatenate(u) + sigma * rng.standard_normal((count * corners, 2))
            names = [f"{frame}_{target}_{k}" for k in range(count)]
            parts.append(
                self._table(
                    np.repeat(q, corners, axis=0),
                    frame,
                    target,
                    "pixel",
                    readings={"u": noisy[:, 0], "v": noisy[:, 1]},
                    board_points=np.tile(_CORNERS, (count, 1)),
                    images=tuple(np.repeat(names, corners).tolist()),
                    corners=tuple(str(k) for k in range(corners)) * count,
                )
            )
        return joined(parts)

    def image(self, T: pin.SE3) -> Array | None:
        """Return the image of each corner, (corners, 2) [px]; None if the board is not wholly seen."""
        P = _CORNERS @ T.rotation.T + T.translation
        towards = -T.rotation[:, 2] @ (P.mean(axis=0) / np.linalg.norm(P.mean(axis=0)))
        if np.any(P[:, 2] < 0.1) or P[:, 2].max() > _FARTHEST or abs(towards) < _STEEPEST:
            return None
        u: Array = FOCAL * P[:, :2] / P[:, 2:] + np.array(SIZE) / 2.0
        return u if np.all((u > 0.0) & (u < SIZE)) else None

    def contacts(
        self,
        rng: np.random.Generator,
        frame: str,
        targets: Sequence[str],
        count: int,
        kind: str = "fixed",
        sigma: float = 0.0,
    ) -> Measurements:
        """Return rows of targets held by a frame, ``count`` of each target, with noise of the joint values [rad].

        The kind is ``fixed`` (the target is at the origin), ``face`` (flat on the x-y plane) or ``clasp`` (in the pose
        of the frame).
        """
        parts = []
        for target in targets:
            q = np.array([self._reach(rng, frame, target, kind) for _ in range(count)])
            noise = sigma * rng.standard_normal(q.shape) * self.needed(frame, target)
            parts.append(self._table(q + noise, frame, target, kind))
        return joined(parts)

    def _miss(self, values: Array, frame: str, target: str, kind: str) -> Array:
        """Return by how much a target misses how it is to be held at joint values, (n,), [m] and [rad]."""
        T = self.pose(values, frame, target)
        if kind == "face":
            return np.array([T.translation[2], T.rotation[0, 2], T.rotation[1, 2]])
        if kind == "clasp":
            return np.asarray(pin.log6(T).vector)
        return np.asarray(T.translation)

    def _reach(self, rng: np.random.Generator, frame: str, target: str, kind: str) -> Array:
        """Draw joint values, (n,), at which a target is held by a frame, by Newton's method."""
        moves = self.needed(frame, target)
        while True:
            values = self.draw(rng, 1)[0]
            for _ in range(60):
                p = self._miss(values, frame, target, kind)
                if np.abs(p).max() < 1e-14:
                    break
                J = np.zeros((len(p), len(values)))
                for k in np.flatnonzero(moves):
                    step = np.zeros(len(values))
                    step[k] = 1e-6
                    ahead = self._miss(values + step, frame, target, kind)
                    behind = self._miss(values - step, frame, target, kind)
                    J[:, k] = (ahead - behind) / 2e-6
                change = -np.linalg.pinv(J) @ p
                values = values + change * min(1.0, 0.3 / max(np.abs(change).max(), 1e-12))
            if np.abs(p).max() < 1e-13 and np.abs(values).max() < LARGEST + 1.0:
                reached: Array = values
                return reached

    def _table(
        self, q: Array, frame: str, target: str, kind: str, **measured: object
    ) -> Measurements:
        """Return rows of one kind of a target seen from a frame, without the values of joints beside its chain."""
        count = len(q)
        arguments: dict[str, object] = {"points": np.full((count, 3), np.nan), **measured}
        return Measurements(
            joint_names=tuple(self.joints),
            joints=q,
            groups=(frame,) * count,
            targets=(target,) * count,
            kinds=(kind,) * count,
            without_joint=np.tile(~self.needed(frame, target), (count, 1)),
            prismatic=tuple(
                name
                for name in self.joints
                if self.true.joints[self.true.getJointId(name)]
                .shortname()
                .startswith("JointModelP")
            ),
            **arguments,  # type: ignore[arg-type]
        )


def joined(parts: Sequence[Measurements]) -> Measurements:
    """Return tables of the same joints below each other; what a row does not measure is NaN."""
    counts = [len(part) for part in parts]
    readings = sorted({name for part in parts for name in part.readings})

    def stacked(name: str, width: int) -> Array | None:
        """Return an array of all tables, NaN for those without it; None if none has it."""
        arrays = [getattr(part, name) for part in parts]
        if all(array is None for array in arrays):
            return None
        blank = [np.full((n, width), np.nan) for n in counts]
        return np.concatenate([b if a is None else a for a, b in zip(arrays, blank, strict=True)])

    def words(name: str) -> tuple[str, ...]:
        return tuple(word for part in parts for word in getattr(part, name))

    nothing = [np.full(n, np.nan) for n in counts]
    without = [
        np.zeros(part.joints.shape, dtype=bool)
        if part.without_joint is None
        else part.without_joint
        for part in parts
    ]
    return Measurements(
        joint_names=parts[0].joint_names,
        joints=np.concatenate([part.joints for part in parts]),
        points=np.concatenate([part.points for part in parts]),
        groups=words("groups"),
        targets=words("targets"),
        kinds=words("kinds"),
        images=words("images"),
        corners=words("corners"),
        board_points=stacked("board_points", 3),
        readings={
            name: np.concatenate(
                [part.readings.get(name, blank) for part, blank in zip(parts, nothing, strict=True)]
            )
            for name in readings
        },
        prismatic=parts[0].prismatic,
        without_joint=np.concatenate(without),
    )


def draw_cell(
    urdf: str,
    rng: np.random.Generator,
    frames: Mapping[str, str],
    targets: Mapping[str, str],
    poses: Mapping[str, pin.SE3],
    mounts: Mapping[str, pin.SE3] | None = None,
) -> TrueCell:
    """Draw a true robot.

    Args:
        urdf: The nominal URDF's text.
        rng: Random numbers.
        frames: Link of each measurement frame, by its name.
        targets: Link of each target, by its name.
        poses: Pose of frames and targets in their links; those of others are drawn: frames within a metre, targets
            within 0.1 m and turned anyhow.
        mounts: True poses of fixed joints in their parent links, by the joints' names.
    """
    nominal = pin.buildModelFromXML(urdf)
    true = pin.Model(nominal)
    for name, pose in (mounts or {}).items():
        _move_fixed_joint(true, name, pose)
    for j in range(1, true.njoints):
        twist = np.r_[LENGTH * rng.standard_normal(3), ANGLE * rng.standard_normal(3)]
        true.jointPlacements[j] = true.jointPlacements[j] * pin.exp6(twist)

    def drawn(name: str, far: float, turn: float) -> pin.SE3:
        """Return a given pose, or one that is drawn within a distance and turn."""
        if name in poses:
            return poses[name]
        return pin.SE3(pin.exp3(turn * rng.standard_normal(3)), far * rng.uniform(-1.0, 1.0, 3))

    return TrueCell(
        nominal=nominal,
        true=true,
        frames={name: (link, drawn(name, 1.0, 1.0)) for name, link in frames.items()},
        targets={name: (link, drawn(name, 0.1, 0.5)) for name, link in targets.items()},
    )


def _rotation_to(direction: Array) -> Array:
    """Return a rotation, (3, 3), that takes z to a direction, (3,)."""
    z = direction / np.linalg.norm(direction)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _move_fixed_joint(model: pin.Model, name: str, pose: pin.SE3) -> None:
    """Move everything that hangs on a fixed joint of the root: its joints, and the frames between."""
    frame = model.frames[model.getFrameId(name)]
    change = pose * frame.placement.inverse()
    below = {model.getFrameId(name)}
    for k, other in enumerate(model.frames):
        if other.parentJoint == 0 and other.parentFrame in below:
            below.add(k)
    for k in below:
        model.frames[k].placement = change * model.frames[k].placement
    for j in range(1, model.njoints):
        is_below = model.frames[model.getFrameId(model.names[j])].parentFrame in below
        if model.parents[j] == 0 and is_below:
            model.jointPlacements[j] = change * model.jointPlacements[j]
