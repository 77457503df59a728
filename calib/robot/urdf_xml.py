"""The XML of a URDF: its elements, and the position of each start tag in the file's own bytes.

With these positions one number can be changed while all other bytes (comments, quotes, line ends, encoding) are kept.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from xml.etree import ElementTree
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from calib.errors import UrdfError

#: The remedy, for messages about a URDF that contains xacro.
XACRO_FIX = "expand it first: xacro robot.urdf.xacro > robot.urdf; or name it robot.urdf.xacro, and calib expands it"

#: Number of levels of elements that are recorded: robot, joint, origin.
_DEPTH = 3

#: A start tag, in which quotes may hide its end; group 1 is its name.
_START_TAG = re.compile(rb"""<([^\s/>"']+)[^<>"']*(?:(?:"[^"]*"|'[^']*')[^<>"']*)*>""")

#: An attribute of a start tag: the space before it, its name, its value in quotes.
_ATTRIBUTE = re.compile(rb"""(\s+)([^\s=<>"'/]+)\s*=\s*("[^"]*"|'[^']*')""")

#: Blanks before an XML declaration, which XML does not allow there, and the declaration.
_LATE_DECLARATION = re.compile(rb"\A(\s+)(<\?xml\s.*?\?>)", re.DOTALL)

#: Characters that XML 1.0 does not allow anywhere.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(slots=True)
class Element:
    """An element of the upper levels."""

    #: Name of the element.
    tag: str
    #: Attribute values as text, references expanded.
    attributes: Mapping[str, str]
    #: Line of the start tag, from 1.
    line: int
    #: First byte of the start tag.
    start: int
    #: Byte after the start tag.
    end: int
    #: First byte of the end tag; equals ``end`` for a self-closing element.
    close: int
    #: Child elements in the file's order.
    children: list[Element]

    def all(self, tag: str) -> list[Element]:
        """Return the children of that name, in the file's order."""
        return [child for child in self.children if child.tag == tag]


@dataclass(frozen=True, slots=True)
class Comment:
    """A comment of the file."""

    #: Its text, between ``<!--`` and ``-->``.
    text: str
    #: First byte of ``<!--``.
    start: int
    #: Byte after ``-->``.
    end: int


@dataclass(frozen=True, slots=True)
class Document:
    """The bytes of an XML file with its upper levels of elements."""

    #: The file, byte for byte; blanks before its XML declaration stand after it.
    data: bytes
    #: Its name, for messages.
    source: str
    #: Its encoding, from the XML declaration; UTF-8 without one.
    encoding: str
    #: The outermost element.
    root: Element
    #: All comments, in the file's order.
    comments: tuple[Comment, ...]

    @classmethod
    def from_bytes(
        cls,
        data: bytes,
        source: str,
        what: str = "URDF",
        depth: int = _DEPTH,
        *,
        xacro: bool = False,
    ) -> Document:
        """Parse an XML file.

        Blanks before its XML declaration, as generators leave them, are put after it: lines keep their numbers.

        Args:
            data: The file, byte for byte.
            source: Its name, for messages.
            what: The kind of file that is wanted, for messages.
            depth: Number of levels of elements that are recorded.
            xacro: True to take elements and attributes of xacro as any others.

        Raises:
            UrdfError: It is not XML, empty, xacro, or of an encoding that cannot be used; the text says where.
        """
        if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in data[:4]:
            raise UrdfError(f"{source} is in UTF-16 or UTF-32; save it as UTF-8")
        data = _LATE_DECLARATION.sub(rb"\2\1", data)
        try:
            parser = expat.ParserCreate()
            scanner = _Scanner(data, source, parser, depth, xacro)
            parser.XmlDeclHandler = scanner.declaration
            parser.StartElementHandler = scanner.start
            parser.EndElementHandler = scanner.end
            parser.CommentHandler = scanner.comment
            parser.Parse(data, True)
        except expat.ExpatError as error:
            text = data.removeprefix(b"\xef\xbb\xbf").lstrip()
            if not text:
                raise UrdfError(f"{source} is empty; a {what} is wanted") from error
            place = f"line {error.lineno}, column {error.offset + 1}"
            fix = "mend the file there, and save it as UTF-8"
            if not text.startswith(b"<"):
                fix = f"it starts with no '<', a {what} is wanted"
            fault = expat.ErrorString(error.code)
            raise UrdfError(f"{source} is not XML: {fault}, {place}; {fix}") from error
        except (LookupError, ValueError) as error:
            message = f"{source}: its encoding cannot be used ({error}); save it as UTF-8"
            raise UrdfError(message) from error
        assert scanner.root is not None, "the parser accepts no file without an element"
        return cls(data, source, scanner.encoding, scanner.root, tuple(scanner.comments))

    def at(self, element: Element, text: str) -> UrdfError:
        """Return an error that says where: file, line, then a text.

        Args:
            element: The element at fault.
            text: The fault and its remedy.
        """
        return UrdfError(f"{self.source}, line {element.line}: {text}")

    def elements(self) -> ElementTree.Element:
        """Return all elements as a new tree, their names as written, also with prefixes that are not declared."""
        builder = ElementTree.TreeBuilder()
        parser = expat.ParserCreate()
        parser.StartElementHandler = builder.start
        parser.EndElementHandler = builder.end
        parser.Parse(self.data, True)
        return builder.close()

    def line_head(self, position: int) -> bytes | None:
        """Return the line end and indentation before the tag at a byte position; None if it shares its line."""
        newline = self.data.rfind(b"\n", 0, position)
        head = self.data[newline + 1 : position]
        if newline < 0 or head.strip(b" \t"):
            return None
        line_end = b"\r\n" if self.data[newline - 1 : newline] == b"\r" else b"\n"
        return line_end + head

    def line_after(self, position: int) -> int:
        """Return the byte position after a line end at ``position``; the position itself if there is none."""
        for line_end in (b"\r\n", b"\n"):
            if self.data.startswith(line_end, position):
                return position + len(line_end)
        return position

    def comment(self, text: str) -> bytes:
        """Return a comment on a line of its own, in the file's encoding and line ends.

        XML allows no ``--`` in a comment, so that hyphens are separated. A character that XML does not allow becomes a
        question mark.
        """
        line = _NOT_XML.sub("?", " ".join(text.split()))
        line = re.sub("-(?=-)", "- ", line)
        line_end = b"\r\n" if b"\r\n" in self.data else b"\n"
        return b"<!-- " + line.encode(self.encoding, "xmlcharrefreplace") + b" -->" + line_end

    def patched(self, patches: Iterable[tuple[int, int, bytes]]) -> bytes:
        """Return the file with the bytes from start to before end replaced, for every (start, end, new bytes)."""
        data = self.data
        for start, end, new in sorted(patches, reverse=True):
            data = data[:start] + new + data[end:]
        return data

    def quoted(self, value: str) -> bytes:
        """Return an attribute value in quotes, escaped, in the encoding of the file."""
        return quoteattr(value).encode(self.encoding, "xmlcharrefreplace")

    def start_tag_with(
        self,
        element: Element,
        values: Mapping[str, str],
        renamed: Mapping[str, str] = MappingProxyType({}),
    ) -> bytes:
        """Return the start tag of an element with other attribute values; its other bytes stay.

        An attribute keeps its place and quotes; a missing one is added after the last, spaced and quoted as that is.

        Args:
            element: The element.
            values: Plain numbers as text, by the attribute's name.
            renamed: New names of attributes, whose values are in ``values`` by the new name.
        """
        tag = self.data[element.start : element.end]
        name = _START_TAG.match(tag)
        missing = {key.encode(): value.encode() for key, value in values.items()}
        pieces: list[bytes] = []
        copied = 0  # bytes of the tag that are in the pieces
        last = name.end(1) if name else 0  # end of the last attribute
        space = b" "
        quote = b'"'
        for attribute in _ATTRIBUTE.finditer(tag, last):
            space = attribute[1]
            quote = attribute[3][:1]
            last = attribute.end()
            key = renamed.get(attribute[2].decode("utf-8", "replace"), "").encode()
            if key:
                pieces += [tag[copied : attribute.start(2)], key]
                copied = attribute.end(2)
            value = missing.pop(key or attribute[2], None)
            if value is not None:
                pieces += [tag[copied : attribute.start(3)], quote, value, quote]
                copied = last
        pieces.append(tag[copied:last])
        for key, value in missing.items():
            pieces.append(space + key + b"=" + quote + value + quote)
        pieces.append(tag[last:])
        return b"".join(pieces)


@dataclass(slots=True)
class _Scanner:
    """Handlers of a parser that record the elements of the upper levels, the comments and the encoding of a file."""

    #: The file.
    data: bytes
    #: Its name, for messages.
    source: str
    #: The parser that calls the handlers.
    parser: expat.XMLParserType
    #: Number of levels of elements that are recorded.
    depth: int
    #: True to take elements of xacro.
    takes_xacro: bool
    #: Encoding, from the XML declaration.
    encoding: str = "utf-8"
    #: The outermost element.
    root: Element | None = None
    comments: list[Comment] = field(default_factory=list)
    #: The elements of the upper levels that are open.
    _open: list[Element] = field(default_factory=list)
    #: Number of all elements that are open.
    _depth: int = 0
    #: Prefixes of xacro's names.
    _xacro: set[str] = field(default_factory=lambda: {"xacro"})

    def declaration(self, _version: str, encoding: str | None, _standalone: int) -> None:
        """Record the encoding that the XML declaration states, UTF-8 without one."""
        self.encoding = encoding or "utf-8"

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Record an element whose start tag was read; UrdfError if its name or attributes have a prefix of xacro."""
        line = self.parser.CurrentLineNumber
        first = self.parser.CurrentByteIndex
        for name, value in attributes.items():
            if name.startswith("xmlns:") and "xacro" in value:
                self._xacro.add(name.removeprefix("xmlns:"))
        for name in (tag, *attributes):
            prefix, colon, local = name.partition(":")
            # A property that nothing uses has no effect; where one is used, the number has a dollar sign.
            if colon and prefix in self._xacro and local != "property" and not self.takes_xacro:
                message = f"'{name}' belongs to xacro, not URDF; {XACRO_FIX}"
                raise UrdfError(f"{self.source}, line {line}: {message}")
        self._depth += 1
        if self._depth > self.depth:
            return
        match = _START_TAG.match(self.data, first)
        # All changes rely on this position: never go on without it.
        assert match is not None, f"<{tag}> does not stand where the parser says"
        element = Element(tag, attributes, line, first, match.end(), match.end(), [])
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)

    def end(self, _tag: str) -> None:
        """Record where the end tag of an element begins."""
        self._depth -= 1
        if self._depth < self.depth:
            element = self._open.pop()
            if self.data[element.end - 2 : element.end] != b"/>":
                element.close = self.parser.CurrentByteIndex

    def comment(self, text: str) -> None:
        """Record the text of a comment and its place in the bytes."""
        first = self.parser.CurrentByteIndex
        last = self.data.index(b"-->", first) + len(b"-->")
        self.comments.append(Comment(text, first, last))
