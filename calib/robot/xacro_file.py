"""Xacro files, flattened to a URDF by the ``xacro`` package in a process of their own with a time limit.

A xacro is a program: it may read any file, and may run for ever. Flatten only those that you trust.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.basics.files import read_bytes
from calib.errors import UrdfError, choices, did_you_mean

TIME_LIMIT = 60.0
"""The time that flattening may take [s]."""

_FILE = re.compile(r"\.xacro(?=\s|$)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class XacroCall:
    """A xacro file and its arguments, ``(name, value)`` each."""

    #: The xacro file.
    path: Path
    #: Names and values, in the order in which they were given.
    arguments: tuple[tuple[str, str], ...] = ()

    @classmethod
    def parse(cls, source: str | os.PathLike[str]) -> XacroCall:
        """Return the file and the arguments that a text names.

        Args:
            source: Path of a xacro, followed by arguments ``NAME:=VALUE``, quoted as for a shell.

        Raises:
            UrdfError: A word after the path is not an argument, or one is given twice.

        Example:
            >>> XacroCall.parse("ur.urdf.xacro ur_type:=ur5e name:='my arm'").arguments
            (('ur_type', 'ur5e'), ('name', 'my arm'))
        """
        text = os.fspath(source)
        # A folder may have the ending too: the path is the whole text, or the first part of it that is a file.
        ends = [len(text), *(match.end() for match in _FILE.finditer(text))]
        end = next((end for end in ends if os.path.isfile(text[:end])), ends[:2][-1])  # noqa: PTH113
        path = Path(text[:end]).expanduser()
        try:
            words = shlex.split(text[end:])
        except ValueError as error:
            raise UrdfError(f"the arguments after {path.name}: {error}") from error
        given: dict[str, str] = {}
        for word in words:
            name, sign, value = word.partition(":=")
            if not name or not sign or name in given:
                raise UrdfError(
                    f"'{word}' after {path.name} is not an argument, or repeats one; write NAME:=VALUE"
                )
            given[name] = value
        return cls(path, tuple(given.items()))

    @property
    def name(self) -> str:
        """The file's name with the arguments, for messages and results."""
        words = [f"{name}:={shlex.quote(value)}" for name, value in self.arguments]
        return " ".join([self.path.name, *words])


def is_xacro(source: str | os.PathLike[str]) -> bool:
    """Return True for the name of a xacro file, with or without arguments."""
    text = os.fspath(source)
    if os.path.isfile(text):  # noqa: PTH113  of any length
        return text.lower().endswith(".xacro")
    return _FILE.search(text) is not None


def flatten(call: XacroCall) -> bytes:
    """Return the text that ``xacro FILE ARGUMENTS`` prints, without the folder in the remark at its head.

    Raises:
        FileError: There is no such file.
        UrdfError: The xacro package is not installed, it finds a fault, or it takes longer than `TIME_LIMIT`.
    """
    return _run(call, ())


def flatten_with_marks(
    call: XacroCall, changed: Mapping[Path, bytes] | None = None
) -> tuple[str, tuple[Path, ...]]:
    """Return what `flatten` does, with marks from which joint and origin of which file its joints and origins come.

    Args:
        call: The xacro and its arguments.
        changed: Bytes of files that are not written yet, by their absolute paths; None for none.

    Returns:
        The text, in which joints and origins have an attribute `MARK` with the number of a file and that of an element
        in it, from 0 in the file's order, as ``"1:12"``; and the files, absolute.

    Raises:
        FileError: There is no such file.
        UrdfError: As of `flatten`.
    """
    given = {str(path): data.decode("utf-8", "replace") for path, data in (changed or {}).items()}
    printed = json.loads(_run(call, ("--marks",), json.dumps(given).encode()))
    return printed["text"], tuple(Path(file) for file in printed["files"])


