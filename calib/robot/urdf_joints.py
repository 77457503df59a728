"""The joints and links of a URDF, and the tree that they form."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import UrdfError, choices, did_you_mean
from calib.robot.urdf_xml import XACRO_FIX, Document, Element
from calib.units import NUMBER

FloatArray = NDArray[np.float64]

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")

_ZERO_AXIS = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint:
    """A joint as the URDF states it."""

    name: str  #: Name of the joint.
    type: str  #: One of `JOINT_TYPES`.
    parent: str  #: Name of the parent link.
    child: str  #: Name of the child link.
    xyz: FloatArray  #: Translation of the origin in the parent link, (3,) [m].
    rpy: FloatArray  #: Rotation of the origin about the fixed x, y, z axes, (3,) [rad].
    axis: FloatArray  #: Unit vector in the joint's frame, (3,); (1, 0, 0) for fixed and floating joints.
    mimic: str | None  #: Name of the joint that drives this one, or None.
    lower: float | None  #: Lower limit [rad or m]; None where none is stated or the type has none.
    upper: float | None  #: Upper limit, likewise.
    mimic_multiplier: float = 1.0  #: Factor of the driving joint's value.
    mimic_offset: float = 0.0  #: Added to it [rad or m].

    @property
    def T_parent_joint(self) -> FloatArray:
        """The origin: pose of the joint's frame in the parent link, (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = pin.rpy.rpyToMatrix(*self.rpy)
        T[:3, 3] = self.xyz
        T.setflags(write=False)
        return T


def read_tree(document: Document) -> tuple[tuple[UrdfJoint, ...], tuple[str, ...]]:
    """The joints and the names of the links, both in the file's order."""
    root = document.root
    elements = root.all("joint")
    if root.tag != "robot":
        known = {"sdf": "SDF (Gazebo)", "mujoco": "MJCF (MuJoCo)", "COLLADA": "a COLLADA mesh"}
        looks = f", it looks like {known[root.tag]}" if root.tag in known else ""
        text = f"the outermost element is <{root.tag}>{looks}; a URDF has <robot>"
        raise document.at(root, text)
    if not elements:
        text = "<robot> has no <joint>; a URDF with the joints themselves is wanted"
        raise document.at(root, text)
    links = _unique_names(document, root.all("link"))
    _unique_names(document, elements)
    joints = tuple(_Reader(document, element).joint() for element in elements)
    _check_tree(document, joints, links)
    return joints, links


def _unique_names(document: Document, elements: list[Element]) -> tuple[str, ...]:
    """The names of links or joints, which must be there once each."""
    lines: dict[str, int] = {}
    for element in elements:
        name = element.attributes.get("name", "")
        if not name:
            text = f'a <{element.tag}> has no name; give it name="..."'
            raise document.at(element, text)
        if name in lines:
            first = f"the first is in line {lines[name]}"
            text = f"a second {element.tag} '{name}', {first}; rename one"
            raise document.at(element, text)
        lines[name] = element.line
    return tuple(lines)


