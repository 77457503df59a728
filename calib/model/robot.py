"""Robot: an immutable kinematic chain, from one link of a URDF to another, over Pinocchio.

The chain's moving joints are numbered 1 to n from base to tip. Its geometry is n + 1 *placements*: the
pose of joint i in the frame of the joint before it, and the pose of the tip in the frame of joint n:

    T_base_tip(q) = T_root_base^-1  P_1 J_1(q_1)  P_2 J_2(q_2) ... P_n J_n(q_n)  P_tip

Every correction is a change of these placements, and each placement is carried by the ``<origin>`` of one
URDF joint, so that a corrected robot and a corrected URDF are the same thing.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError, UrdfError, choices
from calib.model.urdf import Urdf, UrdfJoint

#: Names of a tip, in the order of preference, where several links lie equally far out.
_USUAL_TIPS = ("tool0", "tcp", "tool", "flange", "ee_link")

_MOVING = ("revolute", "continuous", "prismatic")

#: What stands before the links' names in the Pinocchio model.
_LINK = "link:"


@dataclass(frozen=True, slots=True)
class Robot:
    """A serial chain of a URDF, immutable: a changed robot is a new one. Two are equal when URDF, base and tip are.

    Attributes:
        urdf: The URDF that describes this robot; always in step with ``placements``.
        base: Link in whose frame poses are given.
        tip: Link whose pose is given.
        joints: The chain's moving joints, base to tip, n of them.
        placements: shape (n + 1, 4, 4), [m]; see the module's text. The last one is the tip's.
        carriers: For each placement the URDF joint whose ``<origin>`` holds it; None for the tip of a
            chain that ends with a moving joint.
        T_root_base: shape (4, 4), [m], pose of the base in the URDF's root link.
    """

    urdf: Urdf
    base: str
    tip: str
    joints: tuple[UrdfJoint, ...] = field(compare=False)
    placements: NDArray[np.float64] = field(compare=False)
    carriers: tuple[str | None, ...] = field(compare=False)
    T_root_base: NDArray[np.float64] = field(compare=False)
    _before: NDArray[np.float64] = field(repr=False, compare=False)
    _after: NDArray[np.float64] = field(repr=False, compare=False)
    _model: pin.Model = field(repr=False, compare=False)

    @classmethod
    def load(
        cls,
        source: str | Path,
        base: str | None = None,
        tip: str | None = None,
        measured: Collection[str] | None = None,
    ) -> Robot:
        """Load a robot from a URDF file, or by its name from example-robot-data.

        Args:
            source: Path of a URDF, or a name such as ``"ur3"`` or ``"panda"``.
            base: Link in whose frame the poses are given; default the URDF's root link.
            tip: Link that the chain ends at; default the link with the most moving joints before it.
            measured: Names of the joints whose values are known; a tip that is not given is then chosen so that the
                chain has only these, if there is such a link.

        Raises:
            UrdfError: No such file, robot, link, or a chain that calib cannot take.

        Example:
            >>> Robot.load("ur3", base="base", tip="tool0").joint_names[0]
            'shoulder_pan_joint'
        """
        return cls.from_urdf(Urdf.read(find_urdf(source)), base, tip, measured)

    @classmethod
    def from_urdf(
        cls,
        urdf: Urdf,
        base: str | None = None,
        tip: str | None = None,
        measured: Collection[str] | None = None,
    ) -> Robot:
        """The chain from ``base`` to ``tip`` of a URDF that has been read; see `load`."""
        base = urdf.root if base is None else base
        tip = _farthest_link(urdf, base, measured) if tip is None else tip
        to_base, to_tip = urdf.chain(base, tip)
        by_name = {joint.name: joint for joint in urdf.joints}
        _check_base_is_rigid(urdf, base, tip, [by_name[name] for name in to_base])
        joints = tuple(by_name[name] for name in to_tip if by_name[name].type != "fixed")
        _check_moving(urdf, base, tip, joints)

        model = _chain_model(urdf, joints)
        T_root_base = _link_placement(model, base)
        placements = [model.jointPlacements[i + 1].homogeneous for i in range(len(joints))]
        placements.append(_link_placement(model, tip))

        names = list(to_tip)
        after_last = names[names.index(joints[-1].name) + 1 :]
        carriers = [joint.name for joint in joints] + ([after_last[0]] if after_last else [None])
        before, after = [], []
        for placement, carrier in zip(placements, carriers, strict=True):
            origin = np.eye(4) if carrier is None else by_name[carrier].T_parent_joint
            is_tip = placement is placements[-1]
            before.append(np.eye(4) if is_tip else placement @ rigid_inverse(origin))
            after.append(rigid_inverse(origin) @ placement if is_tip else np.eye(4))
        return cls(
            urdf=urdf,
            base=base,
            tip=tip,
            joints=joints,
            placements=read_only(placements),
            carriers=tuple(carriers),
            T_root_base=read_only(T_root_base),
            _before=read_only(before),
            _after=read_only(after),
            _model=model,
        )

    def __repr__(self) -> str:
        """In one line, such as ``Robot('ur3', base to tool0, 6 joints)``."""
        return f"Robot('{self.name}', {self.base} to {self.tip}, {len(self.joints)} joints)"

    @property
    def name(self) -> str:
        """The robot's name in the URDF."""
        return self.urdf.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The names of the moving joints, base to tip."""
        return tuple(joint.name for joint in self.joints)

    @property
    def joint_types(self) -> dict[str, str]:
        """For each moving joint its URDF type: revolute, continuous or prismatic."""
        return {joint.name: joint.type for joint in self.joints}

    def poses(self, q: ArrayLike) -> NDArray[np.float64]:
        """T_base_tip at joint values.

        Args:
            q: shape (N, n) or (n,), [rad] or [m], in the order of ``joint_names``.

        Returns:
            shape (N, 4, 4), [m].
        """
        T_root_last = last_joint_poses(self._model, self.configurations(q))
        result: NDArray[np.float64] = (
            rigid_inverse(self.T_root_base) @ T_root_last @ self.placements[-1]
        )
        return result

    def configurations(self, q: ArrayLike) -> NDArray[np.float64]:
        """Joint values as Pinocchio's configuration vectors, shape (N, nq).

        A ``continuous`` joint has the two entries (cos q, sin q) there.

        Raises:
            ModelError: ``q`` has not one column for each joint.
        """
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        if values.ndim != 2 or values.shape[1] != len(self.joints):
            message = (
                f"Joint values of shape {np.shape(q)} were given; the chain '{self.base}' to "
                f"'{self.tip}' has {len(self.joints)} joints: {choices(self.joint_names)}."
            )
            raise ModelError(message)
        if not np.all(np.isfinite(values)):
            row, joint = np.argwhere(~np.isfinite(values))[0]
            message = (
                f"Joint values must be finite numbers; that of '{self.joints[joint].name}' in row {row + 1} is "
                f"{values[row, joint]}."
            )
            raise ModelError(message)
        if self._model.nq == len(self.joints):
            return values
        columns: list[NDArray[np.float64]] = []
        for i, size in enumerate(self._model.nqs[1:]):
            value = values[:, i]
            columns += [value] if size == 1 else [np.cos(value), np.sin(value)]
        return np.stack(columns, axis=1)

    def chain_model(self, placements: NDArray[np.float64]) -> pin.Model:
        """A Pinocchio model of the chain with other joint placements, a copy of its own.

        Args:
            placements: shape (n, 4, 4) or (n + 1, 4, 4), [m]; a tip's placement is not part of it.
        """
        model = self._model.copy()
        for i in range(len(self.joints)):
            model.jointPlacements[i + 1] = pin.SE3(placements[i, :3, :3], placements[i, :3, 3])
        return model

    def with_placements(self, placements: NDArray[np.float64]) -> Robot:
        """A new robot with these placements, its URDF's ``<origin>`` elements changed to match.

        Args:
            placements: shape (n + 1, 4, 4), [m].

        Raises:
            UrdfError: The tip's placement differs but no URDF joint can carry it.
        """
        for i in np.flatnonzero(np.any(placements != self.placements, axis=(1, 2))):
            if self.carriers[i] is None:
                message = (
                    f"The tip '{self.tip}' of '{self.name}' is moved by its last joint directly: the URDF has no "
                    "<origin> behind that joint that could hold a correction. Add a fixed joint and a link to the "
                    "URDF and name that link as --tip."
                )
                raise UrdfError(message)
        moved = replace(self, placements=read_only(placements), _model=self.chain_model(placements))
        was = self.origins()
        origins = {
            name: T for name, T in moved.origins().items() if not np.array_equal(T, was[name])
        }
        return replace(moved, urdf=self.urdf.with_origins(origins))

    def origins(self) -> dict[str, NDArray[np.float64]]:
        """The ``<origin>`` of each URDF joint that carries a placement, shape (4, 4), [m]."""
        return {
            carrier: rigid_inverse(self._before[i])
            @ self.placements[i]
            @ rigid_inverse(self._after[i])
            for i, carrier in enumerate(self.carriers)
            if carrier is not None
        }


def find_urdf(source: str | Path) -> Path:
    """The URDF file that a path or a robot's name means.

    A name is looked for in the file list of the installed ``example-robot-data`` package, as
    ``<name>_robot.urdf`` and then ``<name>.urdf``: that package's own loader returns a UR5 for ``"ur3"``.

    Raises:
        UrdfError: Neither a file nor a known robot.
    """
    path = Path(source)
    if path.suffix or len(path.parts) != 1 or path.is_file():
        return path
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    urdfs = {file.name: Path(str(file.locate())) for file in files if file.suffix == ".urdf"}
    for name in (f"{source}_robot.urdf", f"{source}.urdf"):
        if name in urdfs:
            return urdfs[name]
    known = sorted(name.removesuffix(".urdf").removesuffix("_robot") for name in urdfs)
    message = (
        f"'{source}' is neither a file here nor a robot of example-robot-data. Give the path of a URDF, or "
        f"one of {choices(dict.fromkeys(known), limit=60)}."
    )
    raise UrdfError(message)


def last_joint_poses(model: pin.Model, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose of a chain's last joint in its root, shape (N, 4, 4), [m].

    Args:
        model: The chain, see `Robot.chain_model`.
        configurations: shape (N, nq), see `Robot.configurations`.
    """
    data, last = model.createData(), model.njoints - 1
    T_root_last = np.empty((len(configurations), 4, 4))
    for i, configuration in enumerate(configurations):
        pin.forwardKinematics(model, data, configuration)
        T_root_last[i] = data.oMi[last].homogeneous
    return T_root_last


