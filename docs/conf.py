"""Sphinx configuration: ``make docs`` builds the site of these pages into ``site/`` and loads nothing from the network.

The pages are plain Markdown that can also be read as files. This module adapts them for Sphinx: links out of this
folder, docstrings with indented equations, names of calib independent of the module that defines them, and pages that
are in no table of contents yet.
"""

from __future__ import annotations

import ast
import re
import shutil
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing
from docutils import nodes  # type: ignore[import-untyped]
from docutils.utils.math import latex2mathml  # type: ignore[import-untyped]
from pygments.lexers.special import TextLexer  # type: ignore[import-untyped]
from sphinx.addnodes import desc_signature, pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))  # for `python -m sphinx` from another folder

import calib  # noqa: E402


def _named(name: str) -> type:
    """Return a type that Sphinx shows by this name alone."""
    return type(name, (), {"__module__": "builtins"})


class _Arrays:
    """Replacement of NDArray that is shown as "Array" in place of numpy.ndarray[tuple[Any, ...], ...]."""

    def __class_getitem__(cls, number: type) -> type:
        """Return the type of an array of these numbers: Array, BoolArray or IntArray."""
        names = {"b": "BoolArray", "i": "IntArray"}
        kind = "f" if number is np.floating else np.dtype(number).kind
        return _named(names.get(kind, "Array"))


# The modules of calib are imported by autodoc, after this line.
vars(numpy.typing).update(NDArray=_Arrays, ArrayLike=_named("ArrayLike"))

project = "calib"
author = "The calib developers"
copyright = author
version = release = calib.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_design"]
root_doc = "index"
nitpicky = True
smartquotes = False
default_role = "py:obj"
suppress_warnings = ["config.cache"]

# Anchors of headings are those of Git hosts, so that links work in both places.
myst_heading_anchors = 4
# Equations, as Git hosts typeset them; here they become MathML, which browsers draw without a script.
myst_fence_as_directive = {"math"}
html_math_renderer = "mathml"

autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_attr_annotations = True
napoleon_use_rtype = False
python_maximum_signature_line_length = 90
python_use_unqualified_type_names = True

# Code blocks without a language are tables or printed output, which need no colours.
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

#: Headings of docstring sections; the text below them is indented, but no equation.
_SECTION = re.compile(r"(Args|Attributes|Example|Examples|Raises|Returns|Yields):$")

#: Objects in whose docstring napoleon takes text before the first colon for a type.
_TYPED = {"property", "attribute", "data"}

#: Character that replaces colons of such docstrings while napoleon runs.
_COLON = "\N{RATIO}"

#: An attribute as written by napoleon: head, text, type.
_ATTRIBUTE = re.compile(r"(\.\. attribute:: \w+\n)\n((?:   .*\n|\n)*?)   :type: (.*)\n")

#: Public classes that only functions of calib make; their constructors are not documented.
_RESULTS = {"Calibration", "Commands", "Comparison", "Evaluation", "Plan", "Robot"}

