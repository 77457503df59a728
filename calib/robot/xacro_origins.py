"""A corrected xacro: the numbers of joint origins changed where they stand in its files, every other byte as it was.

Which element of which file a flattened joint's ``<origin>`` comes from is said by xacro itself, for which the elements
are marked (`calib.robot.xacro_file`). Only numbers can be changed: what arguments, properties and parameters of macros
give is named with the value that it would need. A literal origin of a macro that makes several joints has one place for
several corrections, and cannot be changed either.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from calib.basics.units import NUMBER
from calib.errors import UrdfError
from calib.robot.urdf import SAME, Urdf, origin_attributes
from calib.robot.urdf_xml import Document, Element
from calib.robot.xacro_file import MARK, XacroCall, flatten_with_marks

#: Origins of the xacro and of the result, and of the written xacro and the corrected robot, are the same within this
#: [m; rotation matrices: 1].
_TOLERANCE = 1e-9

#: An expression of xacro: ``${...}``, or ``$(arg NAME)``.
_EXPRESSION = re.compile(r"\$\{[^}]*\}|\$\([^)]*\)")

#: A word of an attribute, in which an expression may hold blanks.
_WORD = re.compile(r"(?:\$\{[^}]*\}|\$\([^)]*\)|\S)+")

#: A name in an expression, without what follows a point or stands in quotes.
_NAME = re.compile(r"""(?<![\w.'"])[A-Za-z_]\w*""")


@dataclass(frozen=True, slots=True)
class _Source:
    """A file of a xacro, with its elements in order."""

    path: Path
    document: Document
    elements: tuple[Element, ...]

    @classmethod
    def read(cls, path: Path) -> _Source:
        """Read a file; the elements' numbers are those of the marks."""
        data = path.read_bytes()
        document = Document.from_bytes(data, path.name, "xacro", sys.maxsize, xacro=True)
        return cls(path, document, tuple(_walk(document.root)))


def _walk(element: Element) -> Iterator[Element]:
    """Yield an element and all below it, in the order of the file."""
    yield element
    for child in element.children:
        yield from _walk(child)


def corrected_xacro(call: XacroCall, nominal: Urdf, corrected: Urdf) -> dict[Path, bytes]:
    """Return the files of a xacro that a correction changes, with their new bytes.

    Args:
        call: The xacro and its arguments.
        nominal: The URDF that it was flattened to when the result was made.
        corrected: The same with corrected origins.

    Returns:
        The new bytes by the absolute path of the file that they correct; flattened, they are the corrected robot.

    Raises:
        FileError: There is no such xacro.
        UrdfError: It is another robot now; or an origin to be changed does not stand in it in numbers, or stands for
            several joints: the text names each, and what it would need.
    """
    text, files = flatten_with_marks(call)
    _check_same(Urdf.from_bytes(_unmarked(text), call.name), nominal, f"'{call.name}'")
    joints = {
        element.get("name", ""): element
        for element in ElementTree.fromstring(text).findall("joint")
    }
    uses = Counter(
        origin.get(MARK) for element in joints.values() for origin in element.findall("origin")
    )
    uses.update(element.get(MARK) for element in joints.values() if element.find("origin") is None)
    sources = [_Source.read(file) for file in files]
    faults: list[str] = []
    patches: dict[Path, list[tuple[int, int, bytes]]] = {}
    for joint in nominal.joints:
        T = corrected.joint(joint.name).T_parent_joint
        differs = np.abs(T - joint.T_parent_joint) > SAME
        changed = {"xyz": bool(differs[:3, 3].any()), "rpy": bool(differs[:3, :3].any())}
        values = {key: text for key, text in origin_attributes(T).items() if changed[key]}
        if not values:
            continue
        element = joints[joint.name]
        origin = element.find("origin")
        mark = (element if origin is None else origin).get(MARK)
        if mark is None:
            faults.append(
                f"the origin of '{joint.name}' is made by <xacro:element>: {_needs(values)}"
            )
            continue
        number, index = map(int, mark.split(":"))
        source = sources[number]
        place = source.elements[index]
        where = f"{source.path.name}, line {place.line}, joint '{joint.name}'"
        if uses[mark] > 1:
            faults.append(
                f"{where}: one origin stands for {uses[mark]} joints, of a macro that is called several times; give it "
                f"as a parameter of the macro, which here {_needs(values)}"
            )
        elif origin is None:
            tag = '<origin xyz="{xyz}" rpy="{rpy}"/>'.format(**origin_attributes(T)).encode()
            if source.document.data[place.end - 2 : place.end] == b"/>":
                faults.append(f"{where}: it has no content; {_needs(values)}")
                continue
            patches.setdefault(source.path, []).append((place.end, place.end, tag))
        else:
            stated = [key for key in values if not _is_literal(place.attributes.get(key, ""))]
            faults += [
                f"{where}: {_who_states(place.attributes[key], values[key], key, sources)}"
                for key in stated
            ]
            if not stated:
                new = source.document.start_tag_with(place, values)
                patches.setdefault(source.path, []).append((place.start, place.end, new))
    if faults:
        raise UrdfError(
            f"{call.name}: these origins are not numbers in its text, so that no corrected xacro is written. Change "
            "them by hand, or let the xacro read its origins from a file (calib convert --to origins).\n  "
            + "\n  ".join(faults)
        )
    result = {
        source.path: source.document.patched(patches[source.path])
        for source in sources
        if source.path in patches
    }
    again, _ = flatten_with_marks(call, result)
    _check_same(Urdf.from_bytes(_unmarked(again), call.name), corrected, "the corrected xacro")
    return result


def _unmarked(text: str) -> bytes:
    """Return a flattened text without marks."""
    return re.sub(rf' {MARK}="[^"]*"', "", text).encode()


def _check_same(read: Urdf, expected: Urdf, name: str) -> None:
    """Refuse by `UrdfError` a flattened xacro whose joints are not those of a URDF."""
    joints = {joint.name: joint for joint in read.joints}
    for joint in expected.joints:
        other = joints.get(joint.name)
        if other is None or not np.allclose(
            other.T_parent_joint, joint.T_parent_joint, rtol=0.0, atol=_TOLERANCE
        ):
            raise UrdfError(
                f"{name}, flattened, has the joint '{joint.name}' elsewhere than the result, or not at all. Give the "
                "xacro and the arguments with which the result was made, as --robot."
            )


def _is_literal(text: str) -> bool:
    """Return True for an attribute that is missing or is numbers."""
    return all(NUMBER.fullmatch(word) for word in text.split())


def _needs(values: Mapping[str, str]) -> str:
    """Say which values an origin would need."""
    return "needs " + " and ".join(f'{key}="{value}"' for key, value in values.items())


def _who_states(text: str, value: str, key: str, sources: list[_Source]) -> str:
    """Say what gives an attribute that is no numbers, where, and which value each part would need."""
    words = _WORD.findall(text)
    wanted = value.split()
    parts = []
    if len(words) != len(wanted):
        words, wanted = [text], [value]
    for word, number in zip(words, wanted, strict=True):
        if _is_literal(word):
            if float(word) != float(number):
                parts.append(f"{word} needs to be {number}")
            continue
        names = dict.fromkeys(
            name
            for expression in _EXPRESSION.findall(word)
            for name in _NAME.findall(expression.removeprefix("$(arg"))
        )
        places = [place for name in names for place in _defined(name, sources)]
        by = f" ({', '.join(places)})" if places else ""
        parts.append(f"{word}{by} needs to be {number}")
    return f'{key}="{text}": {", ".join(parts)}'


def _defined(name: str, sources: list[_Source]) -> Iterator[str]:
    """Yield where files define a property, an argument, or a parameter of a macro of a name."""
    for source in sources:
        for element in source.elements:
            local = element.tag.partition(":")[2]
            where = f"{source.path.name}, line {element.line}"
            if local in ("property", "arg") and element.attributes.get("name") == name:
                yield f"{'argument' if local == 'arg' else 'property'} {name}: {where}"
            elif local == "macro":
                given = re.findall(r"[*\w]+", element.attributes.get("params", ""))
                if name in given:
                    yield f"parameter {name} of {element.attributes.get('name', '')}: {where}"
