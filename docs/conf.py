"""How Sphinx makes the site of these pages: ``make docs`` builds it into ``site/``, and loads nothing from the network.

The pages are plain Markdown that reads as well where the files lie. What Sphinx needs besides stands here: links that
leave this folder, docstrings with indented equations, names of calib wherever they are defined, and pages that no table
of contents names yet.
"""

from __future__ import annotations

import ast
import re
import sys
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing
from docutils import nodes  # type: ignore[import-untyped]
from pygments.lexers.special import TextLexer  # type: ignore[import-untyped]
from sphinx.addnodes import desc_signature, pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))  # as `python -m sphinx` from another folder does not

import calib  # noqa: E402


def _named(name: str) -> type:
    """A type that is shown by this name alone."""
    return type(name, (), {"__module__": "builtins"})


class _Arrays:
    """In place of NDArray: "Array" says more than numpy.ndarray[tuple[Any, ...], numpy.dtype[numpy.float64]]."""

    def __class_getitem__(cls, number: type) -> type:
        """The array of numbers of a type."""
        kinds = {"b": _named("BoolArray"), "i": _named("IntArray")}
        kind = "f" if number is np.floating else np.dtype(number).kind
        return kinds.get(kind, _named("Array"))


# The modules of calib are imported by autodoc, after this line.
vars(numpy.typing).update(NDArray=_Arrays, ArrayLike=_named("ArrayLike"))

project = "calib"
author = "The calib developers"
copyright = author
version = release = calib.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
nitpicky = True
smartquotes = False
default_role = "py:obj"
suppress_warnings = ["config.cache"]

# A heading's anchor is what hosts of Git repositories make of it, so that links work in both places.
myst_heading_anchors = 4

autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_attr_annotations = True
napoleon_use_rtype = False
python_maximum_signature_line_length = 90
python_use_unqualified_type_names = True

# What does not say what it is, is a table or what a program printed: nothing to colour.
highlight_language = "text"
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = f"calib {release}"
html_static_path = ["static"]
html_css_files = ["calib.css"]
html_copy_source = False
html_show_sphinx = False
pygments_style = "friendly"
pygments_dark_style = "github-dark"

#: Sections of a docstring, whose text is indented for another reason than an equation.
_SECTION = re.compile(r"(Args|Attributes|Example|Examples|Raises|Returns|Yields):$")

#: What napoleon takes the first colon of for the end of a type, and what stands for a colon meanwhile.
_TYPED, _COLON = {"property", "attribute", "data"}, "\N{RATIO}"

#: An attribute as napoleon writes it: its head, its text, its type.
_ATTRIBUTE = re.compile(r"(\.\. attribute:: \w+\n)\n((?:   .*\n|\n)*?)   :type: (.*)\n")

#: Classes of calib that only its functions make.
_GIVEN = {
    "Calibration",
    "Commands",
    "Comparison",
    "Evaluation",
    "Plan",
} | {
    "Robot",
}

#: What other packages' names begin with. They are shown as text: their pages lie elsewhere.
_FOREIGN = (
    "collections.",
    "concurrent.",
    "matplotlib.",
    "meshcat.",
    "numpy.",
    "os.",
    "pathlib.",
    "pinocchio.",
    "np.",
    "Array",
    "BoolArray",
    "IntArray",
)


def setup(app: Sphinx) -> None:
    """Connect what follows."""
    app.add_lexer("csv", TextLexer)
    app.connect("source-read", _read_page)
    app.connect("autodoc-process-docstring", _docstring, priority=400)  # before napoleon
    app.connect("autodoc-process-docstring", _types, priority=600)  # after it
    app.connect("autodoc-process-signature", _signature)
    app.connect("doctree-read", _short_contents, priority=400)  # before the contents are collected
    app.connect("missing-reference", _elsewhere)


def _read_page(_: Sphinx, _name: str, source: list[str]) -> None:
    """Fill in the lists that follow from the files, and lead links to where the site has their pages."""
    text = source[0]
    text = re.sub(
        r"^( *)\.\. unlisted$", lambda m: _lines(m[1], _unlisted()), text, flags=re.MULTILINE
    )
    text = re.sub(r"^\.\. modules:: (\w*)$", lambda m: _modules(m[1]), text, flags=re.MULTILINE)
    # A link that shows a file's name shows the page's title here.
    text = re.sub(r"\[([\w-]+\.md)\]\((\1(?:#[\w-]+)?)\)", r"[](\2)", text)
    text = re.sub(r"\]\(\.\./CHANGELOG\.md(#[\w-]+)?\)", r"](changelog.rst\1)", text)
    # Folders and sources are not part of the site.
    text = re.sub(r"\[([^][]+)\]\(\.\./[^)]*\)", r"\1", text)
    source[0] = text


