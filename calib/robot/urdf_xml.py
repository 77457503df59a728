"""The XML under a URDF: its elements, and where each start tag lies in the file's own bytes.

With these positions one number can be changed while all other bytes (comments, quotes, line ends, encoding) are kept.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from calib.errors import UrdfError

XACRO_FIX = "expand it first: xacro robot.urdf.xacro > robot.urdf; or name it robot.urdf.xacro, and calib expands it"

_DEPTH = 3  # robot / joint / origin: nothing below is of interest
_START_TAG = re.compile(rb"""<([^\s/>"']+)[^<>"']*(?:(?:"[^"]*"|'[^']*')[^<>"']*)*>""")
_ATTRIBUTE = re.compile(rb"""(\s+)([^\s=<>"'/]+)\s*=\s*("[^"]*"|'[^']*')""")

#: Characters that XML 1.0 does not allow anywhere.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(slots=True)
class Element:
    """An element of the upper three levels."""

    tag: str  #: Name of the element.
    attributes: Mapping[str, str]  #: Attribute values as text, references expanded.
    line: int  #: Line of the start tag, from 1.
    start: int  #: First byte of the start tag.
    end: int  #: Byte after the start tag.
    close: int  #: First byte of the end tag; equals ``end`` for a self-closing element.
    children: list[Element]  #: Child elements in the file's order.

    def all(self, tag: str) -> list[Element]:
        """The children of that name."""
        return [child for child in self.children if child.tag == tag]


@dataclass(frozen=True, slots=True)
class Comment:
    """A comment of the file."""

    text: str  #: What stands between its ends.
    start: int  #: First byte of ``<!--``.
    end: int  #: Byte after ``-->``.


@dataclass(frozen=True, slots=True)
class Document:
    """The bytes of an XML file with its upper levels of elements; ``source`` names it in messages."""

    data: bytes
    source: str
    encoding: str
    root: Element
    comments: tuple[Comment, ...]

    @classmethod
    def from_bytes(cls, data: bytes, source: str) -> Document:
        """Parse an XML file."""
        if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in data[:4]:
            raise UrdfError(f"{source} is in UTF-16 or UTF-32; save it as UTF-8")
        try:
            return cls(data, source, *_scan(data, source))
        except expat.ExpatError as error:
            text = data.removeprefix(b"\xef\xbb\xbf").lstrip()
            if not text:
                raise UrdfError(f"{source} is empty; a URDF is wanted") from error
            place = f"line {error.lineno}, column {error.offset + 1}"
            fix = "mend the file there, and save it as UTF-8"
            if not text.startswith(b"<"):
                fix = "it starts with no '<', a URDF is wanted"
            what = expat.ErrorString(error.code)
            raise UrdfError(f"{source} is not XML: {what}, {place}; {fix}") from error
        except (LookupError, ValueError) as error:
            message = f"{source}: its encoding cannot be used ({error}); save it as UTF-8"
            raise UrdfError(message) from error

    def at(self, element: Element, text: str) -> UrdfError:
        """An error that says where: file, line, then ``text``."""
        return UrdfError(f"{self.source}, line {element.line}: {text}")

    def elements(self) -> ElementTree.Element:
        """All elements, their names as written: a prefix need not be declared, as for other readers of URDF."""
        builder = ElementTree.TreeBuilder()
        parser = expat.ParserCreate()
        parser.StartElementHandler = builder.start
        parser.EndElementHandler = builder.end
        parser.Parse(self.data, True)
        return builder.close()

    def line_head(self, position: int) -> bytes | None:
        """The line end and indentation before the tag at ``position``; None if anything else is there."""
        newline = self.data.rfind(b"\n", 0, position)
        head = self.data[newline + 1 : position]
        if newline < 0 or head.strip(b" \t"):
            return None
        return (b"\r\n" if self.data[newline - 1 : newline] == b"\r" else b"\n") + head

    def line_after(self, position: int) -> int:
        """Byte after the line end at ``position``; the position itself if anything else is there."""
        for line_end in (b"\r\n", b"\n"):
            if self.data.startswith(line_end, position):
                return position + len(line_end)
        return position

    def comment(self, text: str) -> bytes:
        """A comment on a line of its own, in the file's encoding and line ends.

        XML allows no ``--`` in a comment: the hyphens are written apart. A character that XML does not allow becomes
        a question mark.
        """
        line = _NOT_XML.sub("?", " ".join(text.split()))
        line = re.sub("-(?=-)", "- ", line)
        line_end = b"\r\n" if b"\r\n" in self.data else b"\n"
        return b"<!-- " + line.encode(self.encoding, "xmlcharrefreplace") + b" -->" + line_end

    def quoted(self, value: str) -> bytes:
        """An attribute value in quotes, escaped, in the encoding of the file."""
        return quoteattr(value).encode(self.encoding, "xmlcharrefreplace")

    def start_tag_with(self, element: Element, values: Mapping[str, str]) -> bytes:
        """The start tag with these attribute values (plain numbers); its other bytes stay.

        An attribute keeps its place and quotes; a missing one is added after the last, spaced and quoted as that is.
        """
        tag = self.data[element.start : element.end]
        name = _START_TAG.match(tag)
        position, last = 0, name.end(1) if name else 0
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
        return b"".join([*pieces, tag[last:]])


def _scan(data: bytes, source: str) -> tuple[str, Element, tuple[Comment, ...]]:
    """The encoding, the outermost element with those below it, and the comments."""
    parser = expat.ParserCreate()
    encodings, xacro = ["utf-8"], {"xacro"}
    above: list[Element] = []  # the elements that are open
    root: list[Element] = []
    comments: list[Comment] = []
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        xacro.update(
            k[6:] for k, v in attributes.items() if k.startswith("xmlns:") and "xacro" in v
        )
        line, first = parser.CurrentLineNumber, parser.CurrentByteIndex
        for name in (tag, *attributes):
            if ":" in name and name.partition(":")[0] in xacro:
                message = f"'{name}' belongs to xacro, not URDF; {XACRO_FIX}"
                raise UrdfError(f"{source}, line {line}: {message}")
        depth += 1
        if depth <= _DEPTH:
            found = _START_TAG.match(data, first)
            # The position is what everything rests on: never go on without it.
            assert found is not None, f"<{tag}> does not stand where the parser says"
            element = Element(tag, attributes, line, first, found.end(), found.end(), [])
            (above[-1].children if above else root).append(element)
            above.append(element)

    def end(_tag: str) -> None:
        nonlocal depth
        depth -= 1
        if depth < _DEPTH:
            element = above.pop()
            if data[element.end - 2 : element.end] != b"/>":
                element.close = parser.CurrentByteIndex

    def comment(text: str) -> None:
        first = parser.CurrentByteIndex
        comments.append(Comment(text, first, data.index(b"-->", first) + len(b"-->")))

    parser.XmlDeclHandler = lambda _version, encoding, _alone: encodings.append(encoding or "utf-8")
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CommentHandler = comment
    parser.Parse(data, True)
    return encodings[-1], root[0], tuple(comments)
