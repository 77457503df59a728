"""What a xacro may do while it is flattened: work out expressions, and read files of the folders that it was given.

The ``xacro`` package has Python evaluate expressions, opens whatever file is named and never stops. In the fresh copy
of it that one file is flattened by, these parts are replaced by calib's own.
"""

# ruff: noqa: ANN401  the xacro package has no types

from __future__ import annotations

import glob
import io
import keyword
import math
import os
import re
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.parsers import expat

import yaml

from calib.model.expression_functions import Functions
from calib.model.expressions import Budget, Evaluator, Refused
from calib.model.given_folders import GivenFolders
from calib.model.yaml_file import check_weight

__all__ = ["guard"]

#: Largest file that a xacro reads [bytes]: a xacro, itself among them, a YAML; longest text in it [characters].
_LIMIT_XML, _LIMIT_YAML, _LIMIT_TEXT = 2_000_000, 1_000_000, 200_000

#: The most elements of a xacro file, and the most in one another.
_MOST_ELEMENTS, _DEEPEST = 100_000, 200

#: What the call of a macro costs, an element, and a text without expressions.
_MACRO, _ELEMENT, _TEXT = 100, 3, 3

#: As xacro's own, without the nested repetition that makes a long word take for ever.
_DEFAULT = r"""\$\{.*?\}|\$\(.*?\)|(?:'[^']*'|\"[^\"]*\"|[^\s'\"])+|"""
_MACRO_ARGUMENT = re.compile(rf"^\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?({_DEFAULT})(?:\s+|$)(.*)")


def guard(xacro: Any, given: Callable[[], GivenFolders]) -> None:
    """Replace what a xacro could do harm by.

    Args:
        xacro: A fresh copy of the package.
        given: The folders that files may lie in; more as packages are found.
    """
    budget = Budget()
    files = _Files(xacro, given)
    evaluator = _evaluator(xacro, budget, files)

    def safe_eval(expression: str, names: Any, _locals: Any = None) -> Any:
        value = evaluator(expression, names)
        budget.weigh(value)  # before it is made part of a text
        return value

    xacro.safe_eval = safe_eval
    xacro.load_yaml = files.load_yaml
    xacro.parse = files.parse
    xacro.glob = types.SimpleNamespace(glob=files.glob)
    xacro.is_valid_name = lambda name: name.isidentifier() and not keyword.iskeyword(name)
    xacro.re_macro_arg = _MACRO_ARGUMENT
    _count(xacro, budget)
    _replace_eval(xacro, evaluator)


def _evaluator(xacro: Any, budget: Budget, files: _Files) -> Evaluator:
    """What works out the expressions, with the functions that xacro lends."""
    lent = xacro._global_symbols
    ours = Functions(budget).by_name()
    python, own = lent["python"], lent["xacro"]
    names = [
        (name, value) for space in (lent, python, lent["math"]) for name, value in space.items()
    ]
    known = [(value, ours[name]) for name, value in names if callable(value) and name in ours]
    xacros = {**own, "load_yaml": files.load_yaml, "tokenize": _tokenize}
    known += [(own[name], xacros[name]) for name in own]
    known += [(lent[name], xacros[name]) for name in own if name in lent]  # by their former names
    functions = {id(value): function for value, function in known}
    return Evaluator(budget, functions, (xacro.Table,), tuple(value for value, _ in known))


def _tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    """The words of a text between any of the characters."""
    parts = re.split(f"[{re.escape(sep)}]", text) if sep else [text]
    return [part for part in parts if part] if skip_empty else parts


