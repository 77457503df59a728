"""MuJoCo models (MJCF) read as a kinematic tree: bodies with their joints, and sites.

A body B stands in its parent by pos and orientation while its joints are at their ``ref``. Its joints, in the order of
the file, turn about an axis a through a point p of the body, or slide along a:

    T_parent_B(q) = T_parent_B  S_1(q_1 - ref_1) ... S_k(q_k - ref_k)
    S(t) = Trans(p) Rot(a, t) Trans(-p)    or    Trans(t a)

``<frame>`` moves what stands in it, and is no body. What bears on neither kinematics nor masses is read over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calib.basics.arrays import Array
from calib.errors import UrdfError, did_you_mean
from calib.robot.mjcf_elements import Attributes, Compiler, Defaults, numbers, pose, unit_vector
from calib.robot.mjcf_files import MjcfFiles, Node, read_files

WORLD = "world"
"""Name of the body that all others stand in."""

#: Elements that stand for others, which calib does not make, and what to do.
_MAKERS = {
    "replicate": "calib does not repeat what is in <replicate>",
    "attach": "calib does not attach other models",
}

#: How to have MuJoCo write a model without them.
_SAVE = (
    "have MuJoCo write the model out: python -c \"import mujoco; m = mujoco.MjSpec.from_file('in.xml'); m.compile(); "
    "open('out.xml', 'w').write(m.to_xml())\""
)

#: Elements in a ``<replicate>`` that bear on kinematics.
_OF_TREE = ("body", "joint", "freejoint", "attach")

#: The types of joints with one value.
_ONE_VALUE = ("hinge", "slide")


@dataclass(frozen=True, slots=True, eq=False)
class MjcfJoint:
    """A joint of a body."""

    #: Name, as it is written or made of its number.
    name: str
    #: ``hinge``, ``slide``, ``ball`` or ``free``.
    type: str
    #: Shape (3,), [m], a point of its axis in the body; zero if it slides or is free.
    pos: Array
    #: Shape (3,), unit vector in the body.
    axis: Array
    #: Its value where the body's pos and orientation hold [rad or m].
    ref: float
    #: Least and largest value [rad or m]; None for no limits.
    limits: tuple[float, float] | None
    #: Its element.
    node: Node
    #: Shape (4, 4), [m], pose of the innermost ``<frame>`` around the element in the body.
    T_body_frame: Array


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """A body or a site: what stands in a body by pos and orientation."""

    #: Name, as it is written or made of its number.
    name: str
    #: Name of the body that it stands in, `WORLD` for the outermost.
    parent: str
    #: Shape (4, 4), [m], pose of the innermost ``<frame>`` around the element in that body.
    T_parent_frame: Array
    #: Shape (4, 4), [m], pose in that frame, as its element states it.
    T_frame_own: Array
    #: Its element.
    node: Node
    #: Its attributes, with those of its class.
    attributes: Attributes
    #: Why no chain can end at it; empty: one can.
    fault: str = ""

    @property
    def T_parent_own(self) -> Array:
        """Its pose in the body that it stands in, joints at their ``ref``, shape (4, 4), [m]."""
        return np.asarray(self.T_parent_frame @ self.T_frame_own)


@dataclass(frozen=True, slots=True, eq=False)
class MjcfBody(Placed):
    """A body."""

    #: Its joints, which act in this order.
    joints: tuple[MjcfJoint, ...] = ()
    #: Its mass [kg] and centre of mass, (3,) [m] in the body, if ``<inertial>`` states them.
    inertial: tuple[float, Array] | None = None
    #: True if it has a mass that only its geoms tell.
    mass_of_geoms: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Mjcf:
    """A MuJoCo model as a kinematic tree."""

    #: Its files.
    files: MjcfFiles
    #: The settings of its compiler.
    compiler: Compiler
    #: The bodies but the world, in MuJoCo's order: each before those in it.
    bodies: tuple[MjcfBody, ...]
    #: The sites.
    sites: tuple[Placed, ...]
    #: For joints that follow others: the other's name, factor and offset [rad or m].
    couplings: Mapping[str, tuple[str, float, float]]
    #: Joints that follow others otherwise, and why calib cannot take it.
    refused: Mapping[str, str]

    @classmethod
    def read(cls, path: Path, changed: Mapping[Path, bytes] | None = None) -> Mjcf:
        """Read an MJCF with the files that it includes.

        Args:
            path: The main file.
            changed: Bytes of files that are not written yet, by the path that they will have; None for none.

        Raises:
            FileError: A file cannot be read.
            UrdfError: It is not a model that calib can take; the text says where, why and what to do.
        """
        files = read_files(path, changed)
        root = files.root
        builder = _Builder(Compiler.of(root), Defaults.of(root))
        builder.take_names(root)
        for node in root.all("worldbody"):
            builder.inside(node, WORLD, np.eye(4), node.attributes.get("childclass", ""))
        bodies = tuple(builder.finished())
        if not any(body.joints for body in bodies):
            raise UrdfError(
                f"{path.name}: no body of it has a joint. Give the MJCF of the arm, or the scene that includes it."
            )
        builder.couple(root)
        return cls(
            files,
            builder.compiler,
            bodies,
            tuple(builder.sites),
            builder.couplings,
            builder.refused,
        )


@dataclass(slots=True)
class _Builder:
    """The tree as far as it was read."""

    compiler: Compiler
    defaults: Defaults
    bodies: list[MjcfBody] = field(default_factory=list)
    sites: list[Placed] = field(default_factory=list)
    couplings: dict[str, tuple[str, float, float]] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    #: Joints by name of their body.
    _joints: dict[str, list[MjcfJoint]] = field(default_factory=dict)
    #: Mass and its centre by name of the body.
    _inertial: dict[str, tuple[float, Array]] = field(default_factory=dict)
    #: Bodies with a geom that has a mass.
    _with_geoms: set[str] = field(default_factory=set)
    #: Names that are written, by kind of element: ``body``, ``joint``, ``site``.
    _taken: dict[str, set[str]] = field(default_factory=dict)
    #: Numbers of elements without a name, by kind.
    _unnamed: dict[str, int] = field(default_factory=dict)

    def take_names(self, root: Node) -> None:
        """Note the names that are written, so that none is made a second time; UrdfError if one is written twice."""
        for outer in root.all("worldbody"):
            for node in outer.walk():
                kind = "joint" if node.tag == "freejoint" else node.tag
                name = node.attributes.get("name", "")
                if kind in ("body", "joint", "site") and name:
                    taken = self._taken.setdefault(kind, {WORLD} if kind == "body" else set())
                    if name in taken:
                        raise node.at(f"there is another {kind} of this name; rename one")
                    taken.add(name)

    def _name(self, node: Node, kind: str) -> str:
        """Return the name of an element; of one without a name such as ``body_3``, by its number among these."""
        written = node.attributes.get("name", "")
        if written:
            return written
        while True:
            self._unnamed[kind] = self._unnamed.get(kind, 0) + 1
            name = f"{kind}_{self._unnamed[kind]}"
            if name not in self._taken.get(kind, ()):
                return name

    def inside(self, node: Node, body: str, T_body_frame: Array, childclass: str) -> None:
        """Add what stands in an element, which is the world, a body or a frame in one."""
        for child in node.children:
            if child.tag == "body":
                self._add_body(child, body, T_body_frame, childclass)
            elif child.tag == "frame":
                T = T_body_frame @ pose(child, child.attributes, self.compiler)
                self.inside(child, body, T, child.attributes.get("childclass", childclass))
            elif child.tag in ("joint", "freejoint"):
                self._add_joint(child, body, T_body_frame, childclass)
            elif child.tag == "site":
                attributes = self.defaults.attributes(child, childclass)
                T = pose(child, attributes, self.compiler)
                name = self._name(child, "site")
                general = self.defaults.disputed(child, childclass)
                fault = ""
                if general is not None:
                    fault = (
                        f"{child.file.name}, line {child.element.line}: site '{name}' states its orientation, and so "
                        f"does its class, by {general}; versions of MuJoCo take one or the other. Move it out of the "
                        "class"
                    )
                self.sites.append(Placed(name, body, T_body_frame, T, child, attributes, fault))
            elif child.tag == "inertial":
                self._add_inertial(child, body, T_body_frame)
            elif child.tag == "geom":
                attributes = self.defaults.attributes(child, childclass)
                if not self._is_massless(child, attributes):
                    self._with_geoms.add(body)
            elif child.tag in _MAKERS and any(part.tag in _OF_TREE for part in child.walk()):
                raise child.at(f"{_MAKERS[child.tag]}; {_SAVE}")

    def _add_body(self, node: Node, parent: str, T_parent_frame: Array, childclass: str) -> None:
        """Add a body and all in it."""
        name = self._name(node, "body")
        T = pose(node, node.attributes, self.compiler)
        self.bodies.append(MjcfBody(name, parent, T_parent_frame, T, node, node.attributes))
        self._joints[name] = []
        self.inside(node, name, np.eye(4), node.attributes.get("childclass", childclass))

    def _add_joint(self, node: Node, body: str, T_body_frame: Array, childclass: str) -> None:
        """Add a joint to its body."""
        if body == WORLD:
            raise node.at(
                "a joint stands in a body, and the world has none; put it into the body that it moves"
            )
        attributes = self.defaults.attributes(node, childclass) if node.tag == "joint" else {}
        kind = "free" if node.tag == "freejoint" else attributes.get("type", "hinge")
        if kind not in (*_ONE_VALUE, "ball", "free"):
            raise node.at(f"the type is '{kind}'; hinge, slide, ball or free is wanted")
        pos = np.zeros(3)
        axis = np.array([0.0, 0.0, 1.0])
        ref = 0.0
        limits = None
        if kind in ("hinge", "ball"):
            stated = numbers(node, attributes, "pos", (0.0, 0.0, 0.0))
            pos = T_body_frame[:3, :3] @ stated + T_body_frame[:3, 3]
        if kind in _ONE_VALUE:
            stated = numbers(node, attributes, "axis", (0.0, 0.0, 1.0))
            axis = T_body_frame[:3, :3] @ unit_vector(node, stated, "axis")
            unit = self.compiler.per_radian if kind == "hinge" else 1.0
            ref = float(numbers(node, attributes, "ref", (0.0,))[0]) / unit
            limits = self._limits(node, attributes, unit)
        name = self._name(node, "joint")
        if kind == "ball":
            self.refused[name] = (
                f"{node.file.name}, line {node.element.line}: joint '{name}' is a ball, which has no angle that a "
                "table could state; calib takes hinges and slides between base and tip. Write it as three hinges"
            )
        self._joints[body].append(MjcfJoint(name, kind, pos, axis, ref, limits, node, T_body_frame))

    def _limits(
        self, node: Node, attributes: Attributes, unit: float
    ) -> tuple[float, float] | None:
        """Return the limits of a joint [rad or m], of which ``unit`` is written for one; None if it has none."""
        limited = attributes.get("limited", "auto")
        if limited not in ("true", "false", "auto"):
            raise node.at(f"limited is '{limited}'; true, false or auto is wanted")
        if limited == "false" or "range" not in attributes:
            return None
        if limited == "auto" and not self.compiler.autolimits:
            raise node.at(
                'it has a range, and <compiler autolimits="false"> leaves open whether that limits it, which MuJoCo '
                'refuses; write limited="true" or limited="false"'
            )
        lower, upper = numbers(node, attributes, "range", (0.0, 0.0)) / unit
        return (float(lower), float(upper)) if lower < upper else None

    def _add_inertial(self, node: Node, body: str, T_body_frame: Array) -> None:
        """Note the mass that ``<inertial>`` states, and where its centre is."""
        mass = float(numbers(node, node.attributes, "mass", (0.0,))[0])
        stated = numbers(node, node.attributes, "pos", (0.0, 0.0, 0.0))
        centre = T_body_frame[:3, :3] @ stated + T_body_frame[:3, 3]
        self._inertial[body] = (mass, np.asarray(centre))

    def _is_massless(self, node: Node, attributes: Attributes) -> bool:
        """Return True for a geom that adds no mass to its body."""
        if "mass" in attributes:
            return not numbers(node, attributes, "mass", (0.0,))[0]
        return not numbers(node, attributes, "density", (1000.0,))[0]

    def finished(self) -> list[MjcfBody]:
        """Return the bodies with their joints and masses."""
        result = []
        for body in self.bodies:
            inertial = self._inertial.get(body.name)
            if self.compiler.inertia_from_geoms:
                inertial = None
            finished = MjcfBody(
                body.name,
                body.parent,
                body.T_parent_frame,
                body.T_frame_own,
                body.node,
                body.attributes,
                joints=tuple(self._joints[body.name]),
                inertial=inertial,
                mass_of_geoms=inertial is None and body.name in self._with_geoms,
            )
            result.append(finished)
        return result

    def couple(self, root: Node) -> None:
        """Note which joints follow others by an active ``<equality>``.

        q_1 - ref_1 = c_0 + c_1 (q_2 - ref_2) + ...
        """
        by_name = {joint.name: joint for joints in self._joints.values() for joint in joints}
        nodes = [child for node in root.all("equality") for child in node.all("joint")]
        for node in nodes:
            attributes = self.defaults.of_equality(node)
            if attributes.get("active", "true") == "false":
                continue
            follower, driver = attributes.get("joint1", ""), attributes.get("joint2", "")
            for joint in (follower, driver):
                if joint and joint not in by_name:
                    raise node.at(
                        f"there is no joint '{joint}'{did_you_mean(joint, by_name)}; correct the name"
                    )
            if not follower or by_name[follower].type not in _ONE_VALUE:
                continue
            words = (attributes.get("polycoef", "0 1 0 0 0").split() + ["0"] * 5)[:5]
            c = numbers(node, {"polycoef": " ".join(words)}, "polycoef", (0.0,) * 5)
            ref = by_name[follower].ref
            if driver and by_name[driver].type in _ONE_VALUE and not c[2:].any():
                offset = ref + float(c[0] - c[1] * by_name[driver].ref)
                self.couplings[follower] = (driver, float(c[1]), offset)
            else:
                law = "stays where it is" if not driver else f"follows '{driver}' by a curve"
                self.refused[follower] = (
                    f"{node.file.name}, line {node.element.line}: joint '{follower}' {law} (<equality>), and lies "
                    "between base and tip; of polycoef calib takes c0 and c1 only. Remove the equality if the table "
                    "has a column of the joint"
                )
