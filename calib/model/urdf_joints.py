"""What a URDF's elements mean: its joints, its links, and the tree that they form."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import overload

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import UrdfError, choices, did_you_mean
from calib.model.number_text import NUMBER
from calib.model.urdf_xml import XACRO_FIX, Document, Element

FloatArray = NDArray[np.float64]

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")

_AXIS_TYPES = ("revolute", "continuous", "prismatic", "planar")
_LIMIT_TYPES = ("revolute", "prismatic")
_ZERO_AXIS = 1e-9

#: Beyond this [m or rad] doubles are further apart than the 1e-9 that written files agree to.
FARTHEST = 1e6

_SPACE = " \t\r\n"  # XML's white space; str.split() would take more


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint:
    """A joint as the URDF states it.

    Attributes:
        name: Name of the joint.
        type: One of `JOINT_TYPES`.
        parent: Name of the parent link.
        child: Name of the child link.
        xyz: Translation of the origin in the parent link, (3,) [m].
        rpy: Rotation of the origin about the fixed x, y, z axes, (3,) [rad].
        axis: Unit vector in the joint's frame, (3,); (1, 0, 0) for fixed and floating joints.
        mimic: Name of the joint that drives this one, as stated, or None.
        lower: Lower limit [rad or m]; None where none is stated or the type has none.
        upper: Upper limit [rad or m]; None where none is stated or the type has none.
        mimic_multiplier: What the value of the joint ``mimic`` is multiplied by, 1 where none is stated.
        mimic_offset: What is then added [rad or m], 0 where none is stated.
    """

    name: str
    type: str
    parent: str
    child: str
    xyz: FloatArray
    rpy: FloatArray
    axis: FloatArray
    mimic: str | None
    lower: float | None
    upper: float | None
    mimic_multiplier: float = 1.0
    mimic_offset: float = 0.0

    @property
    def T_parent_joint(self) -> FloatArray:
        """The origin: pose of the joint's frame in the parent link, (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = pin.rpy.rpyToMatrix(*self.rpy)
        T[:3, 3] = self.xyz
        T.setflags(write=False)
        return T


def read_tree(document: Document) -> tuple[tuple[UrdfJoint, ...], tuple[str, ...]]:
    """The joints and the names of the links, both in the file's order.

    Raises:
        UrdfError: The document is not a URDF with joints, a value is missing or wrong, or joints
            and links do not form one tree.
    """
    _check_root(document)
    elements = document.root.all("joint")
    links = _unique_names(document, document.root.all("link"))
    _unique_names(document, elements)
    joints = tuple(_joint(document, element) for element in elements)
    for joint, element in zip(joints, elements, strict=True):
        for link in (joint.parent, joint.child):
            if link not in links:
                text = f"joint '{joint.name}' names the link '{link}', which does not exist"
                raise document.at(element, text + did_you_mean(link, links))
    _check_tree(document, elements, joints, links)
    return joints, tuple(links)


def path_from_root(link: str, up: Mapping[str, UrdfJoint]) -> tuple[str, ...]:
    """Names of the joints from the root to ``link``; ``up`` gives the joint above each link."""
    names: list[str] = []
    while link in up:
        names.append(up[link].name)
        link = up[link].parent
    return tuple(reversed(names))


def _check_root(document: Document) -> None:
    """Refuse XML that is no URDF, or one without joints."""
    root = document.root
    if root.tag != "robot":
        known = {"sdf": "SDF (Gazebo)", "mujoco": "MJCF (MuJoCo)", "COLLADA": "a COLLADA mesh"}
        looks = f", it looks like {known[root.tag]}" if root.tag in known else ""
        text = f"the outermost element is <{root.tag}>{looks}; a URDF has <robot>"
        raise document.at(root, text)
    if not root.all("joint"):
        text = "<robot> has no <joint>; a URDF with the joints themselves is wanted"
        raise document.at(root, text)


def _joint(document: Document, element: Element) -> UrdfJoint:
    """Interpret a <joint> of the robot."""
    name = _name(document, element)
    kind = element.attributes.get("type", "")
    if kind not in JOINT_TYPES:
        text = f"joint '{name}' has the type '{kind}'; the types are {choices(JOINT_TYPES)}"
        raise document.at(element, text)
    origin = _only(document, element, "origin")
    axis = _only(document, element, "axis") if kind in _AXIS_TYPES else None
    limit = _only(document, element, "limit") if kind in _LIMIT_TYPES else None
    mimic = _only(document, element, "mimic")
    return UrdfJoint(
        name=name,
        type=kind,
        parent=_wanted(document, element, "parent", "link"),
        child=_wanted(document, element, "child", "link"),
        xyz=_vector(document, origin, "xyz", name),
        rpy=_vector(document, origin, "rpy", name),
        axis=_axis(document, axis, name),
        mimic=_wanted(document, element, "mimic", "joint") if mimic else None,
        lower=_number(document, limit, "lower", name),
        upper=_number(document, limit, "upper", name),
        mimic_multiplier=_number(document, mimic, "multiplier", name, 1.0),
        mimic_offset=_number(document, mimic, "offset", name, 0.0),
    )


