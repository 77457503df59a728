"""The XML under a URDF: its elements, and the bytes of the file where each of them stands.

Only with the position of every start tag in the file's own bytes can one number be changed and all
other bytes be kept: comments, order, quotes, line ends, encoding.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from calib.errors import UrdfError

XACRO_FIX = "expand it first: xacro robot.urdf.xacro > robot.urdf; or name it robot.urdf.xacro, and calib expands it"

_DEPTH = 3  # robot / joint / origin: nothing below is of interest
_START_TAG = re.compile(rb"""<([^\s/>"']+)[^<>"']*(?:(?:"[^"]*"|'[^']*')[^<>"']*)*>""")
_ATTRIBUTE = re.compile(rb"""(\s+)([^\s=<>"'/]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass(frozen=True, slots=True)
class Element:
    """An element and where it stands.

    Attributes:
        tag: Name of the element.
        attributes: Attribute values as text, references expanded.
        line: Line of the start tag, from 1.
        start: First byte of the start tag.
        end: Byte after the start tag.
        close: First byte of the end tag; equals ``end`` for a self-closing element.
        children: Child elements in the file's order; none are kept below the third level.
    """

    tag: str
    attributes: Mapping[str, str]
    line: int
    start: int
    end: int
    close: int
    children: tuple[Element, ...]

    def all(self, tag: str) -> tuple[Element, ...]:
        """The children of that name."""
        return tuple(child for child in self.children if child.tag == tag)


@dataclass(frozen=True, slots=True)
class Document:
    """The bytes of an XML file with its upper three levels of elements.

    Attributes:
        data: The file, byte for byte.
        source: Name of the file, for messages.
        encoding: Encoding of ``data``; always one whose first 128 characters are those of ASCII.
        root: The outermost element.
    """

    data: bytes
    source: str
    encoding: str
    root: Element

    @classmethod
    def from_bytes(cls, data: bytes, source: str) -> Document:
        """Parse an XML file.

        Args:
            data: The file.
            source: Name of the file, for messages.

        Raises:
            UrdfError: Not XML, an encoding whose bytes are not those of ASCII, or a xacro file.
        """
        if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in data[:4]:
            raise UrdfError(f"{source} is in UTF-16 or UTF-32; save it as UTF-8")
        scan = _Scan(data, source)
        try:
            scan.parser.Parse(data, True)
        except expat.ExpatError as error:
            raise UrdfError(_not_xml(data, source, error)) from error
        except (LookupError, ValueError) as error:
            raise UrdfError(
                f"{source}: its encoding cannot be used ({error}); save it as UTF-8"
            ) from error
        return cls(data, source, scan.encoding, scan.root[0])

    def at(self, element: Element, text: str) -> UrdfError:
        """An error that says where: file, line, then ``text``."""
        return UrdfError(f"{self.source}, line {element.line}: {text}")

    def line_head(self, position: int) -> bytes | None:
        """What to write before a sibling of the tag at ``position`` to give it its own line.

        Returns:
            The line end and the indentation before ``position``; None if anything else is there.
        """
        newline = self.data.rfind(b"\n", 0, position)
        head = self.data[newline + 1 : position]
        if newline < 0 or head.strip(b" \t"):
            return None
        return (b"\r\n" if self.data[newline - 1 : newline] == b"\r" else b"\n") + head

    def quoted(self, value: str) -> bytes:
        """An attribute value in quotes, escaped, in the encoding of the file."""
        return quoteattr(value).encode(self.encoding, "xmlcharrefreplace")

    def patched(self, patches: Iterable[tuple[int, int, bytes]]) -> Document:
        """The document with bytes ``start`` to ``end`` replaced, for every (start, end, new)."""
        pieces: list[bytes] = []
        position = 0
        for start, end, new in sorted(patches):
            pieces += [self.data[position:start], new]
            position = end
        pieces.append(self.data[position:])
        return Document.from_bytes(b"".join(pieces), self.source)

    def start_tag_with(self, element: Element, values: Mapping[str, str]) -> bytes:
        """The start tag with those attribute values; the tag's other bytes stay.

        An attribute that the tag has keeps its place and quotes; one that it lacks is added after
        the last, spaced and quoted as that is.

        Args:
            element: Element of this document.
            values: New values by attribute name; plain numbers, nothing that needs escaping.
        """
        tag = self.data[element.start : element.end]
        name = _START_TAG.match(tag)
        position = 0
        last = name.end(1) if name else 0
        space, quote = b" ", b'"'
        pieces: list[bytes] = []
        missing = {key.encode(): value.encode() for key, value in values.items()}
        for found in _ATTRIBUTE.finditer(tag, last):
            space, quote, last = found[1], found[3][:1], found.end()
            new = missing.pop(found[2], None)
            if new is not None:
                pieces += [tag[position : found.start(3)], quote, new, quote]
                position = last
        pieces.append(tag[position:last])
        pieces += [space + key + b"=" + quote + new + quote for key, new in missing.items()]
        pieces.append(tag[last:])
        return b"".join(pieces)


def element_tree(document: Document) -> ElementTree.Element:
    """All elements of a document, their names as written: a prefix need not be declared, as other readers of URDF."""
    builder = ElementTree.TreeBuilder()
    parser = expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.Parse(document.data, True)
    return builder.close()


class _Scan:
    """Expat's handlers and what they gather; lives only while `Document.from_bytes` runs."""

    def __init__(self, data: bytes, source: str) -> None:
        self.data = data
        self.source = source
        self.encoding = "utf-8"
        self.root: list[Element] = []
        self._depth = 0
        self._xacro = {"xacro"}
        self._open: list[tuple[str, dict[str, str], int, int, int, list[Element]]] = []
        self.parser = expat.ParserCreate()
        self.parser.XmlDeclHandler = self._declaration
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end

    def _declaration(self, _version: str, encoding: str | None, _standalone: int) -> None:
        """Note the encoding."""
        self.encoding = encoding or "utf-8"

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        """Note where an element of the upper levels starts."""
        self._refuse_xacro(tag, attributes)
        self._depth += 1
        if self._depth > _DEPTH:
            return
        start = self.parser.CurrentByteIndex
        found = _START_TAG.match(self.data, start)
        # The position is what everything rests on: never go on without it.
        assert found is not None, f"<{tag}> does not stand where the parser says"
        line = self.parser.CurrentLineNumber
        self._open.append((tag, attributes, line, start, found.end(), []))

    def _end(self, _tag: str) -> None:
        """Close the element and hand it to its parent."""
        self._depth -= 1
        if self._depth >= _DEPTH:
            return
        tag, attributes, line, start, end, children = self._open.pop()
        self_closing = self.data[end - 2 : end] == b"/>"
        close = end if self_closing else self.parser.CurrentByteIndex
        element = Element(tag, attributes, line, start, end, close, tuple(children))
        (self._open[-1][5] if self._open else self.root).append(element)

    def _refuse_xacro(self, tag: str, attributes: dict[str, str]) -> None:
        """Refuse elements and attributes of xacro; its namespace alone may stay declared."""
        for key, value in attributes.items():
            if key.startswith("xmlns:") and "xacro" in value:
                self._xacro.add(key.partition(":")[2])
        for name in (tag, *attributes):
            if ":" in name and name.partition(":")[0] in self._xacro:
                line = self.parser.CurrentLineNumber
                raise UrdfError(
                    f"{self.source}, line {line}: '{name}' belongs to xacro, not URDF; {XACRO_FIX}"
                )


def _not_xml(data: bytes, source: str, error: expat.ExpatError) -> str:
    """Say where the XML breaks, and what the file may be instead."""
    text = data.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not text:
        return f"{source} is empty; a URDF is wanted"
    place = f"line {error.lineno}, column {error.offset + 1}"
    what = f"{source} is not XML: {expat.ErrorString(error.code)}, {place}"
    if not text.startswith(b"<"):
        return f"{what}; it starts with no '<', a URDF is wanted"
    return f"{what}; mend the file there, and save it as UTF-8"