def _run(call: XacroCall, options: tuple[str, ...], given: bytes = b"") -> bytes:
    """Return what this module prints in a process of its own; raises what `flatten` does."""
    read_bytes(call.path, "xacro file")
    package = importlib.util.find_spec("xacro")
    if package is None or package.origin is None:
        raise UrdfError(
            f"{call.name} is a xacro, and the package that flattens it is not installed: "
            "pip install 'robot-calib[xacro]'"
        )
    words = [f"{name}:={value}" for name, value in call.arguments]
    program = [sys.executable, "-W", "ignore", "-m", __name__, *options, str(call.path), *words]
    path = os.pathsep.join(filter(None, sys.path))
    env = os.environ | {"PYTHONPATH": path, "PYTHONIOENCODING": "utf-8"}
    try:
        finished = subprocess.run(
            program, input=given, capture_output=True, timeout=TIME_LIMIT, env=env, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise UrdfError(
            f"{call.name}: xacro took longer than {TIME_LIMIT:g} s and was stopped; look for what repeats in it"
        ) from error
    if finished.returncode:
        lines = finished.stderr.decode("utf-8", "replace").strip().splitlines()
        fault = lines[-1] if lines else "xacro failed"
        raise UrdfError(f"{call.name}: {fault}")
    return finished.stdout


class _Arguments(dict[str, str]):
    """The arguments of a call, which note the names that the xacro uses, because xacro ignores a misspelt one."""

    def __init__(self, words: tuple[str, ...]) -> None:
        super().__init__(word.split(":=", 1) for word in words)
        self.given = dict(self)  # without the defaults that xacro adds
        self.used: dict[str, None] = {}  # names in the order of their use

    def __contains__(self, name: object) -> bool:
        self.used[str(name)] = None
        return super().__contains__(name)

    def misspelt(self) -> str:
        """Return the fault of an argument that the xacro does not use, for a message; empty if there is none."""
        for name in self.keys() - self.used.keys():
            has = f"its arguments: {choices(self.used)}" if self.used else "it has none"
            return f"it has no argument '{name}'{did_you_mean(name, self.used)}; {has}"
        return ""


MARK = "calib_at"
"""The attribute by which `flatten_with_marks` says where a joint or an origin comes from."""


class _Marks:
    """Marks joints and origins of the files that xacro reads, and gives it other bytes for some."""

    def __init__(self, xacro: Any, changed: Mapping[str, str]) -> None:  # noqa: ANN401  a module
        self.files: list[str] = []
        self._changed = changed
        self._parse = xacro.parse
        xacro.parse = self.parse

    def parse(self, given: Any, filename: str | None = None) -> Any:  # noqa: ANN401  as of xacro.parse
        """Return the document that xacro's own function returns, with marks."""
        file = os.path.realpath(filename or "")
        document = self._parse(self._changed.get(file, given), filename)
        if file not in self.files:
            self.files.append(file)
        number = self.files.index(file)
        for index, element in enumerate(document.getElementsByTagName("*")):
            if element.tagName in ("joint", "origin"):
                element.setAttribute(MARK, f"{number}:{index}")
        return document


def _main(*words: str) -> str | None:
    """Flatten a file, with unchecked words ``NAME:=VALUE``, to standard output; return a line on a fault, or None.

    With the first word ``--marks`` the text is printed as JSON, see `flatten_with_marks`.
    """
    import xacro

    marks = None
    if words[0] == "--marks":
        marks = _Marks(xacro, json.loads(sys.stdin.buffer.read()))
        words = words[1:]
    path, *words_after = words

    index: Any = types.ModuleType("ament_index_python.packages")  # all that xacro asks of ROS
    index.get_package_share_directory = lambda name: str(package_folder(name, Path(path)))
    sys.modules[index.__name__] = index
    arguments = _Arguments(tuple(words_after))
    output, sys.stdout = sys.stdout, sys.stderr  # for what the xacro itself prints
    try:
        document = xacro.process_file(path, mappings=arguments, verbosity=0)
    except Exception as error:  # noqa: BLE001  a xacro holds expressions of Python
        place = ""
        if xacro.filestack and xacro.filestack[-1] != path:
            place = f"in {xacro.filestack[-1]}: "
        files = [Path(path), *map(Path, xacro.all_includes)]
        fault = " ".join(_in_words(error, arguments, files).split()).rstrip(".")
        misspelt = arguments.misspelt()
        return f"{place}{fault}. {misspelt[:1].upper()}{misspelt[1:]}"
    # The second line of xacro's remark names the file with its folder: without that the text is the same everywhere.
    name = re.sub("-+", "-", Path(path).name)
    remark = document.childNodes[1]
    remark.data = f" |    This document was autogenerated by xacro from {name:<30} | "
    text = document.toprettyxml(indent="  ")
    output.write(text if marks is None else json.dumps({"text": text, "files": marks.files}))
    return arguments.misspelt() or None


#: What xacro says in its own words, and the same in calib's; {macro} is the macro that was called.
_SAID = {
    r"unknown macro name: (.+)": "it calls the macro '{0}', which no file defines that it includes before",
    r"Undefined parameters \[(.+)\]": "it calls the macro '{macro}' without its parameters {0}",
    r'Invalid parameter "(.+)"': "it calls the macro '{macro}' with '{0}', which is not one of its parameters",
}


def _in_words(error: Exception, arguments: _Arguments, files: list[Path]) -> str:
    """Return what a xacro lacks, from the exception of the xacro package, without classes and once.

    ``files`` are the xacro and those that it includes, the xacro first.
    """
    from xacro.substitution_args import ArgException

    # Xacro wraps what it caught, once for each level, and appends where it was.
    cause: BaseException = error
    where = ""
    while getattr(cause, "exc", None) is not None:
        where = where or getattr(cause, "suffix", None) or ""
        cause = getattr(cause, "exc")  # noqa: B009  of a class without types
    text = str(cause) or repr(cause)
    if type(cause) is LookupError:  # of `package_folder`, a sentence
        return text
    if isinstance(cause, ArgException) and text.isidentifier():
        return _missing_arguments(text, arguments, files)
    if isinstance(cause, OSError) and cause.filename:
        return f"it uses the file '{cause.filename}', which cannot be read: {cause.strerror}"
    for pattern, sentence in _SAID.items():
        found = re.fullmatch(pattern, text)
        if found is not None:
            macros = [macro.body.getAttribute("name") for macro in getattr(error, "macros", [])]
            return sentence.format(found[1], macro="".join(macros[:1]))
    return f"{text} {where}"


_USED = re.compile(rb"\$\(arg\s+([^\s)]+)\s*\)")
_STATED = re.compile(rb"<[\w.-]+:arg\s[^>]*>")
_ATTRIBUTE = re.compile(rb"""([\w.-]+)\s*=\s*["']([^"']*)["']""")


def _missing_arguments(first: str, arguments: _Arguments, files: list[Path]) -> str:
    """Return which arguments a xacro wants, and how they are given; ``first`` is the one that xacro missed.

    They are those that the files use, without those that were given or have a default.
    """
    names: dict[str, None] = {first: None}
    defaults = set(arguments)
    for file in files:
        text = _COMMENT.sub(b"", file.read_bytes()) if file.is_file() else b""
        for tag in _STATED.findall(text):
            attributes = dict(_ATTRIBUTE.findall(tag))
            name = attributes.get(b"name", b"?").decode("utf-8", "replace")
            names[name] = None
            if b"default" in attributes:
                defaults.add(name)
        names |= dict.fromkeys(name.decode("utf-8", "replace") for name in _USED.findall(text))
    missing = [name for name in names if name == first or name not in defaults]
    of = "argument" if len(missing) == 1 else "arguments"
    arguments.used |= names
    kept = [(name, value) for name, value in arguments.given.items() if name in names]
    words = XacroCall(files[0], tuple(kept)).name
    words = " ".join([words, *(f"{name}:=VALUE" for name in missing)])
    return f'the xacro needs the {of} {choices(missing)}: write "{words}" in one pair of quotes'


#: Name of the file that makes a folder a ROS package.
MANIFEST = "package.xml"
_NAME = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)

