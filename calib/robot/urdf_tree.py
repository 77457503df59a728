"""The kinematic tree that a URDF states: its joints and links, checked, with the place and the remedy of each fault.

A URDF is in metres and radians. One whose joints are tens of metres apart is in millimetres, one with angles of many
turns in degrees; both are refused, because every number that is computed from them would be wrong.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only
from calib.basics.units import NUMBER
from calib.basics.values import Value
from calib.errors import UrdfError, choices, did_you_mean
from calib.robot.urdf_xml import XACRO_FIX, Document, Element

#: The types of joints of URDF.
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")

#: An axis that is written shorter than this has no direction.
_ZERO_AXIS = 1e-9

#: If half of the joints are further than this from their parents [m], lengths are in millimetres.
_FAR = 10.0

#: If an origin is turned by more than this, two turns [rad], angles are in degrees.
_TURNED = 4.0 * np.pi

#: A limit of a joint above this, two turns [rad], may be in degrees.
_TURNS = 4.0 * np.pi

#: A limit of a joint above this, two turns [deg], is not in degrees.
_MOST_DEGREES = 720.0

#: Limits in degrees are multiples of this [deg].
_STEP_DEGREES = 5.0

#: The limit to write, for messages, by the type of a joint that has none.
_LIMITS = {
    "revolute": 'lower="-3.14" upper="3.14" effort="0" velocity="0"/>, in rad, or the type "continuous"',
    "prismatic": 'lower="0" upper="1" effort="0" velocity="0"/>, in m',
}


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint(Value):
    """A joint as the URDF states it."""

    #: Name of the joint.
    name: str
    #: One of `JOINT_TYPES`.
    type: str
    #: Name of the parent link.
    parent: str
    #: Name of the child link.
    child: str
    #: Translation of the origin in the parent link, (3,) [m].
    xyz: Array
    #: Rotation of the origin about the fixed x, y, z axes, (3,) [rad].
    rpy: Array
    #: Unit vector in the joint's frame, (3,); (1, 0, 0) for fixed and floating joints.
    axis: Array
    #: Name of the joint that drives this one, or None.
    mimic: str | None
    #: Lower limit [rad or m]; None if none is stated or the type has none.
    lower: float | None
    #: Upper limit [rad or m], or None.
    upper: float | None
    #: Factor of the driving joint's value.
    mimic_multiplier: float = 1.0
    #: Added to it [rad or m].
    mimic_offset: float = 0.0

    @property
    def T_parent_joint(self) -> Array:
        """The origin: pose of the joint's frame in the parent link, (4, 4) [m]."""
        T = np.eye(4)
        T[:3, :3] = pin.rpy.rpyToMatrix(*self.rpy)
        T[:3, 3] = self.xyz
        return read_only(T)


def read_tree(document: Document) -> tuple[tuple[UrdfJoint, ...], tuple[str, ...]]:
    """Return the joints and the names of the links, both in the file's order.

    Raises:
        UrdfError: It is not a URDF that can be calibrated; the text says where and why.
    """
    root = document.root
    elements = root.all("joint")
    if root.tag != "robot":
        formats = {
            "sdf": "SDF (Gazebo), which calib does not read: give the URDF or xacro that it was made from, or turn it "
            "into an MJCF by sdf2mjcf of the package sdformat-mjcf",
            "mujocoinclude": "a part of an MJCF: give the main file, which includes it",
            "COLLADA": "a COLLADA mesh",
        }
        likely = f", it looks like {formats[root.tag]}" if root.tag in formats else ""
        text = f"the outermost element is <{root.tag}>{likely}; a URDF has <robot>"
        raise document.at(root, text)
    if not elements:
        text = "<robot> has no <joint>; a URDF with the joints themselves is wanted"
        raise document.at(root, text)
    links = _unique_names(document, root.all("link"))
    _unique_names(document, elements)
    joints = tuple(_joint(document, element) for element in elements)
    _check_tree(document, joints, links)
    _check_units(document, joints)
    return joints, links


def _unique_names(document: Document, elements: list[Element]) -> tuple[str, ...]:
    """Return the names of links or joints; UrdfError if one is missing or given twice."""
    lines: dict[str, int] = {}
    for element in elements:
        name = element.attributes.get("name", "")
        if not name:
            text = f'a <{element.tag}> has no name; give it name="..."'
            raise document.at(element, text)
        if name in lines:
            text = (
                f"a second {element.tag} '{name}', the first is in line {lines[name]}; rename one"
            )
            raise document.at(element, text)
        lines[name] = element.line
    return tuple(lines)


def _joint(document: Document, element: Element) -> UrdfJoint:
    """Return the joint that a ``<joint>`` states; UrdfError if it is not complete."""
    kind = element.attributes.get("type", "")
    if kind not in JOINT_TYPES:
        text = f" has the type '{kind}'; the types are {choices(JOINT_TYPES)}"
        raise _fault(document, element, text)
    numbers = partial(_numbers, document, element)
    zeros = (0.0, 0.0, 0.0)
    axis: tuple[float, ...] = (1.0, 0.0, 0.0)
    if kind not in ("fixed", "floating"):
        axis = numbers("axis", "xyz", axis)
    direction = read_only(axis)
    length = float(np.linalg.norm(direction))
    if length < _ZERO_AXIS:
        text = ': the axis is zero; give its direction, xyz="0 0 1" for example'
        raise _fault(document, element, text)
    # Effort and velocity may be missing or -1, which has no effect here.
    limit = _part(document, element, "limit")
    if limit is None and kind in _LIMITS:
        text = f" is {kind} and has no <limit>; give it <limit {_LIMITS[kind]}"
        raise _fault(document, element, text)
    lower = upper = None
    if kind in ("revolute", "prismatic"):
        lower = _limit(document, element, "lower")
        upper = _limit(document, element, "upper")
    return UrdfJoint(
        name=element.attributes["name"],
        type=kind,
        parent=_link(document, element, "parent"),
        child=_link(document, element, "child"),
        xyz=read_only(numbers("origin", "xyz", zeros)),
        rpy=read_only(numbers("origin", "rpy", zeros)),
        axis=read_only(direction / length),
        mimic=_link(document, element, "mimic", "joint") if element.all("mimic") else None,
        lower=lower,
        upper=upper,
        mimic_multiplier=numbers("mimic", "multiplier", (1.0,))[0],
        mimic_offset=numbers("mimic", "offset", (0.0,))[0],
    )


