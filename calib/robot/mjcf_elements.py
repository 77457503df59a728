"""What elements of an MJCF state: numbers, orientations and poses, with the compiler's settings and the defaults.

Angles are in the unit of ``<compiler angle>``, degrees if it states none. An orientation is a quaternion (w x y z, of
any length), or one of ``axisangle``, ``xyaxes``, ``zaxis`` and ``euler``. The letters of ``eulerseq`` are turns one
after the other, small ones about the axes that turn along (R = R1 R2 R3), capitals about those that stay.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.basics.units import NUMBER
from calib.robot.mjcf_files import Node

ORIENTATIONS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
"""Attributes that state an orientation; an element has one of them at most."""

#: Name of the outermost class of defaults.
_MAIN = "main"

#: A number beyond this is a mistake [m, kg, deg or rad].
_FARTHEST = 1e9

#: A vector that is shorter than this has no direction, as for MuJoCo.
_TINY = 1e-14

_LETTERS = re.compile("[xyzXYZ]{3}")

#: Attributes by name.
Attributes = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Compiler:
    """The settings of ``<compiler>`` that bear on kinematics and masses."""

    #: True if angles are in degrees.
    degrees: bool = True
    #: Letters of the three turns of ``euler``.
    eulerseq: str = "xyz"
    #: True if a joint with a range is limited unless it says otherwise.
    autolimits: bool = True
    #: True if masses follow from the geoms, even where ``<inertial>`` states them.
    inertia_from_geoms: bool = False

    @classmethod
    def of(cls, root: Node) -> Compiler:
        """Return the settings of all ``<compiler>`` of a model, of which a later one counts; they are for all files.

        Raises:
            UrdfError: One has a value that MuJoCo does not know, or global coordinates.
        """
        stated: dict[str, tuple[str, Node]] = {}
        for node in root.all("compiler"):
            stated |= {name: (value, node) for name, value in node.attributes.items()}

        def one_of(name: str, values: tuple[str, ...]) -> str:
            """Return the value of an attribute, the first one if it is not stated."""
            value, node = stated.get(name, (values[0], root))
            if value not in values:
                raise node.at(f"{name} is '{value}'; {' or '.join(values)} is wanted")
            return value

        if stated.get("coordinate", ("local", root))[0] != "local":
            raise stated["coordinate"][1].at(
                "coordinate is 'global', which MuJoCo itself gave up in version 2.3.4; load and save the model with an "
                "older MuJoCo, which writes local coordinates"
            )
        eulerseq, node = stated.get("eulerseq", ("xyz", root))
        if not _LETTERS.fullmatch(eulerseq):
            raise node.at(f"eulerseq is '{eulerseq}'; three of the letters xyzXYZ are wanted")
        return cls(
            degrees=one_of("angle", ("degree", "radian")) == "degree",
            eulerseq=eulerseq,
            autolimits=one_of("autolimits", ("true", "false")) == "true",
            inertia_from_geoms=one_of("inertiafromgeom", ("auto", "true", "false")) == "true",
        )

    @property
    def per_radian(self) -> float:
        """The number that states an angle of one radian."""
        return 180.0 / np.pi if self.degrees else 1.0


@dataclass(frozen=True, slots=True)
class Defaults:
    """The defaults of a model: attributes by class and by name of the element."""

    #: Attributes by class, then by name of the element.
    _classes: dict[str, dict[str, dict[str, str]]] = field(
        default_factory=lambda: {_MAIN: {}}, repr=False
    )

    @classmethod
    def of(cls, root: Node) -> Defaults:
        """Return the defaults of a model; UrdfError if a nested one has no name."""
        defaults = cls()
        for node in root.all("default"):
            defaults._read(node, node.attributes.get("class", _MAIN))
        return defaults

    def _read(self, node: Node, name: str) -> None:
        """Add a class: first its own attributes, then the classes in it, which begin as copies."""
        own = self._classes.setdefault(name, {})
        for child in node.children:
            if child.tag != "default":
                own[child.tag] = merged(own.get(child.tag, {}), child.attributes)
        for child in node.all("default"):
            nested = child.attributes.get("class", "")
            if not nested:
                raise child.at('a nested class of defaults has no name; give it class="..."')
            self._classes[nested] = {tag: dict(values) for tag, values in own.items()}
            self._read(child, nested)

    def attributes(self, node: Node, childclass: str) -> Attributes:
        """Return the attributes of an element, its own ones before those of its class.

        Args:
            node: The element.
            childclass: The class of the bodies and frames around it; empty for none.

        Raises:
            UrdfError: There is no class of the name.
        """
        return self._merged(node, childclass, node.tag)

    def disputed(self, node: Node, childclass: str) -> str | None:
        """Return the orientation of an element's class beside which its own stands; None if its meaning is clear.

        MuJoCo took ``euler`` and the like of a class before an element's own ``quat`` until version 3.14, and takes the
        element's own since 3.17.
        """
        own = orientation_key(node.attributes)
        name = node.attributes.get("class", childclass) or _MAIN
        general = orientation_key(self._classes.get(name, {}).get(node.tag, {}))
        if own is None or general in (None, "quat", own):
            return None
        return general

    def of_equality(self, node: Node) -> Attributes:
        """Return the attributes of an element of ``<equality>``; UrdfError if there is no class of its name."""
        return self._merged(node, "", "equality")

    def _merged(self, node: Node, childclass: str, tag: str) -> Attributes:
        """Return the attributes of an element before those that its class has for a tag."""
        name = node.attributes.get("class", childclass) or _MAIN
        if name not in self._classes:
            raise node.at(f"the class '{name}' is none of the defaults; correct the name")
        return merged(self._classes[name].get(tag, {}), node.attributes)


def merged(general: Attributes, own: Attributes) -> dict[str, str]:
    """Return attributes, the own ones before the general ones; an own orientation takes the place of any other."""
    result = dict(general)
    if any(key in own for key in ORIENTATIONS):
        for key in ORIENTATIONS:
            result.pop(key, None)
    return result | dict(own)


def numbers(node: Node, attributes: Attributes, key: str, default: tuple[float, ...]) -> Array:
    """Return the numbers of an attribute, as many as the default has; that if it is missing.

    Args:
        node: The element, for messages.
        attributes: Its attributes.
        key: Name of the attribute.
        default: The numbers if it is missing.

    Returns:
        Shape (k,).

    Raises:
        UrdfError: Anything else is written.
    """
    if key not in attributes:
        return np.array(default)
    words = attributes[key].split()
    if len(words) == len(default) and all(NUMBER.fullmatch(word) for word in words):
        values = np.array([float(word) for word in words])
        if np.abs(values).max() <= _FARTHEST:
            return values
    wanted = f"{len(default)} numbers" if len(default) > 1 else "a number"
    raise node.at(f"{key} is '{attributes[key]}'; {wanted}, separated by blanks, wanted")


def unit_vector(node: Node, vector: Array, key: str) -> Array:
    """Return a vector (3,) with the length 1; UrdfError if it has no direction."""
    length = float(np.linalg.norm(vector))
    if length < _TINY:
        raise node.at(f"{key} has no direction; give it one, such as 0 0 1")
    return np.asarray(vector / length)


def orientation_key(attributes: Attributes) -> str | None:
    """Return the name of the attribute that states the orientation of an element; None if none does."""
    return next((key for key in ORIENTATIONS if key in attributes), None)


def pose(node: Node, attributes: Attributes, compiler: Compiler) -> Array:
    """Return the pose that pos and orientation of an element state, or the ``fromto`` of a site, shape (4, 4), [m].

    Raises:
        UrdfError: They are not numbers, have no direction, or there are two orientations.
    """
    T = np.eye(4)
    if "fromto" in attributes:
        ends = numbers(node, attributes, "fromto", (0.0,) * 6)
        T[:3, :3] = _least_turn_from_z(unit_vector(node, ends[:3] - ends[3:], "fromto"))
        T[:3, 3] = (ends[:3] + ends[3:]) / 2.0
        return T
    T[:3, :3] = _rotation(node, attributes, compiler)
    T[:3, 3] = numbers(node, attributes, "pos", (0.0, 0.0, 0.0))
    return T


def _rotation(node: Node, attributes: Attributes, compiler: Compiler) -> Array:
    """Return the rotation (3, 3) that an element states; see the module's text."""
    keys = [key for key in ORIENTATIONS if key in attributes]
    if len(keys) > 1:
        raise node.at(f"it has two orientations, {keys[0]} and {keys[1]}; keep one")
    key = keys[0] if keys else "quat"
    if key == "quat":
        quat = numbers(node, attributes, key, (1.0, 0.0, 0.0, 0.0))
        if np.linalg.norm(quat) < _TINY:
            raise node.at("quat is zero; give it a rotation, such as 1 0 0 0")
        return np.asarray(Rotation.from_quat(np.roll(quat, -1)).as_matrix())
    if key == "axisangle":
        values = numbers(node, attributes, key, (0.0,) * 4)
        axis = unit_vector(node, values[:3], key)
        angle = values[3] / compiler.per_radian
        return np.asarray(Rotation.from_rotvec(angle * axis).as_matrix())
    if key == "euler":
        angles = numbers(node, attributes, key, (0.0,) * 3) / compiler.per_radian
        return euler_matrix(compiler.eulerseq, angles)
    if key == "zaxis":
        z = unit_vector(node, numbers(node, attributes, key, (0.0,) * 3), key)
        return _least_turn_from_z(z)
    values = numbers(node, attributes, key, (0.0,) * 6)
    x = unit_vector(node, values[:3], key)
    y = unit_vector(node, values[3:] - (values[3:] @ x) * x, key)
    return np.column_stack([x, y, np.cross(x, y)])


