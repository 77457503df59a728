"""Xacro files: flattened to a URDF by the ``xacro`` package, with the arguments behind their name.

The package keeps what it is doing in its own module: which file, which macro, which arguments. Each file is therefore
flattened by a fresh copy of that module, one at a time, and what the package says goes into no stream of calib's.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import re
import shlex
import sys
import threading
import types
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.errors import UrdfError, choices
from calib.model.files import expanded_name, read_bytes
from calib.model.given_folders import GivenFolders, listed_folders, own_folder
from calib.model.ros_packages import find_package
from calib.model.urdf import LIMIT_BYTES, Urdf
from calib.model.urdf_joints import did_you_mean
from calib.model.xacro_faults import PackageMissing, fault_text, heard
from calib.model.xacro_guard import guard

__all__ = ["XacroCall", "is_xacro", "read_xacro"]

_ENDING = ".xacro"
_FILE = re.compile(r"\.xacro(?=\s|$)", re.IGNORECASE)
_ARGUMENT = re.compile(r"([^\s:=\"']+):=(.*)", re.DOTALL)
_BETWEEN = re.compile(r"\s+(?=[^\s:=\"']+:=)")
_QUOTES = ('"', "'")
_AMENT = "ament_index_python.packages"
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True, slots=True)
class XacroCall:
    """A xacro file and what is behind it.

    Attributes:
        path: The file.
        arguments: Names and values, in the order given.
    """

    path: Path
    arguments: tuple[tuple[str, str], ...] = ()

    @classmethod
    def parse(cls, source: str | os.PathLike[str]) -> XacroCall:
        """The file and the arguments of a text such as ``"ur.urdf.xacro ur_type:=ur5e name:=ur"``.

        A value may have spaces in it, and quotes around it; it may be empty.

        Raises:
            UrdfError: What is behind the file are no arguments, or one is given twice.

        Example:
            >>> XacroCall.parse("ur.urdf.xacro ur_type:=ur5e name:='my arm'").arguments
            (('ur_type', 'ur5e'), ('name', 'my arm'))
        """
        text = os.fspath(source)
        ends = [found.end() for found in _FILE.finditer(text)]
        if _is_file(text):
            ends = [len(text)]
        # A folder may have the ending, too: the first part that is a file, or else the first.
        end = next((end for end in ends if _is_file(text[:end])), ends[0] if ends else len(text))
        path = Path(text[:end])
        given: dict[str, str] = {}
        for piece in filter(None, _BETWEEN.split(text[end:].strip())):
            found = _ARGUMENT.fullmatch(piece)
            if found is None:
                message = (
                    f"'{piece}' behind {path.name} is no argument of a xacro; write NAME:=VALUE, as in "
                    f'"{path.name} prefix:=left_"'
                )
                raise UrdfError(message)
            name, value = found[1], found[2].strip()
            if name in given:
                message = (
                    f"{path.name}: the argument '{name}' is given twice; leave one of them out"
                )
                raise UrdfError(message)
            if len(value) > 1 and value[0] == value[-1] and value[0] in _QUOTES:
                value = value[1:-1]
            given[name] = value
        return cls(path.expanduser() if path.parts[:1] == ("~",) else path, tuple(given.items()))

    @property
    def name(self) -> str:
        """The file's name with the arguments, as one writes them on a line: what messages and results call it."""
        return " ".join(self._words)

    @property
    def command(self) -> str:
        """What flattens the file, to be typed into a shell."""
        return f"xacro {shlex.join(self._words)}"

    @property
    def _words(self) -> list[str]:
        """The file's name and each argument."""
        return [self.path.name, *(f"{name}:={value}" for name, value in self.arguments)]


def is_xacro(source: str | os.PathLike[str]) -> bool:
    """Whether this names a xacro file, with or without arguments.

    Example:
        >>> is_xacro("ur.urdf.xacro ur_type:=ur5e"), is_xacro("ur5e.urdf")
        (True, False)
    """
    text = os.fspath(source)
    if _is_file(text):
        return text.lower().endswith(_ENDING)
    return _FILE.search(text) is not None


def read_xacro(source: str | os.PathLike[str] | XacroCall) -> Urdf:
    """Flatten a xacro file, and read what comes out as a URDF.

    ``$(find package)`` is what `calib.model.ros_packages.find_package` finds. The URDF's ``data`` are the flattened
    text as ``xacro FILE`` writes it, but for the folder in the remark at its head, its ``path`` is that of the file,
    and its ``source`` the file's name with the arguments.

    Args:
        source: The file, and behind it arguments as in ``"ur.urdf.xacro ur_type:=ur5e name:=ur"``.

    Raises:
        FileError: The file cannot be read.
        UrdfError: The xacro package is not installed, the file cannot be flattened, an argument is not one of its, or
            what comes out is no URDF.
    """
    call = source if isinstance(source, XacroCall) else XacroCall.parse(source)
    read_bytes(call.path, "xacro file", LIMIT_BYTES)
    data, said = _flattened(call)
    try:
        return Urdf.from_bytes(data, call.name, call.path)
    except UrdfError as error:
        message = (
            f"{str(error).rstrip('.')}. This is about the flattened text, which `{call.command}` prints; mend what "
            f"it comes from.{said}"
        )
        raise UrdfError(message) from error


class _Arguments(dict[str, str]):
    """The arguments of a call, which notes what the xacro asks for."""

    def __init__(self, given: tuple[tuple[str, str], ...]) -> None:
        super().__init__(given)
        self.asked: dict[str, None] = {}
        self.missing = ""

    @property
    def unasked(self) -> list[str]:
        """Those given for which the xacro did not ask."""
        return [name for name in self if name not in self.asked]

    def __contains__(self, name: object) -> bool:
        """Whether there is a value: asked where a xacro declares an argument."""
        self.asked[str(name)] = None
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        """The value, wanted by $(arg name)."""
        self.asked[name] = None
        if not super().__contains__(name):
            self.missing = name
        return super().__getitem__(name)