def _limit(document: Document, element: Element, key: str) -> float | None:
    """Return a joint's limit ``"lower"`` or ``"upper"`` [rad or m]; None if it is not stated."""
    (value,) = _numbers(document, element, "limit", key, (np.nan,))
    return None if np.isnan(value) else value


def _fault(
    document: Document,
    element: Element,
    text: str,
    part: Element | None = None,
) -> UrdfError:
    """Return an error about a joint, with the line of one of its parts, or of the joint itself if that is None."""
    return document.at(part or element, f"joint '{element.attributes['name']}'{text}")


def _part(document: Document, element: Element, tag: str) -> Element | None:
    """Return the joint's child of that name, None if there is none; UrdfError if there are several."""
    parts = element.all(tag)
    if len(parts) > 1:
        raise _fault(document, element, f" has {len(parts)} <{tag}>; keep one")
    return parts[0] if parts else None


def _link(document: Document, element: Element, tag: str, key: str = "link") -> str:
    """Return the value of ``<tag key="...">``; UrdfError if there is none."""
    part = _part(document, element, tag)
    value = part.attributes.get(key, "") if part else ""
    if not value:
        raise _fault(document, element, f' lacks <{tag} {key}="...">')
    return value


def _numbers(
    document: Document,
    element: Element,
    tag: str,
    key: str,
    default: tuple[float, ...],
) -> tuple[float, ...]:
    """Return the finite numbers of ``<tag key="...">`` of a joint, as many as the default has; that if it is missing.

    UrdfError if anything else is written.
    """
    part = _part(document, element, tag)
    if part is None or key not in part.attributes:
        return default
    text = part.attributes[key]
    words = re.split("[ \t\r\n]+", text.strip(" \t\r\n"))  # XML's white space only
    if len(words) == len(default) and all(NUMBER.fullmatch(word) for word in words):
        values = tuple(float(word) for word in words)
        if np.isfinite(values).all():
            return values
    expected = f"{len(default)} finite numbers" if len(default) > 1 else "a finite number"
    fault = f": {key} of <{tag}> is '{text}', {expected} wanted"
    if "${" in text or "$(" in text:
        fault += f"; this is xacro, {XACRO_FIX}"
    raise _fault(document, element, fault, part)


def _check_tree(document: Document, joints: tuple[UrdfJoint, ...], links: tuple[str, ...]) -> None:
    """Refuse by UrdfError links that do not exist or have two parents, several roots, and loops."""
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
    reached: set[str] = set()
    new = set(roots)
    while new:
        reached |= new
        new = {joint.child for joint in joints if joint.parent in reached} - reached
    loop = sorted(joint.name for joint in joints if joint.child not in reached)
    if loop:
        raise UrdfError(
            f"{document.source}: the joints {choices(loop)} form a loop; a URDF is a tree"
        )


def _check_units(document: Document, joints: tuple[UrdfJoint, ...]) -> None:
    """Refuse by UrdfError a URDF whose lengths look like millimetres, or its angles or limits like degrees."""
    lengths = [float(np.linalg.norm(joint.xyz)) for joint in joints]
    apart = [length for length in lengths if length > 0.0]
    typical = float(np.median(apart)) if apart else 0.0
    if typical > _FAR:
        raise UrdfError(
            f"{document.source}: half of the joints lie more than {typical:.0f} m from their parents; lengths of a "
            "URDF are in metres, and these look like millimetres. Divide every xyz by 1000, and the limits of "
            "prismatic joints too"
        )
    for joint, element in zip(joints, document.root.all("joint"), strict=True):
        if np.abs(joint.rpy).max() > _TURNED:
            angles = " ".join(f"{angle:g}" for angle in joint.rpy)
            text = (
                f": rpy of <origin> is '{angles}'; angles of a URDF are in radians, and these look like degrees. "
                "Multiply every rpy by pi/180, and the limits of revolute joints too"
            )
            raise _fault(document, element, text)
    turning = [joint for joint in joints if joint.type == "revolute"]
    in_degrees = [joint for joint in turning if _looks_like_degrees(joint)]
    if 2 * len(in_degrees) > len(turning):
        first = in_degrees[0]
        element = document.root.all("joint")[joints.index(first)]
        text = (
            f" has the limits {first.lower:g} to {first.upper:g}; limits of a URDF are in radians, and these look like "
            "degrees. Multiply them by pi/180; a joint that turns without end is of the type continuous"
        )
        raise _fault(document, element, text)


def _looks_like_degrees(joint: UrdfJoint) -> bool:
    """Return True for limits that are round numbers, more than two turns in radians, and at most two in degrees."""
    if joint.lower is None or joint.upper is None:
        return False
    ends = np.array([joint.lower, joint.upper])
    size = float(np.abs(ends).max())
    # 100 and 1000 mean no limit at all.
    placeholder = float(np.log10(max(size, 1.0))).is_integer()
    round_numbers = not np.any(ends % _STEP_DEGREES)
    return _TURNS < size <= _MOST_DEGREES and round_numbers and not placeholder
