"""Robot: an immutable kinematic chain, from one link of a URDF to another, over Pinocchio.

The chain's moving joints are numbered 1 to n from base to tip. Its geometry is n + 1 *placements*: the
pose of joint i in the frame of the joint before it, and the pose of the tip in the frame of joint n:

    T_base_tip(q) = T_root_base^-1  P_1 J_1(q_1)  P_2 J_2(q_2) ... P_n J_n(q_n)  P_tip

Every correction is a change of these placements, each carried by the ``<origin>`` of one URDF joint. The joints may be
on both sides of the link where the branches to base and tip part, and may be more than the columns of q, if some mimic
others or are held (`calib.robot.chain`). q are joint readings, which may be coupled (`calib.robot.coupled_readings`):

    q_chain = A theta + b,    theta = C q

A robot with several tips or instruments on its links has *branches*: further chains of the same URDF, which have the
same columns of q. What is measured is predicted by the chain from its frame's link to its target's (`Robot.chains`);
what is corrected are the placements of its *limbs*, one chain to each of these links, if
it is not on the way to another, from the link where they part.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arguments import check_mapping, check_names, check_type, finite_numbers, numbers
from calib.basics.arrays import Array, Integers, Mask, read_only, rigid_inverse
from calib.basics.values import Value, one_line
from calib.errors import ModelError, UrdfError, choices
from calib.robot import kernel
from calib.robot.chain import (
    OnPath,
    OriginFactors,
    all_values,
    chain_between,
    checked_held,
    coupling_of,
)
from calib.robot.coupled_readings import ReadingCoupling, checked_coupling, reading_matrix
from calib.robot.default_tip import farthest_link
from calib.robot.dh_rows import STANDARD, DHRobot, DHRow, DHTable
from calib.robot.joined_urdf import Part
from calib.robot.urdf import Urdf, read_urdf, urdf_of_dh
from calib.robot.urdf_tree import UrdfJoint

#: A placement that no <origin> holds may change by this, which is rounding [m; rotation matrices: 1].
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class Robot(Value):
    """A chain of a URDF, immutable: a changed robot is a new one. Lengths [m], angles [rad].

    Two are equal when URDF, base, tip, held joints, coupled readings, columns and branches are.
    """

    #: The n moving joints, base to tip, mimic and held ones too; those on the base's side with the axis reversed.
    joints: tuple[UrdfJoint, ...] = field(compare=False)
    #: shape (n + 1, 4, 4), [m]; see the module's text. The last one is the tip's.
    placements: Array = field(compare=False)
    #: For each placement the URDF joint whose ``<origin>`` holds it; None if a moving joint carries the end.
    carriers: tuple[str | None, ...] = field(compare=False)
    #: shape (4, 4), [m], pose of the base where the chain starts: the URDF's root, or a base that its joints move.
    T_root_base: Array = field(compare=False)
    #: The n + 1 placements as products of an ``<origin>`` and constants.
    _origin_factors: tuple[OriginFactors, ...] = field(compare=False)
    #: True if joints lie on the base's side.
    base_moves: bool = field(compare=False)
    #: The URDF that describes this robot; always in step with ``placements``.
    urdf: Urdf
    #: Link in whose frame poses are given.
    base: str
    #: Link whose pose is given.
    tip: str
    #: Held joints and their values [rad or m], by name.
    _held: tuple[tuple[str, float], ...]
    #: Joints whose readings are coupled to others', sorted by name.
    _reading_coupling: ReadingCoupling
    #: The joint of each column of q, m of them; a driver that lies outside the chain is among them.
    inputs: tuple[UrdfJoint, ...] = field(compare=False)
    #: Names of ``inputs``: one of several chains may have its columns in another order than the chain by itself.
    _columns: tuple[str, ...] = field(init=False, repr=False)
    #: A of q_chain = A theta + b, shape (n, m): 1 if a joint of the chain is the column's, its multiplier if it mimics
    #: that. Coupled readings are not in it, but in ``reading_matrix``.
    mimic_matrix: Array = field(compare=False)
    #: b of q_chain = A theta + b, shape (n,): offsets of mimic joints and held values [rad] or [m].
    _offset: Array = field(compare=False)
    #: C of theta = C q, shape (m, m): the values of the columns' joints by their readings; identity: not coupled.
    reading_matrix: Array = field(compare=False)
    #: The URDF joints between base and tip by name, and where each stands in the chain.
    path: Mapping[str, OnPath] = field(compare=False)
    #: Further chains of the URDF, without branches of their own; they have the same columns of q.
    branches: tuple[Robot, ...] = ()
    #: The robots that the URDF was joined from, see `calib.robot.joined_urdf`; empty if it is of one robot.
    parts: tuple[Part, ...] = ()

    def __post_init__(self) -> None:
        """Name the columns, by which robots are compared too."""
        object.__setattr__(self, "_columns", tuple(joint.name for joint in self.inputs))

    @classmethod
    def load(
        cls,
        source: str | Path,
        base: str | None = None,
        tip: str | None = None,
        measured: Collection[str] | None = None,
        held: Mapping[str, float] | None = None,
        coupling: Mapping[str, Mapping[str, float]] | None = None,
    ) -> Robot:
        """Load a robot from a URDF, a xacro, an MJCF or a file of DH rows, or by its name from example-robot-data.

        Args:
            source: Path of a URDF; or of an MJCF; or of a file of DH rows; or of a xacro, followed by arguments as in
                ``"ur.urdf.xacro ur_type:=ur5e"``; or a name such as ``"ur3"`` or ``"panda"``.
            base: Link in whose frame the poses are given; default the URDF's root link.
            tip: Link that the chain ends at; default the link with the most moving joints before it.
            measured: Names of the joints whose values are known: the default tip is reached by these alone, if it can.
            held: Values [rad or m] of joints that stay where they are, so that no column of q is theirs. Joints
                beside the chain may be among them; they matter for gravity only, and are at zero if not named.
            coupling: For each joint whose reading is coupled to others' the factors of these by name: with
                ``{"joint_3": {"joint_2": 1.0}}`` the angle of joint_3 is its reading plus that of joint_2. Factors
                between joints that turn and joints that slide are [m/rad] and [rad/m]. None: q are the joints' values.

        Raises:
            ArgumentError: It is neither a path nor a name.
            FileError: The file cannot be read.
            UrdfError: No such robot, link or joint, a chain that calib cannot take, or a xacro with a fault.

        Example:
            >>> Robot.load("ur3", base="base", tip="tool0").joint_names[0]
            'shoulder_pan_joint'
        """
        check_type(
            "source",
            source,
            (str, Path),
            "the path of a URDF, a xacro, an MJCF or DH rows, or a name such as 'ur3'",
        )
        return cls.from_urdf(read_urdf(source), base, tip, measured, held, coupling)

    @classmethod
    def from_urdf(
        cls,
        urdf: Urdf,
        base: str | None = None,
        tip: str | None = None,
        measured: Collection[str] | None = None,
        held: Mapping[str, float] | None = None,
        coupling: Mapping[str, Mapping[str, float]] | None = None,
        branches: Sequence[tuple[str, str]] = (),
        parts: tuple[Part, ...] = (),
    ) -> Robot:
        """Return the chain from ``base`` to ``tip`` of a URDF that has been read.

        Args:
            urdf: The URDF.
            base: Link in whose frame the poses are given; default the URDF's root link.
            tip: Link that the chain ends at; default the link with the most moving joints before it.
            measured: Names of the joints whose values are known: the default tip is reached by these alone, if it can.
            held: Values [rad or m] of joints that stay where they are, by name; see `load`.
            coupling: Factors by name of readings that are added to those of each coupled joint; see `load`. None or
                empty: those of the DH rows that the URDF was made from, if it was.
            branches: Base and tip of further chains, whose joints have columns of q too.
            parts: The robots that the URDF was joined from; empty for one robot.

        Raises:
            ArgumentError: An argument has a wrong type.
            UrdfError: No such link or joint, or a chain that calib cannot take.
        """
        for argument, link in (("base", base), ("tip", tip)):
            check_type(argument, link, (str, type(None)), "the name of a link, or None")
        if measured is not None:
            check_names("measured", measured)
        if held is not None:
            check_mapping("held", held)
            for name, value in held.items():
                allowed = (int, float, np.number)
                check_type(f"held[{name!r}]", value, allowed, "a value [rad] or [m]")
        if coupling is not None:
            check_mapping("coupling", coupling)
            for name, factors in coupling.items():
                check_mapping(f"coupling[{name!r}]", factors)

        held_values = checked_held(urdf, held)
        dh = None if coupling else urdf.dh
        if dh is not None:
            coupling = dh.coupling
        couplings = checked_coupling(urdf, coupling, dict(held_values))

        if base is None:
            base = urdf.root
        if tip is None:
            tip = farthest_link(urdf, base, measured, dict(held_values))
        # The columns of q are the joints of all chains, those of the first one first.
        ends = list(dict.fromkeys([(base, tip), *branches]))
        moving = []
        inputs: dict[str, UrdfJoint] = {}
        for ends_of_chain in ends:
            chain = chain_between(urdf, *ends_of_chain)
            columns = coupling_of(urdf, chain.joints, dict(held_values))
            moving.append((chain, columns))
            inputs = {**{joint.name: joint for joint in columns.inputs}, **inputs}
        names = [joint.name for _, columns in moving for joint in columns.inputs]
        names = list(dict.fromkeys(names))

        robots: list[Robot] = []
        for (chain_base, chain_tip), (chain, columns) in zip(ends, moving, strict=True):
            mimic_matrix = np.zeros((len(chain.joints), len(names)))
            own = [names.index(joint.name) for joint in columns.inputs]
            mimic_matrix[:, own] = columns.matrix
            robot = cls(
                joints=chain.joints,
                placements=chain.placements,
                carriers=chain.carriers,
                T_root_base=chain.T_root_base,
                _origin_factors=chain.factors,
                base_moves=chain.base_moves,
                urdf=urdf,
                base=chain_base,
                tip=chain_tip,
                _held=held_values,
                _reading_coupling=couplings,
                inputs=tuple(inputs[name] for name in names),
                mimic_matrix=read_only(mimic_matrix),
                _offset=columns.offset,
                reading_matrix=reading_matrix(urdf, names, couplings),
                path=chain.path,
                parts=parts,
            )
            robots.append(robot)
        if len(robots) == 1:
            return robots[0]
        return replace(robots[0], branches=tuple(robots[1:]))

    @classmethod
    def from_dh(
        cls,
        rows: Sequence[DHRow],
        convention: str = STANDARD,
        *,
        name: str = "robot",
        T_base_0: ArrayLike | None = None,
        T_n_tip: ArrayLike | None = None,
        coupling: Mapping[str, Mapping[str, float]] | None = None,
    ) -> Robot:
        """Return the robot that DH rows describe, from the link ``base`` to the link ``flange``.

            standard   T_base_tip = T_base_0  A_1 ... A_n  T_n_tip,   A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)
            hayati     the same with A_i Ry(beta_i)
            modified   M_i = Rx(alpha_(i-1)) Tx(a_(i-1)) Rz(theta_i) Tz(d_i)   (Craig)

        where ``direction q_i + offset`` is added to theta_i, or to d_i of a joint that slides. Its URDF, `Robot.urdf`,
        has cylinders as links, seen and checked for collisions, and the rows in a comment.

        Args:
            rows: One for each joint, base to tip [m and rad].
            convention: ``"standard"``, ``"modified"`` or ``"hayati"``.
            name: Name of the robot.
            T_base_0: Shape (4, 4), [m], pose before the first row; None: the identity.
            T_n_tip: Shape (4, 4), [m], pose after the last row; None: the identity.
            coupling: Factors of the readings of other joints in a joint's value, by joint:
                ``{"joint_3": {"joint_2": 1.0}}``, value_3 = reading_3 + reading_2.

        Raises:
            ArgumentError: An argument of another type.
            ModelError: The rows make no robot.

        Example:
            A SCARA with arms of 325 and 275 mm, whose third joint slides down:

            >>> import math
            >>> from calib import DHRow
            >>> robot = Robot.from_dh([
            ...     DHRow("J1", d=0.4, a=0.325, lower=-2.3, upper=2.3),
            ...     DHRow("J2", a=0.275, alpha=math.pi, lower=-2.6, upper=2.6),
            ...     DHRow("J3", prismatic=True, lower=0.0, upper=0.2),
            ...     DHRow("J4", lower=-6.28, upper=6.28),
            ... ])
            >>> robot.poses([0.0, 0.0, 0.1, 0.0])[0, :3, 3].round(3).tolist()
            [0.6, -0.0, 0.3]
        """
        check_type("rows", rows, Sequence, "a sequence of DHRow, one for each joint")
        for i, row in enumerate(rows):
            check_type(f"rows[{i}]", row, DHRow, "a DHRow")
        check_type("convention", convention, str, "one of 'standard', 'modified' and 'hayati'")
        check_type("name", name, str, "the name of the robot")
        poses = []
        for argument, pose in (("T_base_0", T_base_0), ("T_n_tip", T_n_tip)):
            given = np.eye(4) if pose is None else pose
            poses.append(
                read_only(finite_numbers(argument, given, (4, 4), "a pose of shape (4, 4)"))
            )
        table = DHTable(tuple(rows), poses[0], poses[1], convention)
        stated = DHRobot(table, name, coupling=coupling or {})
        return cls.from_urdf(urdf_of_dh(stated, name), stated.base, stated.tip)

    def rebuilt(
        self,
        urdf: Urdf | None = None,
        base: str | None = None,
        tip: str | None = None,
    ) -> Robot:
        """Return the robot read from another URDF or between other links, with the same joints held and coupled.

        Args:
            urdf: The URDF to read; None for this robot's.
            base: Link in whose frame the poses are given; None for this robot's.
            tip: Link that the chain ends at; None for this robot's. Between other links it has no branches.

        Raises:
            UrdfError: No such link or joint, or a chain that calib cannot take.
        """
        same_links = base is None and tip is None
        return Robot.from_urdf(
            self.urdf if urdf is None else urdf,
            self.base if base is None else base,
            self.tip if tip is None else tip,
            held=self.held,
            coupling=self.reading_coupling,
            branches=self._branch_ends if same_links else (),
            parts=self.parts,
        )

    def __repr__(self) -> str:
        """Return one line, such as ``Robot('ur3', base to tool0, 6 joints)``."""
        chain = f"{self.base} to {self.tip}"
        count = f"{len(self.all_joints)} joints"
        if self.branches:
            further = len(self.branches)
            chain += f" and {further} more chain{'s' if further > 1 else ''}"
        return one_line("Robot", f"'{self.name}'", chain, count)

    @property
    def chains(self) -> tuple[Robot, ...]:
        """The chains between links: this one, without its branches, and these."""
        if not self.branches:
            return (self,)
        return (replace(self, branches=()), *self.branches)

    def with_urdf(self, urdf: Urdf) -> Robot:
        """Return the robot with another URDF that has the same chains, such as one with another comment."""
        branches = tuple(replace(branch, urdf=urdf) for branch in self.branches)
        return replace(self, urdf=urdf, branches=branches)

    @property
    def is_tree(self) -> bool:
        """True if its errors are those of limbs: it has branches, or a chain over the mount of a further robot."""
        return bool(self.branches or self.mounts)

    @property
    def joins_hands(self) -> bool:
        """True if a chain leads up one arm and down another, so that its base moves in the robot too."""
        return any(len(chain.arms) > 1 for chain in self.chains)

    @property
    def arms(self) -> tuple[Robot, ...]:
        """The chain alone; if it leads from one hand to another, both ways down, from where they part."""
        ways = self.urdf.chain(self.base, self.tip)
        if any(all(self.urdf.joint(name).type == "fixed" for name in way) for way in ways):
            return (self.chains[0],)
        parting = self.urdf.joint(ways[0][0]).parent
        return tuple(self.rebuilt(None, parting, link) for link in (self.base, self.tip))

    @property
    def limbs(self) -> tuple[Robot, ...]:
        """The chains whose placements are corrected, from the link where all of ``chains`` part; itself if it is one.

        They have the same columns of q. Each ``<origin>`` that several of them pass stands in all of these alike.
        """
        return _limbs_of(self) if self.is_tree else (self,)

    @property
    def all_joints(self) -> tuple[UrdfJoint, ...]:
        """The joints of all chains, each once; of a tree as the URDF has them, limb by limb."""
        if not self.is_tree:
            return self.joints
        joints = {joint.name: joint for limb in self.limbs for joint in limb.joints}
        return tuple(joints.values())

    @property
    def ends(self) -> tuple[str, ...]:
        """Links at the ends of the chains: the tip, the base, and then those of the branches, each once."""
        links = [self.tip, self.base]
        for chain in self.branches:
            links += [chain.tip, chain.base]
        return tuple(dict.fromkeys(links))

    @property
    def mounts(self) -> tuple[str, ...]:
        """The fixed joints on which further robots stand, if their poses are estimated and a chain leads over them."""
        passed = {name for chain in self.chains for name in chain.path}
        return tuple(part.mount for part in self.parts if part.estimated and part.mount in passed)

    def own_urdfs(self) -> dict[str, Urdf]:
        """Return the URDF of each robot of a cell, corrected as this one is, by its name, ``""`` for the first.

        A robot that is alone has this one's URDF.
        """
        if not self.parts:
            return {"": self.urdf}
        origins = self.origins()
        return {part.name: part.with_origins_of(origins) for part in self.parts}

    @property
    def _branch_ends(self) -> tuple[tuple[str, str], ...]:
        """Base and tip of each branch."""
        return tuple((branch.base, branch.tip) for branch in self.branches)

    @property
    def name(self) -> str:
        """The robot's name in the URDF."""
        return self.urdf.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The names of the measured joints, the m columns of q, in the order in which the chain needs them."""
        return tuple(joint.name for joint in self.inputs)

    @property
    def joint_types(self) -> dict[str, str]:
        """The URDF type of each column's joint by its name: revolute, continuous or prismatic."""
        return {joint.name: joint.type for joint in self.inputs}

    @property
    def held(self) -> dict[str, float]:
        """The values of joints that stay where they are [rad or m] by name, a new dictionary each time."""
        return dict(self._held)

    @property
    def reading_coupling(self) -> dict[str, dict[str, float]]:
        """For each coupled joint the factors of other joints' readings, by names, without zeros; a new dictionary."""
        return {name: dict(factors) for name, factors in self._reading_coupling}

    def poses(self, q: ArrayLike, chain: Integers | None = None) -> Array:
        """Return T_base_tip, the pose of the tip in the base, shape (N, 4, 4), [m].

        Args:
            q: Shape (N, m) or (m,), [rad] or [m], columns in the order of ``joint_names``.
            chain: Shape (N,), index of each row's chain in ``chains``; None: the first.

        Raises:
            ModelError: The shape does not fit the chain, or a value is not finite.
        """
        if chain is not None and self.branches:
            columns = self.columns(q)
            poses = np.empty((len(columns), 4, 4))
            for number, robot in enumerate(self.chains):
                poses[chain == number] = robot.poses(columns[chain == number])
            return poses
        values = self.chain_values(q)
        count, n = values.shape
        index = np.zeros(count, dtype=np.int_)  # the one frame and the one target
        samples = kernel.ChainSamples(
            values=values,
            frame=index,
            target=index,
            moved=np.zeros((count, n, 0)),
            columns=index[:0],
        )
        return kernel.poses(self.geometry(self.placements), samples)

    def geometry(
        self,
        placements: Array,
        T_frame_base: Array | None = None,
        T_tip_target: Array | None = None,
    ) -> kernel.Geometry:
        """Return the chain with other placements as arrays for `calib.robot.kernel`.

        Args:
            placements: Shape (n + 1, 4, 4), [m].
            T_frame_base: Shape (F, 4, 4), [m], pose of the base in each measurement frame; None: one, the base itself.
            T_tip_target: Shape (T, 4, 4), [m], pose of each target in the tip; None: one, the tip itself.
        """
        slides, turns, T_base_root = _axes_of(self)
        identity = np.eye(4)[None]
        return kernel.Geometry(
            slides=slides,
            turns=turns,
            placements=placements,
            bases=identity if T_frame_base is None else T_frame_base,
            T_base_root=T_base_root,
            targets=identity if T_tip_target is None else T_tip_target,
        )

    def columns(self, q: ArrayLike, argument: str = "q") -> Array:
        """Return joint values as an array, shape (N, m), [rad] or [m], columns in the order of ``joint_names``.

        Args:
            q: Shape (N, m) or (m,), [rad] or [m].
            argument: Its name, for messages.

        Raises:
            ArgumentError: They are not numbers.
            ModelError: The shape does not fit the chain, or a value is not finite.
        """
        names = self.joint_names
        allowed = f"of shape (N, {len(names)}) or ({len(names)},)"
        values = np.atleast_2d(numbers(argument, q, f"joint values {allowed}"))
        if values.ndim != 2 or values.shape[1] != len(names):
            raise ModelError(
                f"The argument '{argument}': joint values of shape {np.shape(q)} were given; the chain '{self.base}' "
                f"to '{self.tip}' has {len(names)} joints: {choices(names)}, so that they must be {allowed}."
            )
        if not np.isfinite(values).all():
            row, column = np.argwhere(~np.isfinite(values))[0]
            raise ModelError(
                f"The argument '{argument}': the joint value of '{names[column]}' in row {row}, from 0, is "
                f"{values[row, column]}; each must be a finite number."
            )
        return values

    def chain_values(self, q: ArrayLike) -> Array:
        """Return the values of ``joints``, q_chain = A C q + b, shape (N, n), [rad] or [m].

        Args:
            q: Shape (N, m) or (m,), [rad] or [m], columns in the order of ``joint_names``.

        Raises:
            ModelError: The shape does not fit the chain, or a value is not finite.
        """
        values = self.input_values(q)
        if tuple(joint.name for joint in self.joints) == self.joint_names:
            return values  # every joint is its own column
        result: Array = values @ self.mimic_matrix.T + self._offset
        return result

    def input_values(self, q: ArrayLike) -> Array:
        """Return the values of ``inputs``, the joints of the columns, theta = C q, shape (N, m), [rad] or [m].

        Args:
            q: Shape (N, m) or (m,), readings [rad] or [m], columns in the order of ``joint_names``.

        Raises:
            ModelError: The shape does not fit the chain, or a value is not finite.
        """
        readings = self.columns(q)
        if not self._reading_coupling:
            return readings
        result: Array = readings @ self.reading_matrix.T
        return result

    def readings(self, values: ArrayLike) -> Array:
        """Return the readings q = C^-1 theta at values of ``inputs``, shape (N, m), [rad] or [m]; see `input_values`.

        Args:
            values: Shape (N, m) or (m,), [rad] or [m], columns in the order of ``joint_names``.

        Raises:
            ModelError: The shape does not fit the chain, or a value is not finite.
        """
        theta = self.columns(values, "values")
        if not self._reading_coupling:
            return theta
        result: Array = np.linalg.solve(self.reading_matrix, theta.T).T
        return result

    def urdf_values(self, q: ArrayLike) -> dict[str, Array]:
        """Return the value of every joint of the URDF with one coordinate, by name, shape (N,), [rad] or [m].

        Joints that are not held and follow no column of q are at zero.

        Args:
            q: Shape (N, m) or (m,), [rad] or [m], columns in the order of ``joint_names``.

        Raises:
            ModelError: The shape does not fit the chain, or a value is not finite.
        """
        values = self.input_values(q)
        by_name = dict(zip(self.joint_names, values.T, strict=True))
        return all_values(self.urdf, by_name, self.held, len(values))

    def with_placements(self, placements: Array) -> Robot:
        """Return a new robot with other placements, and the ``<origin>`` elements to match.

        Args:
            placements: Finite, shape (n + 1, 4, 4), [m], as the attribute of this name: the first one stands in the
                chain's root, the last one is the tip's.

        Raises:
            ModelError: Another shape, or a number that is not finite.
            UrdfError: A placement differs but no URDF joint can carry it: the tip's, or that of a moving base.
        """
        shape = self.placements.shape
        placements = finite_numbers(
            "placements", placements, shape, f"poses of shape {shape}"
        ).copy()
        for i, carrier in enumerate(self.carriers):
            if carrier is None:
                if np.abs(placements[i] - self.placements[i]).max() > _ROUNDING:
                    end = f"base '{self.base}'" if i == 0 else f"tip '{self.tip}'"
                    raise UrdfError(
                        f"The {end} of '{self.name}' is moved by its joint directly: the URDF has no <origin> between "
                        "them that could hold a correction. Choose a link that is fixed to it, or add a fixed joint "
                        "and a link to the URDF."
                    )
                placements[i] = self.placements[i]
        moved = replace(self, placements=read_only(placements))
        before = self.origins()
        after = moved.origins()
        changed = {name: T for name, T in after.items() if (before[name] != T).any()}
        return replace(moved, urdf=self.urdf.with_origins(changed))

    def with_limbs(
        self, placements: Sequence[Array], mounts: Mapping[str, Array] = MappingProxyType({})
    ) -> Robot:
        """Return a new robot whose limbs have other placements, and the ``<origin>`` elements to match.

        Args:
            placements: Of each of ``limbs``, see `with_placements`; an ``<origin>`` of several is the same in all.
            mounts: Other poses of further robots in the URDF's root, (4, 4) [m], by the names of ``mounts``.

        Raises:
            ModelError: As of `with_placements`.
            UrdfError: As of `with_placements`.
        """
        if not self.is_tree:
            return self.with_placements(placements[0])
        changed: dict[str, Array] = {}
        before = self.origins()
        for limb, of_limb in zip(self.limbs, placements, strict=True):
            after = limb.with_placements(of_limb).origins()
            changed |= {name: T for name, T in after.items() if (before[name] != T).any()}
        return self.rebuilt(self.urdf.with_origins(changed | dict(mounts)))

    def origins(self) -> dict[str, Array]:
        """Return the ``<origin>`` of each URDF joint that carries a placement of a limb, by name, (4, 4) [m]."""
        origins = {}
        for limb in self.limbs:
            for carrier, factors, P in zip(
                limb.carriers, limb._origin_factors, limb.placements, strict=True
            ):
                if carrier is not None:
                    origins[carrier] = factors.origin(P)
        for mount in self.mounts:
            origins[mount] = np.asarray(self.urdf.joint(mount).T_parent_joint)
        return origins