def _lines(indent: str, names: list[str]) -> str:
    return "\n".join(indent + name for name in names)


def _unlisted() -> list[str]:
    """Pages that no table of contents names."""
    named = set(
        re.findall(r"^   ([\w-]+)$", (HERE / "index.rst").read_text(encoding="utf-8"), re.MULTILINE)
    )
    return sorted({path.stem for path in HERE.glob("*.md")} - named)


def _modules(folder: str) -> str:
    """What each module of a folder says of itself; of no folder: the modules beside the folders."""
    place = HERE.parent / "calib" / folder
    entries = []
    for path in sorted(place.glob("*.py")):
        if not path.stem.startswith("__"):
            title = ".".join(["calib", *([folder] if folder else []), path.stem])
            said = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            entries.append("\n".join([f".. rubric:: ``{title}``", "", *_shown(said.split("\n"))]))
    return "\n\n".join(entries)


def _docstring(
    _: Sphinx, what: str, _name: str, _obj: object, _options: object, lines: list[str]
) -> None:
    """Make an indented block of a docstring's text, which is an equation or a table, one that keeps its lines."""
    if what in _TYPED:  # napoleon would take what stands before the first colon for a type
        lines[:] = [line.replace(":", _COLON) for line in lines]
    lines[:] = _shown(lines)


def _shown(lines: list[str]) -> list[str]:
    """The lines of a docstring, whose indented blocks stay as they stand."""
    text: list[str] = []
    before, drawn = "", False
    for index, line in enumerate(lines):
        indented = line.startswith("    ")
        if indented and not drawn and index and not lines[index - 1] and _is_prose(before):
            drawn = not line.lstrip().startswith(">>>")
            text += ["::", ""] if drawn else []
        drawn = drawn and (indented or not line)
        text.append(line if drawn else _linked(line.replace("|", r"\|")))
        before = line or before
    return text


def _linked(line: str) -> str:
    """A line with the pages that it names as links."""
    return re.sub(r"(?<!`)\bdocs/([\w-]+)\.md\b", r":doc:`/\1`", line)


def _is_prose(line: str) -> bool:
    """Whether a line is one of running text: neither indented, nor in a list, nor the head of a section."""
    return bool(line) and not line.startswith((" ", "- ")) and not _SECTION.match(line)


def _types(
    _: Sphinx, what: str, _name: str, _obj: object, _options: object, lines: list[str]
) -> None:
    """Give colons back, and put the type of an attribute beside its name, where names in it become links."""
    text = "\n".join(lines)
    if what in _TYPED:
        text = text.replace(_COLON, ":")
    text = _ATTRIBUTE.sub(r"\1   :type: \3\n\n\2", text)
    lines[:] = text.split("\n")


def _signature(
    _: Sphinx, what: str, name: str, _obj: object, _options: object, args: str | None, returns: str
) -> tuple[str, str] | None:
    """No signature of a class that users are given and do not make: its attributes stand below it."""
    if what == "class" and (name.count(".") > 1 or name.rpartition(".")[2] in _GIVEN):
        return ("", returns) if args else None
    # A default that a function makes, such as an empty table, is no Python and would stop the links.
    return (args.replace("<factory>", "..."), returns) if args else None


def _short_contents(_: Sphinx, page: nodes.document) -> None:
    """Leave what a class has out of the list of a page's contents: the classes themselves are long enough a list."""
    for signature in page.findall(desc_signature):
        if signature.parent["objtype"] in {"attribute", "property", "method"}:
            signature["_toc_name"] = ""


def _elsewhere(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, shown: nodes.TextElement
) -> nodes.Node | None:
    """A name by its last part where one documented thing is called so; one that exists, but has no entry, as text."""
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    last = target.rpartition(".")[2]
    domain = env.domains.python_domain
    found = [name for name in domain.objects if name == last or name.endswith(f".{last}")]
    found = [f"calib.{last}"] if f"calib.{last}" in found else found  # and not where it is defined
    if len(found) == 1 and not target.startswith(_FOREIGN):
        kind = "obj" if node["reftype"] == "obj" else domain.objects[found[0]].objtype
        return domain.resolve_xref(env, node["refdoc"], app.builder, kind, found[0], node, shown)
    # What these values are made of in turn is shown by name: it has no page of its own.
    known = target.startswith(("calib ", *_FOREIGN)) or last in _names()
    return shown if known else None


@cache
def _names() -> frozenset[str]:
    """Every name that calib's modules define, and theirs."""
    found: set[str] = set()
    for path in (HERE.parent / "calib").rglob("*.py"):
        found |= {path.stem, path.parent.name}
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
                found.add(node.name)
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                found.add(node.id)
    return frozenset(found)