#: Beginnings of names of other packages; these are shown as text, without a link.
_FOREIGN = (
    "collections.",
    "concurrent.",
    "datetime.",
    "Figure",
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
    """Connect the functions below with Sphinx's events."""
    app.add_lexer("csv", TextLexer)
    app.add_html_math_renderer("mathml", (_inline_math, None), (_display_math, None))
    app.connect("source-read", _read_page)
    app.connect("autodoc-process-docstring", _docstring, priority=400)  # before napoleon
    app.connect("autodoc-process-docstring", _types, priority=600)  # after it
    app.connect("autodoc-process-signature", _signature)
    app.connect("doctree-read", _short_contents, priority=400)  # before the contents are collected
    app.connect("missing-reference", _elsewhere)
    app.connect("build-finished", _copy_pages)


def _copy_pages(app: Sphinx, error: Exception | None) -> None:
    """Put the list of pages for assistants into the site, and the pages as they are written, to which it leads."""
    if error is None:
        for page in (HERE / "llms.txt", *HERE.glob("*.md")):
            shutil.copy(page, app.outdir)


def _read_page(_: Sphinx, _name: str, source: list[str]) -> None:
    """Fill in the generated lists of a page, and adapt its links to the site."""
    text = source[0]
    text = re.sub(
        r"^( *)\.\. unlisted$", lambda m: _lines(m[1], _unlisted()), text, flags=re.MULTILINE
    )
    text = re.sub(r"^\.\. modules:: ([\w/]*)$", lambda m: _modules(m[1]), text, flags=re.MULTILINE)
    # A link whose text is a file name shows the title of the page.
    text = re.sub(r"\[([\w-]+\.md)\]\((\1(?:#[\w-]+)?)\)", r"[](\2)", text)
    text = re.sub(r"\]\(\.\./CHANGELOG\.md(#[\w-]+)?\)", r"](changelog.rst\1)", text)
    # Folders and sources are not part of the site.
    text = re.sub(r"\[([^][]+)\]\(\.\./[^)]*\)", r"\1", text)
    source[0] = text


def _inline_math(translator: Any, node: nodes.math) -> None:  # noqa: ANN401  of Sphinx's many builders
    """Write an equation within a line."""
    translator.body.append(latex2mathml.tex2mathml(node.astext()))
    raise nodes.SkipNode


def _display_math(translator: Any, node: nodes.math_block) -> None:  # noqa: ANN401
    """Write an equation that stands alone."""
    equation = latex2mathml.tex2mathml(node.astext(), as_block=True)
    translator.body.append(f'<div class="equation">{equation}</div>\n')
    raise nodes.SkipNode


def _lines(indent: str, names: list[str]) -> str:
    return "\n".join(indent + name for name in names)


def _unlisted() -> list[str]:
    """Return the pages that are in no table of contents."""
    named = set(
        re.findall(r"^   ([\w-]+)$", (HERE / "index.rst").read_text(encoding="utf-8"), re.MULTILINE)
    )
    return sorted({path.stem for path in HERE.glob("*.md")} - named)


def _modules(folder: str) -> str:
    """Return the docstrings of the modules of a folder of calib and of those in it, as reStructuredText.

    "" is calib itself, without its folders.
    """
    root = HERE.parent
    place = root / "calib" / folder
    entries = []
    for path in sorted(place.rglob("*.py") if folder else place.glob("*.py")):
        if not path.stem.startswith("__"):
            title = ".".join(path.relative_to(root).with_suffix("").parts)
            docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            text = _shown(docstring.split("\n"))
            entries.append("\n".join([f".. rubric:: ``{title}``", "", *text]))
    return "\n\n".join(entries)


def _docstring(
    _: Sphinx, what: str, _name: str, _obj: object, _options: object, lines: list[str]
) -> None:
    """Mark the indented blocks of a docstring, which are equations or tables, as literal blocks."""
    if what in _TYPED:  # napoleon would take the text before the first colon for a type
        lines[:] = [line.replace(":", _COLON) for line in lines]
    lines[:] = _shown(lines)


def _shown(lines: list[str]) -> list[str]:
    """Return the lines of a docstring with its indented blocks marked as literal."""
    text: list[str] = []
    before = ""  # the last line that is not blank
    literal = False
    for index, line in enumerate(lines):
        indented = line.startswith("    ")
        if indented and not literal and index and not lines[index - 1] and _is_prose(before):
            literal = not line.lstrip().startswith(">>>")
            text += ["::", ""] if literal else []
        literal = literal and (indented or not line)
        text.append(line if literal else _linked(line.replace("|", r"\|")))
        before = line or before
    return text


def _linked(line: str) -> str:
    """Return a line in which names of pages are links."""
    return re.sub(r"(?<!`)\bdocs/([\w-]+)\.md\b", r":doc:`/\1`", line)


def _is_prose(line: str) -> bool:
    """Return True for a line of running text: not indented, no list item, no heading of a section."""
    return bool(line) and not line.startswith((" ", "- ")) and not _SECTION.match(line)


def _types(
    _: Sphinx, what: str, _name: str, _obj: object, _options: object, lines: list[str]
) -> None:
    """Restore colons, and put the type of an attribute next to its name, where its parts become links."""
    text = "\n".join(lines)
    if what in _TYPED:
        text = text.replace(_COLON, ":")
    text = _ATTRIBUTE.sub(r"\1   :type: \3\n\n\2", text)
    lines[:] = text.split("\n")


def _signature(
    _: Sphinx, what: str, name: str, _obj: object, _options: object, args: str | None, returns: str
) -> tuple[str, str] | None:
    """Return the signature to show; none for classes that users do not construct."""
    if what == "class" and (name.count(".") > 1 or name.rpartition(".")[2] in _RESULTS):
        return ("", returns) if args else None
    # The text of a default factory is no Python and would prevent links.
    return (args.replace("<factory>", "..."), returns) if args else None


def _short_contents(_: Sphinx, page: nodes.document) -> None:
    """Omit members of classes from the contents of a page, which list the classes only."""
    for signature in page.findall(desc_signature):
        if signature.parent["objtype"] in {"attribute", "property", "method"}:
            signature["_toc_name"] = ""


def _elsewhere(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, shown: nodes.TextElement
) -> nodes.Node | None:
    """Resolve a name by its last part if one documented object has it; show other known names as text."""
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    last = target.rpartition(".")[2]
    domain = env.domains.python_domain
    documented = [name for name in domain.objects if name == last or name.endswith(f".{last}")]
    if f"calib.{last}" in documented:  # the public name, not the module that defines it
        documented = [f"calib.{last}"]
    if len(documented) == 1 and not target.startswith(_FOREIGN):
        name = documented[0]
        kind = "obj" if node["reftype"] == "obj" else domain.objects[name].objtype
        return domain.resolve_xref(env, node["refdoc"], app.builder, kind, name, node, shown)
    # Types without a page of their own are shown by name.
    known = target.startswith(("calib ", *_FOREIGN)) or last in _names()
    return shown if known else None


@cache
def _names() -> frozenset[str]:
    """Return the names of all modules, folders, classes, functions and variables of calib."""
    names: set[str] = set()
    for path in (HERE.parent / "calib").rglob("*.py"):
        names |= {path.stem, path.parent.name}
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
                names.add(node.name)
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                names.add(node.id)
    return frozenset(names)