def _count(xacro: Any, budget: Budget) -> None:
    """Let every element and text cost: macros that call macros grow without bound."""
    eval_text, eval_all, call = xacro.eval_text, xacro.eval_all, xacro.handle_macro_call

    def text_counted(text: Any, symbols: Any) -> Any:
        if len(text) > _LIMIT_TEXT:
            message = f"a text of {len(text):,} characters; {_LIMIT_TEXT:,} are the most in a xacro"
            raise Refused(message)
        # The reader of texts copies what is left of one at each $.
        budget.spend(_TEXT + len(text) * (1 + text.count("$")) // 1000)
        return eval_text(text, symbols)

    def all_counted(node: Any, macros: Any, symbols: Any) -> None:
        budget.spend(_ELEMENT)
        eval_all(node, macros, symbols)

    def call_counted(node: Any, macros: Any, symbols: Any) -> Any:
        budget.spend(_MACRO if node.tagName.startswith("xacro:") else 0)
        return call(node, macros, symbols)

    xacro.eval_text, xacro.eval_all, xacro.handle_macro_call = (
        text_counted,
        all_counted,
        call_counted,
    )


def _replace_eval(xacro: Any, evaluator: Evaluator) -> None:
    """``$(eval ...)``, which has all of Python, by the expressions of ``${...}``."""
    from xacro import substitution_args as args

    lent = xacro._global_symbols
    plain = {name: value for name, value in vars(math).items() if name[0] != "_"}
    plain |= {name: lent["python"][name] for name in lent["python"] if name != "vars"}
    ours = {
        args._eval_env: args._eval_env,
        args._eval_optenv: args._eval_optenv,
        args._eval_find: args._eval_find,
    }

    def worked_out(text: str, context: dict[str, Any]) -> str:
        given = context.setdefault("arg", {})

        def arg(name: str) -> Any:
            return args.convert_value(args._eval_arg(name, args=given), "auto")

        def dirname() -> str:
            return str(args._eval_dirname(context["filename"]))

        functions = {
            "arg": arg,
            "dirname": dirname,
            "env": args._eval_env,
            "optenv": args._eval_optenv,
        }
        functions["find"] = args._eval_find
        known = {id(value): value for value in (arg, dirname, *ours)}
        one = Evaluator(evaluator.budget, {**evaluator.functions, **known}, evaluator.namespaces)
        names = {"true": True, "false": False, **plain, **functions}
        return str(one(text, _Arguments(names, given, arg)))

    args._eval = worked_out


class _Arguments:
    """The names of ``$(eval ...)``: functions, then the arguments of the xacro."""

    def __init__(self, names: dict[str, Any], given: Any, value: Callable[[str], Any]) -> None:
        self._names, self._given, self._value = names, given, value

    def __contains__(self, name: object) -> bool:
        return name in self._names or name in self._given

    def __getitem__(self, name: str) -> Any:
        return self._names[name] if name in self._names else self._value(name)


class _Files:
    """The files that a xacro reads, each out of a given folder."""

    def __init__(self, xacro: Any, given: Callable[[], GivenFolders]) -> None:
        self._xacro, self._given = xacro, given

    def parse(self, inp: Any, filename: str | None = None) -> Any:
        """A xacro file as a document, as the package's own function."""
        import xml.dom.minidom

        if inp is None:
            try:
                inp = self._read(os.path.join(self._xacro.root_dir, str(filename)), _LIMIT_XML)  # noqa: PTH118
            except OSError as error:
                self._xacro.filestack.pop()  # the file that names it is at fault
                message = f"{error.strerror}: {error.filename}"
                raise self._xacro.XacroException(message, exc=error) from error
        if isinstance(inp, str):
            _check_xml(inp)
            return xml.dom.minidom.parseString(inp)
        return inp

    def load_yaml(self, filename: str) -> Any:
        """The content of a YAML file, as the package's own function."""
        xacro = self._xacro
        filename = xacro.abs_filename_spec(filename)
        stream: Any = _Named(self._read(filename, _LIMIT_YAML))
        stream.name = filename
        xacro.filestack.append(filename)
        try:
            loader = _loader(xacro)(stream)
            node = loader.get_single_node()
            if node is None:
                return None
            check_weight(node)
            return xacro.YamlListWrapper.wrap(loader.construct_document(node))
        finally:
            xacro.filestack.pop()
            xacro.all_includes.append(filename)

    def glob(self, pattern: str) -> list[str]:
        """The files of a pattern."""
        fixed = re.split(r"[*[?]", pattern, maxsplit=1)[0]
        self._check(os.path.dirname(fixed) or ".")  # noqa: PTH120
        return [found for found in glob.glob(pattern) if self._given().hold(Path(found))]  # noqa: PTH207

    def _read(self, filename: str, limit: int) -> str:
        """A text file of a given folder.

        Raises:
            Refused: It lies elsewhere, is none, or is too large.
            OSError: It cannot be read.
        """
        self._check(filename)
        path = Path(filename)
        if path.exists() and not path.is_file():
            message = f"'{filename}' is no file"
            raise Refused(message)
        with path.open("rb") as file:
            data = file.read(limit + 1)
        if len(data) > limit:
            message = f"'{filename}' is larger than {limit:,} bytes, the most that is read"
            raise Refused(message)
        return data.decode()

    def _check(self, filename: str) -> None:
        """Refuse a file outside of the given folders."""
        if not self._given().hold(Path(filename)):
            message = (
                f"'{filename}' lies outside the folder and the ROS package of the xacro; name it as an argument, or "
                "its folder in ROS_PACKAGE_PATH"
            )
            raise Refused(message)


class _Named(io.StringIO):
    """A text with the name of its file."""

    name: str = ""


def _loader(xacro: Any) -> type[yaml.SafeLoader]:
    """PyYAML's safe loader with xacro's units."""

    class Loader(yaml.SafeLoader):
        yaml_constructors = dict(yaml.constructor.SafeConstructor.yaml_constructors)  # noqa: RUF012

    for unit in xacro.ConstructUnits:
        Loader.add_constructor(unit.value.tag, unit.constructor)
    return Loader


def _check_xml(text: str) -> None:
    """Refuse what would take much memory as a document: entities that stand for others, more elements than a robot has.

    Raises:
        Refused: There is one of these.
        xml.parsers.expat.ExpatError: It is not XML.
    """
    count, depth = 0, 0

    def doctype(*_: object) -> None:
        message = "a <!DOCTYPE> declaration has no place in a xacro, and entities are not expanded; delete it"
        raise Refused(message)

    def start(*_: object) -> None:
        nonlocal count, depth
        count, depth = count + 1, depth + 1
        if count > _MOST_ELEMENTS or depth > _DEEPEST:
            message = f"it has more than {_MOST_ELEMENTS:,} elements, or {_DEEPEST} in one another; no xacro has"
            raise Refused(message)

    def end(_tag: str) -> None:
        nonlocal depth
        depth -= 1

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(text, True)