@dataclass(frozen=True, slots=True)
class _Reader:
    """A ``<joint>`` of the robot, read with the place of what is wrong."""

    document: Document
    element: Element

    def joint(self) -> UrdfJoint:
        """What the element states."""
        kind = self.element.attributes.get("type", "")
        if kind not in JOINT_TYPES:
            text = f" has the type '{kind}'; the types are {choices(JOINT_TYPES)}"
            raise self._fault(text)
        limited = kind in ("revolute", "prismatic")
        directed = kind not in ("fixed", "floating")
        factor = self._number("mimic", "multiplier")
        axis = self._vector("axis", "xyz", (1.0, 0.0, 0.0)) if directed else np.array([1.0, 0, 0])
        length = float(np.linalg.norm(axis))
        if length < _ZERO_AXIS:
            text = ': the axis is zero; give its direction, xyz="0 0 1" for example'
            raise self._fault(text)
        axis = axis / length
        axis.setflags(write=False)
        return UrdfJoint(
            name=self.element.attributes["name"],
            type=kind,
            parent=self._word("parent", "link"),
            child=self._word("child", "link"),
            xyz=self._vector("origin", "xyz"),
            rpy=self._vector("origin", "rpy"),
            axis=axis,
            mimic=self._word("mimic", "joint") if self._part("mimic") else None,
            lower=self._number("limit", "lower") if limited else None,
            upper=self._number("limit", "upper") if limited else None,
            mimic_multiplier=1.0 if factor is None else factor,
            mimic_offset=self._number("mimic", "offset") or 0.0,
        )

    def _fault(self, text: str, part: Element | None = None) -> UrdfError:
        """An error about the joint, with the line of one of its parts."""
        name = self.element.attributes["name"]
        return self.document.at(part or self.element, f"joint '{name}'{text}")

    def _part(self, tag: str) -> Element | None:
        """The child of that name, None without; refused if there are several."""
        found = self.element.all(tag)
        if len(found) > 1:
            text = f" has {len(found)} <{tag}>; keep one"
            raise self._fault(text)
        return found[0] if found else None

    def _word(self, tag: str, key: str) -> str:
        """The value of ``<tag key="...">``, which must be there."""
        part = self._part(tag)
        value = part.attributes.get(key, "") if part else ""
        if not value:
            text = f' lacks <{tag} {key}="...">'
            raise self._fault(text)
        return value

    def _numbers(self, tag: str, key: str, count: int) -> list[float] | None:
        """The finite numbers of an attribute; None if it is absent."""
        part = self._part(tag)
        if part is None or key not in part.attributes:
            return None
        text = part.attributes[key]
        words = re.split("[ \t\r\n]+", text.strip(" \t\r\n"))  # XML's white space only
        if len(words) == count and all(NUMBER.fullmatch(word) for word in words):
            values = [float(word) for word in words]
            if np.isfinite(values).all():
                return values
        wanted = f"{count} finite numbers" if count > 1 else "a finite number"
        xacro = f"; this is xacro, {XACRO_FIX}" if "${" in text or "$(" in text else ""
        message = f": {key} of <{tag}> is '{text}', {wanted} wanted{xacro}"
        raise self._fault(message, part)

    def _number(self, tag: str, key: str) -> float | None:
        """The number of an attribute, None if it is absent."""
        found = self._numbers(tag, key, 1)
        return None if found is None else found[0]

    def _vector(
        self, tag: str, key: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)
    ) -> FloatArray:
        """The three numbers of an attribute, read-only."""
        found = np.array(self._numbers(tag, key, 3) or default)
        found.setflags(write=False)
        return found


def _check_tree(document: Document, joints: tuple[UrdfJoint, ...], links: tuple[str, ...]) -> None:
    """Refuse links that do not exist or have two parents, several roots, and loops."""
    above: dict[str, UrdfJoint] = {}
    for joint, element in zip(joints, document.root.all("joint"), strict=True):
        for link in (joint.parent, joint.child):
            if link not in links:
                text = f"joint '{joint.name}' names the link '{link}', which does not exist"
                raise document.at(element, text + did_you_mean(link, links))
        if joint.child in above:
            text = (
                f"link '{joint.child}' is the child of both '{above[joint.child].name}' and "
                f"'{joint.name}'; a URDF is a tree, a closed loop cannot be written in it"
            )
            raise document.at(element, text)
        above[joint.child] = joint
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        raise UrdfError(
            f"{document.source} has {len(roots)} root links: {choices(roots)}; join them by fixed "
            "joints so that one is left"
        )
    reached = set(roots)
    while new := {j.child for j in joints if j.parent in reached} - reached:
        reached |= new
    loop = sorted(joint.name for joint in joints if joint.child not in reached)
    if loop:
        raise UrdfError(
            f"{document.source}: the joints {choices(loop)} form a loop; a URDF is a tree"
        )