def read_only(values: ArrayLike | Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """A copy of the values as a float64 array of the same shape that cannot be written to."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def rigid_inverse(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of a pose, shape (4, 4): (R^T, -R^T p)."""
    result = np.eye(4)
    result[:3, :3] = T[:3, :3].T
    result[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return result


def _chain_model(urdf: Urdf, joints: Sequence[UrdfJoint]) -> pin.Model:
    """The Pinocchio model of the URDF with every joint but the chain's locked at zero."""
    try:
        model = pin.buildModelFromXML(urdf.data.decode(urdf.encoding))
    except (ValueError, RuntimeError) as error:
        message = f"{urdf.source}: Pinocchio cannot build a model of this URDF: {error}"
        raise UrdfError(message) from error
    # Pinocchio cannot lock a joint that shares its name with a link, as ANYmal's do: let links be told apart.
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            frame.name = _LINK + frame.name
    wanted = {joint.name for joint in joints}
    locked = [i for i in range(1, model.njoints) if model.names[i] not in wanted]
    return pin.buildReducedModel(model, locked, pin.neutral(model)) if locked else model


def _link_placement(model: pin.Model, link: str) -> NDArray[np.float64]:
    """The pose of a link in the joint that moves it (the root, where none does), shape (4, 4)."""
    frame = model.frames[model.getFrameId(_LINK + link, pin.FrameType.BODY)]
    result: NDArray[np.float64] = frame.placement.homogeneous
    return result


def _farthest_link(urdf: Urdf, base: str, measured: Collection[str] | None) -> str:
    """The link with the most moving joints between it and ``base``; a usual tip's name breaks ties.

    Only links that measured joints alone lead to count, if there are any with a moving joint before them.
    """
    urdf.chain(base, base)  # raises, with the names there are, for a link that does not exist
    above = {joint.child: joint for joint in urdf.joints}
    start = base
    while start in above and above[start].type == "fixed":
        start = above[start].parent
    below: dict[str, list[UrdfJoint]] = {}
    for joint in urdf.joints:
        below.setdefault(joint.parent, []).append(joint)
    count = {start: 0}
    reached = [start]
    for link in reached:
        for joint in below.get(link, []):
            moves = joint.type != "fixed"
            unusable = joint.type not in _MOVING or joint.mimic is not None
            if moves and (unusable or (measured is not None and joint.name not in measured)):
                continue
            count[joint.child] = count[link] + moves
            reached.append(joint.child)
    most = max(count.values())
    if most == 0 and measured is not None:
        return _farthest_link(urdf, base, None)
    farthest = [link for link in reached if count[link] == most]
    return next((name for name in _USUAL_TIPS if name in farthest), farthest[-1])


def _check_base_is_rigid(urdf: Urdf, base: str, tip: str, to_base: list[UrdfJoint]) -> None:
    """Refuse a base that itself moves against the link where the two branches part."""
    moving = [joint.name for joint in to_base if joint.type != "fixed"]
    if moving:
        message = (
            f"{urdf.source}: between '{tip}' and the base '{base}' the moving joints {choices(moving)} lie on the "
            f"base's side; only a base that is rigidly connected to the chain's root is supported. Choose "
            f"'{urdf.root}' or another link before these joints as --base."
        )
        raise UrdfError(message)


def _check_moving(urdf: Urdf, base: str, tip: str, joints: tuple[UrdfJoint, ...]) -> None:
    """Refuse a chain without joints, and joints with more than one coordinate or none of their own."""
    if not joints:
        message = (
            f"{urdf.source}: no joint moves between the base '{base}' and the tip '{tip}'. Name two links with "
            f"the arm between them by --base and --tip; the links are {choices(urdf.links)}."
        )
        raise UrdfError(message)
    for joint in joints:
        if joint.type not in _MOVING:
            message = (
                f"{urdf.source}: joint '{joint.name}' between '{base}' and '{tip}' is of type '{joint.type}'; a "
                f"chain may hold {choices(_MOVING)} and 'fixed' joints. Choose --base and --tip on one side of it."
            )
            raise UrdfError(message)
        if joint.mimic is not None:
            message = (
                f"{urdf.source}: joint '{joint.name}' between '{base}' and '{tip}' mimics '{joint.mimic}'; chains "
                "with mimic joints are not supported. Choose --base and --tip on one side of it."
            )
            raise UrdfError(message)