def _name(document: Document, element: Element) -> str:
    """The name of a <link> or <joint>."""
    name = element.attributes.get("name", "")
    if not name:
        text = f'a <{element.tag}> has no name; give it name="..."'
        raise document.at(element, text)
    return name


def _unique_names(document: Document, elements: Iterable[Element]) -> dict[str, int]:
    """The names, each with its line; refused if one stands twice."""
    lines: dict[str, int] = {}
    for element in elements:
        name = _name(document, element)
        if name in lines:
            text = (
                f"a second {element.tag} '{name}', the first is in line {lines[name]}; rename one"
            )
            raise document.at(element, text)
        lines[name] = element.line
    return lines


def _only(document: Document, element: Element, tag: str) -> Element | None:
    """The child of that name, None without; refused if there are several."""
    found = element.all(tag)
    if len(found) > 1:
        text = f"joint '{element.attributes['name']}' has {len(found)} <{tag}>; keep one"
        raise document.at(element, text)
    return found[0] if found else None


def _wanted(document: Document, element: Element, tag: str, key: str) -> str:
    """The value of ``<tag key="...">`` of a joint, which must be there."""
    part = _only(document, element, tag)
    value = part.attributes.get(key, "") if part else ""
    if not value:
        text = f"joint '{element.attributes['name']}' lacks <{tag} {key}=\"...\">"
        raise document.at(element, text)
    return value


def _numbers(document: Document, part: Element, key: str, count: int, joint: str) -> FloatArray:
    """The finite numbers of an attribute that is there."""
    text = part.attributes[key]
    words = re.split(f"[{_SPACE}]+", text.strip(_SPACE))
    if len(words) == count and all(NUMBER.fullmatch(word) for word in words):
        values = np.array([float(word) for word in words])
        if np.isfinite(values).all():
            if part.tag == "origin" and np.abs(values).max() > FARTHEST:
                message = (
                    f"joint '{joint}': {key} of <origin> is '{text}'; no robot has an origin beyond {FARTHEST:g} "
                    f"{'m' if key == 'xyz' else 'rad'}"
                )
                raise document.at(part, message)
            values.setflags(write=False)
            return values
    wanted = f"{count} finite numbers" if count > 1 else "a finite number"
    message = f"joint '{joint}': {key} of <{part.tag}> is '{text}', {wanted} wanted"
    if "${" in text or "$(" in text:
        message += f"; this is xacro, {XACRO_FIX}"
    raise document.at(part, message)


def _vector(
    document: Document,
    part: Element | None,
    key: str,
    joint: str,
    default: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> FloatArray:
    """The three numbers of an attribute, or the default if it is absent."""
    if part is not None and key in part.attributes:
        return _numbers(document, part, key, 3, joint)
    values = np.array(default)
    values.setflags(write=False)
    return values


def _axis(document: Document, part: Element | None, joint: str) -> FloatArray:
    """The axis as a unit vector."""
    axis = _vector(document, part, "xyz", joint, (1.0, 0.0, 0.0))
    length = math.hypot(*axis)
    if part is not None and length < _ZERO_AXIS:
        text = f"joint '{joint}': the axis is zero; give its direction, xyz=\"0 0 1\" for example"
        raise document.at(part, text)
    axis = axis / length
    axis.setflags(write=False)
    return axis


@overload
def _number(document: Document, part: Element | None, key: str, joint: str) -> float | None: ...
@overload
def _number(
    document: Document, part: Element | None, key: str, joint: str, default: float
) -> float: ...
def _number(
    document: Document, part: Element | None, key: str, joint: str, default: float | None = None
) -> float | None:
    """The number of an attribute, or the default if it is absent."""
    if part is None or key not in part.attributes:
        return default
    return float(_numbers(document, part, key, 1, joint)[0])


def _check_tree(
    document: Document,
    elements: Iterable[Element],
    joints: tuple[UrdfJoint, ...],
    links: Iterable[str],
) -> None:
    """Refuse a link with two parents, several roots, and loops."""
    above: dict[str, UrdfJoint] = {}
    below: dict[str, list[str]] = {}
    for joint, element in zip(joints, elements, strict=True):
        if joint.child in above:
            text = (
                f"link '{joint.child}' is the child of both '{above[joint.child].name}' and "
                f"'{joint.name}'; a URDF is a tree, a closed loop cannot be written in it"
            )
            raise document.at(element, text)
        above[joint.child] = joint
        below.setdefault(joint.parent, []).append(joint.child)
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        message = (
            f"{document.source} has {len(roots)} root links: {choices(roots)}; join them by fixed "
            "joints so that one is left"
        )
        raise UrdfError(message)
    reached = set(roots)
    waiting = list(roots)
    while waiting:
        children = below.get(waiting.pop(), [])
        reached.update(children)
        waiting += children
    loop = [joint.name for joint in joints if joint.child not in reached]
    if loop:
        message = f"{document.source}: the joints {choices(loop)} form a loop; a URDF is a tree"
        raise UrdfError(message)