def _flattened(call: XacroCall) -> tuple[bytes, str]:
    """The flattened text, and a sentence with what xacro printed: for a message, should the text be no URDF."""
    arguments = _Arguments(call.arguments)
    said = io.StringIO()
    packages: list[Path] = []
    with _ONE_AT_A_TIME, _alone(call, packages) as xacro, _unheard(said):
        given = _given(call)
        guard(xacro, lambda: given.and_own(packages))
        try:
            document = xacro.process_file(str(call.path), mappings=arguments, verbosity=0)
            _rename(document, call.path)
            text = document.toprettyxml(indent="  ")
            data = str(text).encode()
        except Exception as error:
            # Anything: a xacro holds expressions of Python.
            message = fault_text(xacro, error, call.path, arguments.missing)
            message += _unasked(arguments) + heard(said.getvalue())
            raise UrdfError(message) from error
    for name in arguments.unasked:
        known = choices(arguments.asked)
        has = f"Its arguments: {known}" if known else "It has none"
        like = did_you_mean(name, arguments.asked)
        message = f"{call.path.name} has no argument '{name}'{like}. {has}."
        raise UrdfError(message)
    return data, heard(said.getvalue())


def _given(call: XacroCall) -> GivenFolders:
    """The folders that the xacro may read from: its own, those of ROS, and files and folders among its arguments."""
    named = list(listed_folders())
    for _, value in call.arguments:
        name = value.removeprefix("file://")
        paths = (Path(name), call.path.parent / name) if name else ()
        # An argument such as ns:=/ is no folder.
        named += [path for path in paths if path.parent != path and _is_there(path)]
    return GivenFolders((own_folder(call.path),), tuple(named))


def _unasked(arguments: _Arguments) -> str:
    """A sentence about arguments with which a xacro that failed had nothing to do: a name may be misspelt."""
    return "".join(
        f" It was given '{name}' and had not asked for it{did_you_mean(name, arguments.asked)}."
        for name in arguments.unasked
    )


@contextlib.contextmanager
def _alone(call: XacroCall, packages: list[Path]) -> Iterator[Any]:
    """A copy of the xacro package of our own; what it changes in other modules is put back.

    The folders of the packages that it asks for are appended to ``packages``.

    Raises:
        UrdfError: It is not installed.
    """
    import xml.dom.minidom  # the two take time, and few robots are xacros

    import yaml

    writes = xml.dom.minidom.Element.writexml  # xacro puts its own in this place
    constructors = dict(yaml.SafeLoader.yaml_constructors)  # and adds units to these
    ours = _taken_out()
    try:
        try:
            xacro = _imported()
        except ImportError as error:
            message = (
                f"{call.path.name} is a xacro, and the xacro package that flattens it is not installed ({error}). "
                'Install it with: pip install "calib[xacro]"; or flatten it elsewhere: '
                f"{call.command} > {shlex.quote(expanded_name(call.path))}"
            )
            raise UrdfError(message) from error
        sys.modules[_AMENT] = _package_index(call.path, packages)
        yield xacro
    finally:
        _taken_out()
        sys.modules.update(ours)
        xml.dom.minidom.Element.writexml = writes  # type: ignore[method-assign]
        yaml.SafeLoader.yaml_constructors = constructors


def _imported() -> types.ModuleType:
    """The xacro package, imported anew.

    Raises:
        ImportError: There is none, or another module has its name.
    """
    with warnings.catch_warnings():
        # Of the package's own code, which is not ours to mend: of an enumeration of units, with Python 3.10.
        warnings.simplefilter("ignore", DeprecationWarning)
        xacro = importlib.import_module("xacro")
    if not hasattr(xacro, "process_file"):
        message = f"xacro is {getattr(xacro, '__file__', None) or 'a folder of that name'}"
        raise ImportError(message)
    return xacro


def _taken_out() -> dict[str, types.ModuleType]:
    """The modules of xacro, and the one that it asks for packages, taken out of those loaded."""
    names = [n for n in sys.modules if n.partition(".")[0] == "xacro" or n == _AMENT]
    return {name: sys.modules.pop(name) for name in names}


def _package_index(path: Path, packages: list[Path]) -> types.ModuleType:
    """What stands in for ROS's index of packages: xacro asks it and nothing else."""

    def get_package_share_directory(name: str) -> str:
        found = find_package(name, path)
        if found is None:
            raise PackageMissing(name)
        packages.append(found)
        return str(found)

    module = types.ModuleType(_AMENT)
    setattr(module, "get_package_share_directory", get_package_share_directory)  # noqa: B010  mypy
    return module


@contextlib.contextmanager
def _unheard(said: io.StringIO) -> Iterator[None]:
    """What is printed, and warnings about a xacro's expressions, go nowhere but into ``said``."""
    with (
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        yield


def _rename(document: Any, path: Path) -> None:  # noqa: ANN401  minidom has no types
    """Leave the folder out of the remark at the head: the same text from wherever the file is called."""
    given = re.sub(r"-+", "-", str(path))
    for node in document.childNodes:
        if (
            node.nodeType == node.COMMENT_NODE
            and f"autogenerated by xacro from {given}" in node.data
        ):
            name = re.sub(r"-+", "-", path.name)
            node.data = f" |    This document was autogenerated by xacro from {name:<30} | "
            return


def _is_there(path: Path) -> bool:
    """Whether there is such a file or folder."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def _is_file(text: str) -> bool:
    """Whether there is such a file; no for a name that the system cannot have."""
    try:
        return Path(text).is_file()
    except (OSError, ValueError):
        return False