@lru_cache(maxsize=16)
def _limbs_of(robot: Robot) -> tuple[Robot, ...]:
    """Return the limbs of a tree, see `Robot.limbs`: one for each moved link not on the way to another."""
    urdf = robot.urdf
    links = list(dict.fromkeys(link for chain in robot.chains for link in (chain.base, chain.tip)))
    ways = [urdf.chain(urdf.root, link)[1] for link in links]
    shared = 0
    while all(len(way) > shared and way[shared] == ways[0][shared] for way in ways):
        shared += 1
    parting = urdf.joint(ways[0][shared - 1]).child if shared else urdf.root
    ends = []
    for link, way in zip(links, ways, strict=True):
        moves = any(urdf.joint(name).type != "fixed" for name in way[shared:])
        if moves and not any(other[: len(way)] == way and other != way for other in ways):
            ends.append((parting, link))
    first = Robot.from_urdf(
        urdf,
        *ends[0],
        held=robot.held,
        coupling=robot.reading_coupling,
        branches=ends[1:],
        parts=robot.parts,
    )
    # A chain of a tree has the columns of all of it.
    columns = [robot.joint_names.index(name) for name in first.joint_names]
    limbs = []
    for limb in first.chains:
        mimic_matrix = np.zeros((len(limb.mimic_matrix), len(robot.joint_names)))
        mimic_matrix[:, columns] = limb.mimic_matrix
        limbs.append(
            replace(
                limb,
                parts=(),  # a chain by itself
                inputs=robot.inputs,
                mimic_matrix=read_only(mimic_matrix),
                reading_matrix=robot.reading_matrix,
            )
        )
    return tuple(limbs)


@lru_cache(maxsize=16)
def _axes_of(robot: Robot) -> tuple[Mask, Array, Array]:
    """Return the mask (n,) of sliding joints, rotations from z to the axes (n, 3, 3), and T_base_root (4, 4) [m]."""
    slides = np.array([joint.type == "prismatic" for joint in robot.joints])
    turns = kernel.turns_to(np.array([joint.axis for joint in robot.joints]))
    return slides, turns, rigid_inverse(robot.T_root_base)
