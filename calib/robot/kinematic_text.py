"""The part of a URDF that states joints and masses, as a text that every reader of URDFs takes.

Readers refuse a whole file for a material that is defined twice, a colour of five numbers, a geometry that they do not
know, an effort of -1 or a tab between two numbers. Nothing of that bears on where a robot is, so it is left out before
another reader sees the file. The numbers of an ``<origin>`` and an ``<axis>`` stay as they are written, to be read
again by that reader.
"""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from calib.basics.units import NUMBER
from calib.robot.urdf import Urdf
from calib.robot.urdf_tree import UrdfJoint

#: The types of joints that have an axis.
_WITH_AXIS = ("revolute", "continuous", "prismatic", "planar")

#: Efforts and velocities are not used; readers want both, positive [N or Nm, rad/s or m/s].
_ANY_LOAD = {"effort": "1", "velocity": "1"}

#: Gravity does not act on moments of inertia [kg m^2].
_NO_INERTIA = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0")


def kinematic_text(urdf: Urdf) -> str:
    """Return a URDF's links with their masses, and its joints without mimics, and nothing else.

    The robot is called ``robot`` if it has no name. A link whose mass, or whose centre of mass, is not written in
    numbers has none.

    Args:
        urdf: The robot.

    Returns:
        The text of a URDF.
    """
    elements = urdf.elements()
    robot = Element("robot", name=urdf.name or "robot")
    for link in elements.findall("link"):
        _add_link(robot, link)
    for joint, element in zip(urdf.joints, elements.findall("joint"), strict=True):
        _add_joint(robot, joint, element)
    return ElementTree.tostring(robot, encoding="unicode")


def _add_link(robot: Element, link: Element) -> None:
    """Add a link with its mass and centre of mass to a robot."""
    result = SubElement(robot, "link", name=link.get("name", ""))
    inertial = link.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    if inertial is None or mass is None:
        return
    origin = _numbers_of(inertial, "origin", ("xyz", "rpy"), 3)
    value = _numbers(mass.get("value", ""), 1)
    if origin is None or value is None:
        return
    body = SubElement(result, "inertial")
    SubElement(body, "origin", origin)
    SubElement(body, "mass", value=value)
    SubElement(body, "inertia", _NO_INERTIA)


def _add_joint(robot: Element, joint: UrdfJoint, element: Element) -> None:
    """Add a joint to a robot, its origin and axis in the numbers of its element."""
    result = SubElement(robot, "joint", name=joint.name, type=joint.type)
    SubElement(result, "parent", link=joint.parent)
    SubElement(result, "child", link=joint.child)
    # The tree has been checked: what is written in them are numbers.
    SubElement(result, "origin", _numbers_of(element, "origin", ("xyz", "rpy"), 3) or {})
    if joint.type in _WITH_AXIS:
        axis = _numbers_of(element, "axis", ("xyz",), 3)
        if axis:
            SubElement(result, "axis", axis)
        SubElement(result, "limit", _ANY_LOAD)


def _numbers_of(
    element: Element, tag: str, keys: tuple[str, ...], count: int
) -> dict[str, str] | None:
    """Return the numbers of attributes of an element's child, single blanks between them; None if one has others.

    Attributes that are missing are left out, all of them if the child is missing.
    """
    child = element.find(tag)
    result: dict[str, str] = {}
    for key in keys:
        if child is None or key not in child.attrib:
            continue
        numbers = _numbers(child.attrib[key], count)
        if numbers is None:
            return None
        result[key] = numbers
    return result


def _numbers(text: str, count: int) -> str | None:
    """Return a text of that many numbers with single blanks between them; None if it is another text."""
    words = text.split()
    if len(words) != count or not all(NUMBER.fullmatch(word) for word in words):
        return None
    return " ".join(words)