#: Levels of folders that are searched for a package below one of ROS_PACKAGE_PATH.
_DEEP = 5

#: Levels below a workspace's `src`.
_WORKSPACE = 2

#: Levels below any other folder.
_BESIDE = 1


def package_folder(name: str, file: Path) -> Path:
    """Return the folder of a ROS package as a xacro file finds it.

    It looks, in this order, in the ament index (``AMENT_PREFIX_PATH``, ROS 2); in ``ROS_PACKAGE_PATH`` (ROS 1); in the
    folders above the file and those beside them whose ``package.xml`` has the name; and for a folder of that name
    without a ``package.xml``.

    Args:
        name: The package's name.
        file: The xacro file.

    Returns:
        The folder, which exists; relative if the entry of the variable is.

    Raises:
        LookupError: There is no such package.
    """
    if name.strip("."):
        for folder in _candidates(name, file.resolve()):
            return folder
    raise LookupError(
        f"there is no ROS package '{name}' in AMENT_PREFIX_PATH, ROS_PACKAGE_PATH, or the folders above and beside "
        f"'{file}'. Source its ROS workspace, or export ROS_PACKAGE_PATH=FOLDER with the folder above it"
    )


def listed_folders(variable: str) -> list[Path]:
    """Return the folders of an environment variable such as ``ROS_PACKAGE_PATH``."""
    return [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def packages_in(folder: Path, name: str, depth: int = _BESIDE) -> Iterator[Path]:
    """Yield the ROS packages of a name in a folder, the folder itself first.

    Args:
        folder: The folder.
        name: The package's name, as its ``package.xml`` states it.
        depth: Levels of folders below it to search.
    """
    if (folder / MANIFEST).is_file():  # packages are not nested
        manifest = _COMMENT.sub(b"", (folder / MANIFEST).read_bytes())
        stated = _NAME.search(manifest)
        if stated is not None and stated[1] == name.encode():
            yield folder
    elif depth and os.access(folder, os.R_OK) and folder.is_dir():
        for below in sorted(folder.iterdir()):
            if below.is_dir() and not below.name.startswith("."):
                yield from packages_in(below, name, depth - 1)


def _candidates(name: str, file: Path) -> Iterator[Path]:
    """Yield the folders that a package's name may mean for a xacro file, the likeliest first."""
    for prefix in listed_folders("AMENT_PREFIX_PATH"):
        index = prefix / "share" / "ament_index" / "resource_index" / "packages" / name
        folder = prefix / "share" / name
        if index.is_file() and folder.is_dir():
            yield folder
    for folder in listed_folders("ROS_PACKAGE_PATH"):
        yield from packages_in(folder, name, _DEEP)
    for folder in file.parents:
        yield from packages_in(folder, name, _WORKSPACE if folder.name == "src" else _BESIDE)
    for folder in file.parents:
        if (folder / name).is_dir() and not (folder / name / MANIFEST).exists():
            yield folder / name


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
