"""What is wrong with a xacro, in words: the file, the line where it can be found, the fix."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers import expat

from calib.model.ros_packages import where_packages_are

__all__ = ["PackageMissing", "fault_text", "heard"]

_EXPRESSION = re.compile(r"when evaluating expression '(.*)' *$", re.MULTILINE)
_UNKNOWN_MACRO = re.compile(r"unknown macro name: xacro:(\S+)")
_CONDITION = re.compile(r'Xacro conditional "(.*?)" evaluated')
_BYTES = 10_000_000


class PackageMissing(LookupError):
    """A ROS package that was not found; its argument is the name."""


@dataclass(frozen=True, slots=True)
class _Fault:
    """What is wrong, and the texts of which one stands where it is, whole words each."""

    text: str
    needles: tuple[str, ...] = ()


def fault_text(xacro: Any, error: Exception, path: Path, missing: str) -> str:  # noqa: ANN401
    """The message for an error that xacro raised.

    Args:
        xacro: The module, which knows the file and the macro it was at.
        error: What it raised.
        path: The file that was to be flattened.
        missing: Name of an argument that was wanted and has no value, or empty.
    """
    files = [Path(str(f)) for f in getattr(xacro, "filestack", None) or [] if f] or [path]
    macros = list(getattr(xacro, "macrostack", None) or [])
    sources = [files[-1], *(Path(str(m.history[-1][-1])) for m in reversed(macros) if m.history)]
    names = [m.body.getAttribute("name") for m in macros if m.body is not None]
    calls = tuple(f"<xacro:{name}" for name in names[-1:])
    fault = _fault(error, path, missing, calls)
    place, known = files[-1].name, False
    for source in dict.fromkeys(sources):
        line = _line(source, fault.needles)
        if line and not known:
            place, known = f"{source.name}, line {line}", True
    if isinstance(error, expat.ExpatError):
        place = f"{files[-1].name}, line {error.lineno}, column {error.offset + 1}"
    inside = f" (in macro '{names[-1]}')" if names else ""
    above = "" if files[-1] == path else f", included by {path.name}"
    return f"{place}{above}{inside}: {fault.text}"


def heard(said: str) -> str:
    """What xacro printed, as the last sentence of a message; empty if it printed nothing."""
    text = " ".join(said.split())
    return f" xacro also says: {text}" if text else ""


def _fault(error: Exception, path: Path, missing: str, calls: tuple[str, ...]) -> _Fault:
    """What is wrong, by the errors that lie under xacro's own; ``calls`` is how the macro is called."""
    under = list(_under(error))
    text = _innermost(error)
    expressions = tuple(f"${{{found}}}" for found in _EXPRESSION.findall(str(error)))
    for one in under:
        if isinstance(one, PackageMissing):
            return _missing_package(str(one.args[0]), path)
        if isinstance(one, expat.ExpatError):
            return _Fault(f"this is not XML: {expat.ErrorString(one.code)}; mend the file there.")
        if isinstance(one, RecursionError):
            return _Fault(
                "xacro came to no end: a file that includes itself, or a macro that calls itself. Take the circle out."
            )
        if isinstance(one, UnicodeDecodeError):
            return _Fault("a file that it reads is not UTF-8 text; save it as UTF-8.", expressions)
        if isinstance(one, OSError) and one.filename is not None:
            return _missing_file(one, expressions)
    if missing and any(missing in map(str, one.args) for one in under):
        return _Fault(
            f"the argument '{missing}' has no value; give it behind the file: \"{path.name} {missing}:=VALUE\".",
            (f"$(arg {missing})", f"xacro.arg('{missing}')", f'xacro.arg("{missing}")'),
        )
    macro = _UNKNOWN_MACRO.search(text)
    if macro is not None:
        return _Fault(
            f"there is no macro '{macro[1]}'; include the file that defines it before, or mend the name.",
            (f"<xacro:{macro[1]}",),
        )
    condition = _CONDITION.search(text)
    if condition is not None:
        return _Fault(f"{text}; write true or false there.", (f'value="{condition[1]}"',))
    where = f" in the expression {expressions[0]}" if expressions else ""
    return _Fault(f"{text}{where}; mend the xacro there.", expressions or calls)


def _missing_package(name: str, path: Path) -> _Fault:
    """A package that was not found."""
    return _Fault(
        f"$(find {name}): there is no ROS package '{name}' in {where_packages_are(path)}. Source the ROS workspace "
        "that has it, or name the folder above its package.xml: export ROS_PACKAGE_PATH=FOLDER",
        (f"$(find {name})",),
    )


def _missing_file(error: OSError, expressions: tuple[str, ...]) -> _Fault:
    """A file that cannot be read."""
    name = str(error.filename)
    reason = (error.strerror or type(error).__name__).lower()
    return _Fault(
        f"'{name}' cannot be read: {reason}. A name without a folder is looked for beside the xacro that names it.",
        (*expressions, Path(name).name),
    )


def _innermost(error: BaseException) -> str:
    """What the error says that xacro wrapped, on one line."""
    while isinstance(getattr(error, "exc", None), BaseException):
        error = error.exc  # type: ignore[attr-defined]
    text = _EXPRESSION.sub("", str(error))
    if isinstance(error, KeyError):
        text = f"there is no {text}"
    return " ".join(text.split()).rstrip(".") or type(error).__name__


def _under(error: BaseException) -> Iterator[BaseException]:
    """The error, and those that xacro wrapped in it."""
    seen: set[int] = set()
    waiting: list[Any] = [error]
    while waiting:
        one = waiting.pop(0)
        if isinstance(one, BaseException) and id(one) not in seen:
            seen.add(id(one))
            yield one
            waiting += [getattr(one, "exc", None), one.__cause__, one.__context__]


def _line(file: Path, needles: tuple[str, ...]) -> int:
    """The only line of a file that has one of these texts; 0 where it is not known."""
    with contextlib.suppress(OSError, ValueError):
        if not file.is_file():  # a pipe would be waited for
            return 0
        with file.open("rb") as opened:
            lines = opened.read(_BYTES).decode("utf-8", "replace").splitlines()
        for needle in needles:
            word = re.compile(re.escape(needle) + (r"(?![\w.])" if needle[-1:].isalnum() else ""))
            found = [number for number, line in enumerate(lines, start=1) if word.search(line)]
            if found:
                return found[0] if len(found) == 1 else 0
    return 0