def euler_matrix(eulerseq: str, angles: Array) -> Array:
    """Return the rotation (3, 3) of three turns, angles (3,) [rad]; see the module's text for the letters."""
    R = np.eye(3)
    for letter, angle in zip(eulerseq, angles, strict=True):
        turn = Rotation.from_euler(letter.lower(), angle).as_matrix()
        R = R @ turn if letter.islower() else turn @ R
    return np.asarray(R)


def moving_sequence(eulerseq: str) -> tuple[str, tuple[int, ...]]:
    """Return small letters whose turns are those of ``eulerseq``, and the index of the angle of each.

    A turn about an axis that stays comes before all that were made, so that ``xYz`` is ``yxz`` of the angles 1, 0, 2.
    """
    letters: list[str] = []
    order: list[int] = []
    for index, letter in enumerate(eulerseq):
        place = len(letters) if letter.islower() else 0
        letters.insert(place, letter.lower())
        order.insert(place, index)
    return "".join(letters), tuple(order)


def _least_turn_from_z(z: Array) -> Array:
    """Return the rotation (3, 3) of least angle that takes (0, 0, 1) to a unit vector (3,); about x if that is -z."""
    axis = np.array([-z[1], z[0], 0.0])
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, z[2]))
    if sine < _TINY:
        axis, sine = np.array([1.0, 0.0, 0.0]), 1.0
    return np.asarray(Rotation.from_rotvec(angle * axis / sine).as_matrix())
